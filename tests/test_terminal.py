"""No text makes a terminal do anything, and nothing that is printed is lost without an error."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import terminal
from pipeline.errors import OutputError
from pipeline.terminal import cell, plain, say

PIPELINE = Path(terminal.__file__).parent


@given(st.text() | st.text(st.characters(categories=["Cc", "Cf", "Cs", "Zl", "Zp", "Co"])))
def test_no_character_that_a_terminal_obeys_is_left(text: str) -> None:
    shown = plain(text)
    assert not {unicodedata.category(c) for c in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp", "Co", "Cn"}
    assert shown.encode() is not None  # it can be written
    if text.isprintable():
        assert shown == text


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b]52;c;aGk=\x07", "\\x1b]52;c;aGk=\\x07"),
        ("a\nb\r\tc", "a\\nb\\r\\tc"),
        ("\x9b2J\x7f", "\\x9b2J\\x7f"),
        ("\u202egnp.exe\u2066", "\\u202egnp.exe\\u2066"),
        (os.fsdecode(b"\xff\xfe.mcap"), "\\udcff\\udcfe.mcap"),
        ("Jürgen 花子 [bold]", "Jürgen 花子 [bold]"),
    ],
)
def test_what_is_hidden_becomes_visible(text: str, shown: str) -> None:
    assert plain(text) == shown


def test_a_long_text_loses_its_middle() -> None:
    shown = plain("a" * 3000 + "\x1b" * 3000, 100)
    assert len(shown) <= 100
    assert shown.startswith("aaa")
    assert " [...] " in shown
    assert shown.endswith("\\x1b")


def test_square_brackets_are_no_markup() -> None:
    assert cell("[red]a[/]\x1b").plain == "[red]a[/]\\x1b"


def test_a_line_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    say("one\ntwo\x1b[2J")
    say("three\r", error=True)
    assert capsys.readouterr() == ("one\\ntwo\\x1b[2J\n", "three\\r\n")


def test_nothing_is_printed_past_this_module() -> None:
    """Whatever prints, prints by `say`, `show` or `standard_output`, which make it plain and notice a full disk."""
    printing = re.compile(r"\bprint\(|\bsys\.(__)?std(out|err)\b(?!\.(isatty|encoding))|\blogging\.|\becho\(")
    found = {
        f"{path.relative_to(PIPELINE)}: {printed[0]}"
        for path in PIPELINE.rglob("*.py")
        if path.name != "terminal.py"
        for printed in printing.finditer(path.read_text(encoding="utf-8"))
    }
    assert found == {
        "formats/duckdb/query_process.py: sys.stdout",  # a process of its own, that no terminal reads
        "formats/parquet/foreign_tables.py: sys.stdout",  # likewise
        "formats/recordings/hdf5_process.py: sys.stdout",  # likewise
        "formats/parquet/measured.py: sys.stdout",  # likewise: numbers for the process that has started it
        "workspace/progress.py: print(",  # of rich, on standard error, with texts of `cell`
        "commands/sql/layout.py: print(",  # of rich, into a text, with texts of `cell`
    }


class Full(io.TextIOWrapper):
    """Standard output on a disk that is full."""

    def __init__(self) -> None:
        super().__init__(io.BytesIO())

    def flush(self) -> None:
        raise OSError(28, "No space left on device")


@pytest.mark.parametrize("printing", [lambda: say("x"), terminal.finish, lambda: terminal.show("x")])
def test_what_cannot_be_written_is_an_error(monkeypatch: pytest.MonkeyPatch, printing: object) -> None:
    monkeypatch.setattr(sys, "stdout", Full())
    with pytest.raises(OutputError, match="no space left on device"):
        printing()  # type: ignore[operator]
    monkeypatch.undo()


SAYING = "from pipeline import terminal; terminal.prepare(); {}; terminal.finish()"


def python(code: str, **options: object) -> subprocess.CompletedProcess[bytes]:
    words = [sys.executable, "-c", SAYING.format(code)]
    return subprocess.run(words, stderr=subprocess.PIPE, timeout=60, **options)  # type: ignore[call-overload,no-any-return]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is a device of Linux")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("code", ["terminal.say('x')", "print('x')", "print('x' * 100_000)", "terminal.show('x')"])
def test_a_full_disk_is_noticed(code: str, unbuffered: str) -> None:
    with Path("/dev/full").open("wb") as full:
        done = python(code, stdout=full, env=os.environ | {"PYTHONUNBUFFERED": unbuffered})
    assert done.returncode != 0
    assert b"No space left on device" in done.stderr or b"no space left on device" in done.stderr


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_pipe_that_takes_little_at_a_time_gets_all(unbuffered: str) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, True)
    words = [sys.executable, "-c", SAYING.format("print('x' * 1_000_000)")]
    with subprocess.Popen(words, stdout=writing, env=os.environ | {"PYTHONUNBUFFERED": unbuffered}) as process:
        os.close(writing)
        with os.fdopen(reading, "rb") as stream:
            assert stream.read() == b"x" * 1_000_000 + b"\n"
        assert process.wait() == 0


def test_a_character_that_the_encoding_lacks_is_no_error() -> None:
    done = python("terminal.say('Jürgen 花子')", stdout=subprocess.PIPE, env=os.environ | {"PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stdout) == (0, b"J\\xfcrgen \\u82b1\\u5b50\n")


def test_a_closed_output_is_an_error() -> None:
    done = subprocess.run(
        ["sh", "-c", f'{sys.executable} -c "{SAYING.format("terminal.say(1 * chr(120))")}" >&-'],
        capture_output=True, timeout=60,
    )  # fmt: skip
    assert done.returncode != 0
    assert b"OutputError" in done.stderr
