"""The process that asks a DuckDB file one question, so that no question can take more than its time and memory.

DuckDB's own limits do not hold everywhere: a list of a million constants is planned for minutes without listening to an
interrupt, and an answer is handed over outside its memory limit. A process can always be ended, and its address space
has a size. `python -m pipeline.formats.duckdb.query_process FILE SECONDS DESCRIPTOR` reads the question from standard
input and writes the answer to standard output, as an Arrow stream while it is found. A sentence goes to the descriptor.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

from pipeline.errors import QueryError

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

MEMORY_LIMIT = "1GB"
ADDRESS_SPACE_BYTES = 4 << 30  # of the process: DuckDB's memory, the answer's, and what libraries reserve without using
RESIDENT_BYTES = 3 << 29  # of these, what it may use: DuckDB's memory and the answer's
THREADS = 2
LOCKED: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": False,
    "lock_configuration": True,
    "temp_directory": "",
    "memory_limit": MEMORY_LIMIT,
    "threads": THREADS,
    "autoinstall_known_extensions": False,
    "autoload_known_extensions": False,
    "python_enable_replacements": False,
}
GRACE_S = 5.0  # for the process to start, and to end by itself
REFUSED, OUT_OF_MEMORY = 3, 4  # exit statuses: a sentence says why; memory ran out
_ROWS = 10_000


class Clock:
    """Counts the time for which it runs, and calls `stop` once that is all there was.

    Attributes:
        seconds: how much that was.
        over: whether it has.
    """

    def __init__(self, seconds: float, stop: Callable[[], None]) -> None:
        self.seconds = seconds
        self._left, self._stop = seconds, stop
        self.over = False

    @contextmanager
    def running(self) -> Iterator[None]:
        """Let it run."""
        timer = threading.Timer(self._left, self._end)
        timer.daemon = True
        began = time.monotonic()
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self._left = max(self._left - (time.monotonic() - began), 0.0)

    def _end(self) -> None:
        self.over = True
        self._stop()


def main(path: str, time_limit_s: str, sentence: str) -> int:
    """Answer the question on standard input."""
    try:
        _bound_memory()
        _put(Path(path), sys.stdin.buffer.read().decode("utf-8"), float(time_limit_s), sys.stdout.buffer)
    except UnicodeDecodeError:
        return _refuse("the question is not valid text", int(sentence))
    except QueryError as error:
        return _refuse(str(error), int(sentence))
    except (MemoryError, ImportError):  # a library that finds no room is not loaded
        return OUT_OF_MEMORY
    return 0


def _put(path: Path, sql: str, time_limit_s: float, out: IO[bytes]) -> None:
    import duckdb
    import pyarrow as pa

    try:
        with duckdb.connect(path, read_only=True, config=LOCKED) as con:
            clock = Clock(time_limit_s, con.interrupt)
            with clock.running():
                _require_question(con, sql)
                relation = con.sql(sql)
                if relation is None:
                    raise QueryError("the question has no answer; write a select, for example `from best_hypothesis`")
                reader = relation.to_arrow_reader(_ROWS)
            with pa.ipc.new_stream(out, reader.schema) as stream:
                while (batch := _next(reader, clock)) is not None:
                    stream.write_batch(batch)
                    out.flush()
    except duckdb.InterruptException:
        raise too_long(time_limit_s) from None
    except duckdb.OutOfMemoryException as error:
        raise _out_of_memory(error) from None
    except duckdb.Error as error:
        raise QueryError(_first_line(error)) from None
    except pa.ArrowMemoryError:
        raise MemoryError from None
    except pa.ArrowException as error:
        raise QueryError(f"the answer cannot be handed over ({_first_line(error)}); ask for less of each row") from None


def _next(reader: pa.RecordBatchReader, clock: Clock) -> pa.RecordBatch | None:
    """The next rows. What goes wrong in DuckDB meanwhile comes from Arrow as an error of the system, with its text."""
    try:
        with clock.running():
            return next(reader, None)
    except OSError as error:
        if clock.over:
            raise too_long(clock.seconds) from None
        if str(error).startswith("Out of Memory Error"):
            raise _out_of_memory(error) from None
        raise QueryError(_first_line(error)) from None


def _out_of_memory(error: Exception) -> Exception:
    """Whether the question wanted more than it may have, or the system gave no more."""
    return QueryError(too_much_memory()) if " used)" in str(error) else MemoryError()


def _require_question(con: duckdb.DuckDBPyConnection, sql: str) -> None:
    import duckdb

    statements = con.extract_statements(sql)
    if len(statements) != 1:
        raise QueryError(f"the question has {len(statements)} statements; ask one at a time")
    asking = {duckdb.StatementType.SELECT, duckdb.StatementType.EXPLAIN, duckdb.StatementType.MULTI}
    kind = statements[0].type
    if kind not in asking:
        raise QueryError(
            f"the question is a statement of kind {kind.name}, which would do more than ask; write a select, for "
            "example `from best_hypothesis`"
        )


def _bound_memory() -> None:
    try:
        import resource
    except ImportError:  # a system without it; DuckDB's own limit remains
        return
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    bytes_ = ADDRESS_SPACE_BYTES if most == resource.RLIM_INFINITY else min(ADDRESS_SPACE_BYTES, most)
    resource.setrlimit(resource.RLIMIT_AS, (bytes_, bytes_))


def too_much_memory() -> str:
    """What to say of a question that wanted more than it may have."""
    return f"the question took more memory than it may ({MEMORY_LIMIT}); ask for less"


def too_long(time_limit_s: float) -> QueryError:
    """What to say of a question that took more than its time."""
    return QueryError(f"the question took more than {time_limit_s:g} s and was stopped; ask for less")


def _first_line(error: Exception) -> str:
    text = " ".join(str(error).split("\n\n")[0].split())
    return text if len(text) <= 1000 else f"{text[:1000]} [...]"


def _refuse(sentence: str, descriptor: int) -> int:
    os.write(descriptor, sentence.encode("utf-8", "replace"))
    return REFUSED


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:4]))
