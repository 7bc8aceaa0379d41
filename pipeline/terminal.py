"""What reaches a terminal or a pipe: text that no terminal obeys, and bytes that are all there or an error.

Names and values come from other people's recordings, tables, parameters and folders. Everything that this program
prints goes through this module.
"""

from __future__ import annotations

import fcntl
import io
import json
import os
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from itertools import chain
from typing import IO, TYPE_CHECKING, TextIO, cast

from pipeline.errors import OutputError

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

LONGEST_MESSAGE = 4000
"""Characters of an error message or a note, at most."""
_LEFT_OUT = " [...] "
quiet: ContextVar[bool] = ContextVar("quiet", default=False)
"""Whether progress and notes are left out, as `lessbench --quiet` asks."""


def plain(text: str, longest: int | None = None) -> str:
    """`text` on one line, without what a terminal would obey, its middle left out where it is too long.

    Control characters (escape sequences, line ends, C1), marks that turn the direction of writing, and bytes of a file
    name that are no text become visible: `\\x1b`, `\\n`, `\\u202e`, `\\udcff`.
    """
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
    if longest is None or len(text) <= longest:
        return text
    half = (longest - len(_LEFT_OUT)) // 2
    return f"{text[:half]}{_LEFT_OUT}{text[-half:]}"


def cell(text: str, style: str = "") -> Text:
    """A text for rich, made plain; square brackets in it are no markup."""
    from rich.text import Text

    return Text(plain(text), style)


def say(line: str, *, error: bool = False) -> None:
    """Print one line, made plain, at once.

    Args:
        line: what to print.
        error: whether it goes to standard error, as messages and notes do.

    Raises:
        OutputError: standard output cannot be written.
    """
    with _written():
        print(plain(line), file=sys.stderr if error else sys.stdout, flush=True)


def note(line: str) -> None:
    """Print a remark on standard error, unless the user wants quiet."""
    if not quiet.get():
        say(line, error=True)


def say_json(value: object) -> None:
    """Print a value as JSON, for programs; characters beyond ASCII are escaped, so no terminal obeys any.

    Raises:
        OutputError: standard output cannot be written.
    """
    for line in json.dumps(value, indent=1).splitlines():
        say(line)


def show(what: RenderableType, width: int | None = None) -> None:
    """Print something that rich draws, whose texts are made by `cell`.

    Raises:
        OutputError: standard output cannot be written.
    """
    from rich.console import Console

    with _written():
        Console(width=width).print(what)
        sys.stdout.flush()


def show_in_pager(texts: Iterator[str]) -> None:
    """Print texts on a terminal as they come; if the first is higher than the terminal, through `$PAGER` or `less`.

    Raises:
        OutputError: standard output cannot be written.
    """
    first = next(texts, "")
    if first.count("\n") + 2 < shutil.get_terminal_size().lines or not sys.stdin.isatty():
        with standard_output() as stream:
            for text in chain([first], texts):
                stream.write(text.encode(sys.stdout.encoding or "utf-8", "backslashreplace"))
        return
    from click import get_pager_file

    os.environ.setdefault("LESS", "-FRX")  # as git has it: colours, and what was read stays on the terminal
    with _written(), get_pager_file() as pager:
        for text in chain([first], texts):
            pager.write(text)
            pager.flush()


@contextmanager
def standard_output() -> Iterator[IO[bytes]]:
    """Standard output for bytes. If not all can be written and it is a file, what was written is taken back.

    Raises:
        OutputError: standard output cannot be written, for example because the disk is full.
    """
    with _written():
        sys.stdout.flush()
        try:
            descriptor = sys.stdout.fileno()
        except (io.UnsupportedOperation, ValueError):  # a stream in memory
            yield sys.stdout.buffer
            return
        end = _end_of_file(descriptor)
        try:
            yield cast("IO[bytes]", _Descriptor(descriptor))
        except BaseException:
            if end is not None:
                with suppress(OSError):
                    os.ftruncate(descriptor, end)
            raise


def prepare() -> None:
    """Make the standard streams write all or fail, in any encoding. Python's own do not in two cases.

    Started with `-u` or PYTHONUNBUFFERED=1, they drop what one call to the system does not take. In an encoding that
    lacks a character they end the program.
    """
    for name in ("stdout", "stderr"):
        stream: TextIO | None = getattr(sys, name)
        if stream is None:  # closed by whoever started us: what is printed fails, and is not lost in silence
            setattr(sys, name, open(os.devnull))  # noqa: SIM115, PTH123
        elif isinstance(stream, io.TextIOWrapper):
            buffer: IO[bytes] = stream.buffer
            if isinstance(buffer, io.RawIOBase):
                whole = io.BufferedWriter(buffer)
                stream = io.TextIOWrapper(whole, encoding=stream.encoding, line_buffering=True)
                setattr(sys, name, stream)
            stream.reconfigure(errors="backslashreplace")


def finish() -> None:
    """Bring what was printed to where it goes.

    Raises:
        OutputError: standard output cannot be written.
    """
    with _written():
        sys.stdout.flush()


def abandon() -> None:
    """Print no more, and let what is left unwritten not become an error when Python ends."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


@contextmanager
def _written() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise  # whoever reads has seen enough
    except OSError as error:
        if error.filename is not None:
            raise
        reason = (error.strerror or str(error)).lower()
        raise OutputError(f"standard output cannot be written ({reason}); what was printed is not whole") from None


def _end_of_file(descriptor: int) -> int | None:
    """Where a file ends to which only its end is written; None for a terminal, a pipe, or the middle of a file."""
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        return None
    place = os.lseek(descriptor, 0, os.SEEK_CUR)
    appends = bool(fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_APPEND)
    return status.st_size if appends or place == status.st_size else None


class _Descriptor(io.RawIOBase):
    """A file descriptor of the system that is written whole, however little of it the system takes at a time."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        left = memoryview(data).cast("B")  # type: ignore[arg-type]
        size = len(left)
        while left:
            left = left[os.write(self._descriptor, left) :]
        return size
