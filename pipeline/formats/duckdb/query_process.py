"""One question to a DuckDB file in a process of its own, so that no question can take more than its time and memory.

DuckDB's own limits do not hold everywhere: a list of a million constants is planned for minutes without listening to an
interrupt, and an answer is handed over outside its memory limit. A process can always be ended, and its address space
has a size. `python -m pipeline.formats.duckdb.query_process FILE SECONDS` reads the question from standard input.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import IO, TYPE_CHECKING

from pipeline.errors import QueryError

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

MEMORY_LIMIT = "1GB"
ADDRESS_SPACE_BYTES = 4 << 30  # of the process: DuckDB's memory, the answer's, and what libraries reserve without using
ANSWER_BYTES = 256 << 20
QUESTION_CHARACTERS = 1_000_000
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
_ROWS = 10_000
_REFUSED = 3  # exit status: standard output holds a sentence


def answer(path: Path, sql: str, time_limit_s: float) -> pa.Table:
    """What the database at `path` says to one SQL query.

    Raises:
        QueryError: the question is wrong or refused, or takes more time or memory than it may.
    """
    import pyarrow as pa

    if len(sql) > QUESTION_CHARACTERS:
        raise QueryError(f"the question has {len(sql):,} characters, allowed are {QUESTION_CHARACTERS:,}; ask for less")
    words = [sys.executable, "-m", "pipeline.formats.duckdb.query_process", str(path.resolve()), repr(time_limit_s)]
    try:
        done = subprocess.run(  # noqa: S603
            words, input=sql.encode("utf-8", "surrogateescape"), capture_output=True, timeout=time_limit_s + GRACE_S
        )
    except subprocess.TimeoutExpired:
        raise _too_long(time_limit_s) from None
    if done.returncode == _REFUSED:
        raise QueryError(done.stdout.decode("utf-8", "replace"))
    if done.returncode != 0:
        raise QueryError(
            f"the question took more memory than it may ({MEMORY_LIMIT}), or asked what DuckDB cannot do; ask for less"
        )
    return pa.ipc.open_stream(done.stdout).read_all()


def main(path: str, time_limit_s: str) -> int:
    """Answer the question on standard input, as an Arrow stream or with a sentence."""
    _bound_memory()
    try:
        _put(Path(path), sys.stdin.buffer.read().decode("utf-8"), float(time_limit_s), sys.stdout.buffer)
    except UnicodeDecodeError:
        return _refuse("the question is not valid text")
    except QueryError as error:
        return _refuse(str(error))
    except MemoryError:
        return _refuse(f"the question took more memory than it may ({MEMORY_LIMIT}); ask for less")
    return 0


def _put(path: Path, sql: str, time_limit_s: float, out: IO[bytes]) -> None:
    import duckdb
    import pyarrow as pa

    try:
        with duckdb.connect(path, read_only=True, config=LOCKED) as con:
            timer = threading.Timer(time_limit_s, con.interrupt)
            timer.daemon = True
            timer.start()
            _require_question(con, sql)
            relation = con.sql(sql)
            if relation is None:
                raise QueryError("the question has no answer; write a select, for example `from best_hypothesis`")
            reader = relation.to_arrow_reader(_ROWS)
            batches, size = [], 0
            for batch in reader:
                batches.append(batch)
                size += batch.nbytes
                if size > ANSWER_BYTES:
                    raise QueryError(
                        f"the answer has more than {ANSWER_BYTES >> 20} MB; ask for fewer rows or less of each"
                    )
            with pa.ipc.new_stream(out, reader.schema) as stream:
                for batch in batches:
                    stream.write_batch(batch)
            timer.cancel()
    except duckdb.InterruptException:
        raise _too_long(time_limit_s) from None
    except duckdb.OutOfMemoryException:
        raise QueryError(f"the question took more memory than it may ({MEMORY_LIMIT}); ask for less") from None
    except duckdb.Error as error:
        raise QueryError(_first_line(error)) from None
    except pa.ArrowException as error:
        raise QueryError(f"the answer cannot be handed over ({_first_line(error)}); ask for less of each row") from None


def _require_question(con: duckdb.DuckDBPyConnection, sql: str) -> None:
    import duckdb

    statements = con.extract_statements(sql)
    if len(statements) != 1:
        raise QueryError(f"the question has {len(statements)} statements; ask one at a time")
    asking = {duckdb.StatementType.SELECT, duckdb.StatementType.EXPLAIN, duckdb.StatementType.MULTI}
    kind = statements[0].type
    if kind not in asking:
        raise QueryError(
            f"the question is a statement of kind {kind.name}, which would do more than ask; write a select, for example "
            "`from best_hypothesis`"
        )


def _bound_memory() -> None:
    try:
        import resource
    except ImportError:  # a system without it; DuckDB's own limit remains
        return
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))


def _too_long(time_limit_s: float) -> QueryError:
    return QueryError(f"the question took more than {time_limit_s:g} s and was stopped; ask for less")


def _first_line(error: Exception) -> str:
    text = " ".join(str(error).split("\n\n")[0].split())
    return text if len(text) <= 1000 else f"{text[:1000]} [...]"


def _refuse(sentence: str) -> int:
    sys.stdout.buffer.write(sentence.encode("utf-8", "replace"))
    return _REFUSED


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
