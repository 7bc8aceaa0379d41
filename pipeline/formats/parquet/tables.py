"""Parquet tables that follow a schema of `schemas/`: checked and written whole or not at all.

A table too large for memory is written and read in parts, which are the row groups of its one file; see `open_table`
for how it is read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from pipeline.errors import TableError
from pipeline.formats.files.atomic import written_whole
from pipeline.formats.parquet.checked.conformance import CONTENT_KEY, PROVENANCE_KEY, SCHEMA_KEY, to_arrow
from pipeline.formats.parquet.checked.content_digest import ContentDigest
from pipeline.formats.parquet.checked.key_ranges import KeyRanges
from pipeline.formats.parquet.checked.open_table import OpenTable
from schemas import TableSchema, schema

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa
    import pyarrow.parquet as pq


def write_table(path: Path, name: str, table: pl.DataFrame, provenance: Mapping[str, object]) -> None:
    """Write `table` as Parquet under the schema `name`; equal tables and provenance give equal bytes.

    Args:
        path: where the file appears, replacing what was there.
        name: schema in `schemas/`.
        table: the rows; its columns are brought into the schema's order and types.
        provenance: where the rows came from, stored as JSON in the file's metadata.

    Raises:
        TableError: a column is missing, unknown or of another type, a value is missing or NaN, or a key repeats.
    """
    with table_writer(path, name, provenance) as writer:
        writer.write(table)


@contextmanager
def table_writer(path: Path, name: str, provenance: Mapping[str, object]) -> Iterator[TableWriter]:
    """A table written part by part, of which only one is in memory; the file appears once all parts are written.

    Args:
        path, name, provenance: as in `write_table`.
    """
    with written_whole(path) as stream:
        writer = TableWriter(path, schema(name), provenance, stream)
        try:
            yield writer
        finally:
            writer.close()
        if not writer.parts:
            raise TableError(f"{path}: table {name!r} was given no rows, not even an empty part")


class TableWriter:
    """Parts of one table, each checked and written as one row group; made by `table_writer`."""

    def __init__(self, path: Path, contract: TableSchema, provenance: Mapping[str, object], stream: IO[bytes]) -> None:
        self._path, self._contract, self._stream = path, contract, stream
        self._metadata = {
            SCHEMA_KEY: json.dumps({"name": contract.name, "version": contract.version}).encode(),
            PROVENANCE_KEY: json.dumps(provenance, sort_keys=True).encode(),
        }
        self._file: pq.ParquetWriter | None = None
        self._keys = KeyRanges(path, contract)
        self._content: ContentDigest | None = None
        self.parts = 0

    def write(self, part: pl.DataFrame) -> None:
        """Write the next rows.

        Raises:
            TableError: as `write_table`; or the part's columns differ from those of the first, or its keys, in order,
                lie among those of another part.
        """
        import pyarrow.parquet as pq

        arrow = to_arrow(part, self._contract, self._path).replace_schema_metadata(self._metadata)
        if self._file is None or self._content is None:
            self._file = pq.ParquetWriter(
                self._stream, arrow.schema, compression="zstd", use_dictionary=_repeating(arrow.schema),
                write_page_checksum=True,
            )  # fmt: skip
            self._content = ContentDigest(arrow.schema)
        elif arrow.schema != self._file.schema:
            raise TableError(
                f"{self._path}: a part of table {self._contract.name!r} has the columns "
                f"{', '.join(arrow.schema.names)} in types or lengths that are not those of the first part"
            )
        self._keys.add(part)
        self._file.write_table(arrow)
        self._content.add(arrow)
        self.parts += 1

    def close(self) -> None:
        """Write the end of the file."""
        if self._file is not None and self._content is not None:
            self._file.add_key_value_metadata({CONTENT_KEY.decode(): self._content.hexdigest()})
            self._file.close()


def _repeating(columns: pa.Schema) -> list[str]:
    """Parquet's names of the columns written with a dictionary: all but trajectories.

    Hardly two numbers of a trajectory are alike, and to look for them takes most of the time of writing.
    """
    import pyarrow as pa

    names = []
    for column in columns:
        if not isinstance(column.type, pa.FixedSizeListType | pa.ListType):
            names.append(column.name)
        elif not isinstance(column.type.value_type, pa.FixedSizeListType | pa.ListType):
            names.append(f"{column.name}.list.element")
    return names


def read_table(path: Path, name: str, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Read a whole table, which must follow the schema `name` and its current version.

    A stage that reads several tables, or one that may be large, opens them with `TaskTables`.

    Raises:
        TableError: the file is missing, is not such a table, or breaks its schema.
    """
    with OpenTable(path, name) as table:
        rows = table.read()
    return rows if columns is None else rows.select(columns)


def empty_table(name: str, lengths: Mapping[str, int]) -> pl.DataFrame:
    """No rows in the columns of the schema `name`.

    Args:
        name: of the schema.
        lengths: of arrays, by the letters that the schema has for them.
    """
    import polars as pl

    types = {"string": pl.String, "bool": pl.Boolean, "int64": pl.Int64, "float": pl.Float32, "double": pl.Float64}
    columns: dict[str, Any] = {}
    for column in schema(name).columns:
        shape = tuple(lengths[letter] for letter in reversed(column.lengths))
        columns[column.name] = pl.Array(types[column.scalar], shape) if shape else types[column.scalar]
    return pl.DataFrame(schema=columns)
