"""Answers for other programs: CSV, JSON and Parquet, written as the rows come."""

from __future__ import annotations

import json
from typing import IO, TYPE_CHECKING

from pipeline.errors import QueryError
from pipeline.terminal import plain

if TYPE_CHECKING:
    import polars as pl

    from pipeline.formats.duckdb.questions import Answer

_FORMULA = "^[=+\\-@\t\r\n＝＋－＠]"  # what a spreadsheet takes for the beginning of one, in wide letters as well
_GROUP_ROWS, _GROUP_BYTES = 100_000, 32 << 20  # of a row group of Parquet, at most by about a batch


def write_csv(answer: Answer, stream: IO[bytes], *, formulas: bool = True, for_terminal: bool = False) -> None:
    """Write an answer as CSV, lists as JSON.

    Args:
        answer: its rows are taken.
        stream: where to.
        formulas: False puts an apostrophe before texts that a spreadsheet would take for formulas.
        for_terminal: whether texts are made plain, since a terminal shows them.

    Raises:
        QueryError: as of `Answer.frames`.
    """
    import polars as pl

    names = _texts(pl.Series(answer.schema.names, dtype=pl.String), formulas, for_terminal)
    stream.write(pl.DataFrame([names.to_list()], orient="row").write_csv(include_header=False).encode())
    for frame in answer.frames():
        flat = frame.with_columns(_texts(frame[name], formulas, for_terminal) for name in frame.columns)
        stream.write(flat.write_csv(include_header=False).encode())


def write_json(answer: Answer, stream: IO[bytes]) -> None:
    """Write an answer as a JSON list with one object per row.

    Raises:
        QueryError: as of `Answer.frames`.
    """
    before = "[\n "
    for frame in answer.frames():
        texts = []
        for row in frame.iter_rows(named=True):
            text = json.dumps(row, indent=1, default=str)
            texts.append(before + text.replace("\n", "\n ").replace("\x7f", "\\u007f"))
            before = ",\n "
        stream.write("".join(texts).encode())
    stream.write(b"[]\n" if before.startswith("[") else b"\n]\n")


def write_parquet(answer: Answer, stream: IO[bytes]) -> None:
    """Write an answer as Parquet.

    Raises:
        QueryError: as of `Answer.batches`, or values are of a kind that Parquet does not have.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetWriter(stream, answer.schema, compression="zstd") as writer:
            group, size, rows = [], 0, 0
            for batch in answer.batches():
                group.append(batch)
                size, rows = size + batch.nbytes, rows + batch.num_rows
                if rows >= _GROUP_ROWS or size >= _GROUP_BYTES:
                    writer.write_table(pa.Table.from_batches(group))
                    group, size, rows = [], 0, 0
            writer.write_table(pa.Table.from_batches(group, answer.schema))
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, pa.ArrowTypeError) as error:
        raise QueryError(
            f"the answer cannot be written as Parquet ({' '.join(str(error).split())}); cast it, for example "
            "`column::varchar`"
        ) from None


def _texts(column: pl.Series, formulas: bool, for_terminal: bool) -> pl.Series:
    """A column as CSV has it: lists as JSON, texts made harmless as far as asked."""
    import polars as pl

    if column.dtype.is_nested():
        texts = [None if value is None else json.dumps(value, default=str) for value in column.to_list()]
        column = pl.Series(column.name, texts, pl.String)
    if not isinstance(column.dtype, pl.String | pl.Categorical | pl.Enum):
        return column
    column = column.cast(pl.String)
    if for_terminal:
        column = column.map_elements(plain, pl.String)
    if not formulas:
        begins = column.str.contains(_FORMULA)
        column = pl.select(pl.when(begins).then("'" + column).otherwise(column).alias(column.name)).to_series()
    return column
