"""Questions to the catalog in SQL: their answers come as they are found, and a question can do nothing but ask."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, TypeVar, cast

import pipeline
from pipeline.errors import QueryError
from pipeline.formats.duckdb import query_process
from pipeline.formats.duckdb.database_file import readable_database
from pipeline.machine_memory import too_little

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa

Found = TypeVar("Found")
TIME_LIMIT_S = 60.0
QUESTION_CHARACTERS = 1_000_000
LEAST_ADDRESS_SPACE_BYTES = 5 << 29  # with less, the libraries that answer a question do not even begin
_WHO = "a question"
ANSWER_BYTES = 256 << 20  # of an answer that is held in memory
CONTENTS = """select table_name as name, 'table' as kind, comment as "what it holds" from duckdb_tables()
    union all select view_name, 'view', comment from duckdb_views() where not internal order by kind desc, name"""
EXAMPLES = {
    "What did they want, and how sure is that?": "from weights_summary where participant = 'all'",
    "What does `lessbench answer` say?": "from answers",
    "What would they do next?": "from predictions where participant = 'all'",
    "Which weights are the most probable?": "from best_weights where participant = 'all' and shown",
    "Which model predicts people better?": "from model_comparison",
    "Does the answer depend on the sampled alternatives?": "from disagreement_between_sets where participant = 'all'",
    "Whose demonstration says something else?": "from people_against_group where set_id = 'working' and differs",
    "Where does a posterior come from?": "from lineage where set_id = 'working' and model = 'less'",
    "What do the columns mean?": "select column_name, data_type, comment from duckdb_columns() "
    "where table_name = 'posteriors'",
}


class Answer:
    """Rows that come batch by batch, as the question finds them; made by `asked`.

    Attributes:
        schema: names and types of the columns; several of one name are numbered.
        taken: how many rows have been taken so far.
    """

    def __init__(self, batches: Iterator[pa.RecordBatch], schema: pa.Schema) -> None:
        self._batches = batches
        self.schema: pa.Schema = schema
        self.taken = 0

    def batches(self) -> Iterator[pa.RecordBatch]:
        """The rows that have not been taken yet.

        Raises:
            QueryError: the question turns out to be wrong, or takes too much time or memory.
        """
        for batch in self._batches:
            self.taken += batch.num_rows
            yield batch.rename_columns(self.schema.names)

    def frames(self) -> Iterator[pl.DataFrame]:
        """The same for polars; the first is empty, and has the columns.

        Raises:
            QueryError: as `batches`, or values are of a kind that polars does not have.
        """
        yield _frame(self.schema.empty_table())
        for batch in self.batches():
            yield _frame(batch)


@contextmanager
def asked(path: Path, sql: str, time_limit_s: float = TIME_LIMIT_S) -> Iterator[Answer]:
    """Ask the catalog, which this cannot change; what is not taken of the answer until the block ends is not computed.

    The connection is read-only, and reaches no file, network, extension or setting whatever the question says; its time
    and memory are those of a process that can be ended. Only waiting for rows counts as time, and not what is done with
    them.

    Raises:
        QueryError: there is no catalog, the question is wrong or refused, or it took too long or too much memory.
    """
    if not path.is_file():
        raise QueryError(f"{path}: there is no catalog yet; make it with `dvc repro`")
    if len(sql) > QUESTION_CHARACTERS:
        raise QueryError(f"the question has {len(sql):,} characters, allowed are {QUESTION_CHARACTERS:,}; ask for less")
    if (
        lacking := too_little(LEAST_ADDRESS_SPACE_BYTES, 0, _WHO)
    ) is not None:  # libraries would end the program without a word
        raise QueryError(_too_little(lacking))
    import pyarrow as pa

    with readable_database(path) as database, TemporaryFile() as question, TemporaryFile() as sentence:
        question.write(sql.encode("utf-8", "surrogateescape"))
        question.seek(0)
        process = subprocess.Popen(  # noqa: S603
            [
                sys.executable, "-P", "-m", query_process.__name__, str(database), repr(time_limit_s),
                str(sentence.fileno()),
            ],
            env=_environment(), stdin=question, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            pass_fds=[sentence.fileno()],
        )  # fmt: skip
        at_work = _AtWork(process, sentence, time_limit_s)
        try:
            reader = at_work.wait_for(lambda: pa.ipc.open_stream(process.stdout))
            yield Answer(at_work.batches(reader), _numbered(reader.schema))
        finally:
            process.kill()
            process.communicate()


def ask(path: Path, sql: str, time_limit_s: float = TIME_LIMIT_S) -> pl.DataFrame:
    """The whole answer to an SQL question, as `asked`.

    Raises:
        QueryError: as `asked`, or the answer is too large to be held in memory.
    """
    with asked(path, sql, time_limit_s) as answer:
        import pyarrow as pa

        batches, size = [], 0
        for batch in answer.batches():
            batches.append(batch)
            size += batch.nbytes
            if size > ANSWER_BYTES:
                raise QueryError(
                    f"the answer has more than {ANSWER_BYTES >> 20} MB; ask for fewer rows or less of each"
                )
        return _frame(pa.Table.from_batches(batches, answer.schema))


def _numbered(schema: pa.Schema) -> pa.Schema:
    """The columns, those of one name told apart by numbers."""
    import pyarrow as pa

    names: list[str] = []
    for name in schema.names:
        count = 2
        unique = name
        while unique in names:
            unique, count = f"{name}_{count}", count + 1
        names.append(unique)
    return pa.schema([field.with_name(name) for field, name in zip(schema, names, strict=True)])


def _frame(rows: pa.Table | pa.RecordBatch) -> pl.DataFrame:
    import polars as pl

    try:
        return cast("pl.DataFrame", pl.from_arrow(rows))
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, NotImplementedError, ValueError) as error:
        raise QueryError(
            f"the answer holds what cannot be shown ({' '.join(str(error).split())[:200]}); cast it, for example "
            "`column::varchar`"
        ) from None


class _AtWork:
    """The process that answers a question, and how long it may let us wait."""

    def __init__(self, process: subprocess.Popen[bytes], sentence: IO[bytes], time_limit_s: float) -> None:
        self._process, self._sentence, self._time_limit_s = process, sentence, time_limit_s
        self._clock = query_process.Clock(time_limit_s + query_process.GRACE_S, process.kill)

    def batches(self, reader: pa.RecordBatchReader) -> Iterator[pa.RecordBatch]:
        while (batch := self.wait_for(lambda: next(reader, None))) is not None:
            yield batch
        with self._clock.running():
            self._process.wait()
        self._require_success()

    def wait_for(self, read: Callable[[], Found]) -> Found:
        """What is read from the process, or why there is no more of it."""
        import pyarrow as pa

        try:
            with self._clock.running():
                return read()
        except (pa.ArrowException, OSError):
            self._process.wait()
            self._require_success()
            raise

    def _require_success(self) -> None:
        """A stream that ends is not an answer that ends: the process says whether it is."""
        status = self._process.returncode
        if status == 0:
            return
        if self._clock.over:
            raise query_process.too_long(self._time_limit_s)
        if status == query_process.REFUSED:
            self._sentence.seek(0)
            raise QueryError(self._sentence.read().decode("utf-8", "replace"))
        raise QueryError(_without_memory(status))


def _without_memory(status: int) -> str:
    """What to say of a process that memory ran out for, or that DuckDB ended without a word."""
    lacking = too_little(query_process.ADDRESS_SPACE_BYTES, query_process.RESIDENT_BYTES, _WHO)
    if lacking is None and status == -signal.SIGKILL:  # not by us: the system ends programs when memory is scarce
        lacking = "the system ended the question"
    if lacking is not None:
        return _too_little(lacking)
    return (
        f"the question took more memory than it may ({query_process.MEMORY_LIMIT}), or asked what DuckDB cannot do; "
        "ask for less"
    )


def _too_little(lacking: str) -> str:
    return (
        f"there is too little memory here for questions ({lacking}); end other programs or raise the limit, and ask "
        "again"
    )


def _environment() -> dict[str, str]:
    """Where the process finds this package, and no module of the folder that the question is asked in."""
    found = [str(Path(pipeline.__file__).parents[1]), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    return os.environ | {"PYTHONPATH": os.pathsep.join(path for path in found if path)}
