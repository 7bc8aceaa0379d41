"""Parquet tables that follow a schema of `schemas/`: checked when written and when read, whole or not at all.

A table too large for memory is written and read in parts, which are the row groups of its one file.
"""

from __future__ import annotations

import json
from bisect import bisect_left, insort
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

from pipeline.errors import TableError
from pipeline.formats.files.atomic import written_whole
from schemas import Column, TableSchema, schema

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa
    import pyarrow.parquet as pq

SCHEMA_KEY = b"lessbench.schema"
PROVENANCE_KEY = b"lessbench.provenance"
GROUPS = ("anchor", "set_size", "set_id")  # columns that say which set of alternatives a row belongs to


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
        self.parts = 0

    def write(self, part: pl.DataFrame) -> None:
        """Write the next rows.

        Raises:
            TableError: as `write_table`; or the part's columns differ from those of the first, or its keys, in order,
                lie among those of another part.
        """
        import pyarrow.parquet as pq

        arrow = _conform(part, self._contract, self._path).replace_schema_metadata(self._metadata)
        if self._file is None:
            self._file = pq.ParquetWriter(
                self._stream, arrow.schema, compression="zstd", use_dictionary=_repeating(arrow.schema),
                write_page_checksum=True,
            )  # fmt: skip
        elif arrow.schema != self._file.schema:
            raise TableError(
                f"{self._path}: a part of table {self._contract.name!r} has the columns {', '.join(arrow.schema.names)} "
                "in types or lengths that are not those of the first part"
            )
        self._keys.add(part)
        self._file.write_table(arrow)
        self.parts += 1

    def close(self) -> None:
        """Write the end of the file."""
        if self._file is not None:
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


class KeyRanges:
    """That no key is in two parts of a table, from the first and last key of each set of rows in each part.

    Keys of a set of alternatives are in order, so the ranges of two parts do not meet; what is kept is a few words per
    part, and not every key.
    """

    def __init__(self, path: Path, contract: TableSchema) -> None:
        self._path, self._contract = path, contract
        self._ranges: dict[tuple[object, ...], list[tuple[Any, Any]]] = {}

    def add(self, part: pl.DataFrame) -> None:
        """Note the keys of a part.

        Raises:
            TableError: they lie among those of an earlier part.
        """
        import polars as pl

        *within, last = self._contract.key
        sets = [name for name in GROUPS if name in part.columns and name not in self._contract.key]
        ends = part.group_by(*within, *sets, pl.lit(0)).agg(low=pl.col(last).min(), high=pl.col(last).max())
        ranges: dict[tuple[object, ...], list[tuple[Any, Any]]] = {}
        for *where, low, high in ends.select(*within, "low", "high").iter_rows():
            ranges.setdefault(tuple(where), []).append((low, high))
        for prefix, found in ranges.items():
            known = self._ranges.setdefault(prefix, [])
            joined = _disjoint(found)
            for low, high in joined:
                place = bisect_left(known, (low, high))
                if any(low <= end and begin <= high for begin, end in known[max(place - 1, 0) : place + 1]):
                    raise TableError(
                        f"{self._path}: a part of table {self._contract.name!r} has the {last} from {low!r} to {high!r}, "
                        "among those of another part; each row is in one part, in order"
                    )
            for both in joined:
                insort(known, both)


def _disjoint(ranges: Sequence[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """The ranges in order, those that overlap joined."""
    joined: list[tuple[Any, Any]] = []
    for low, high in sorted(ranges):
        if joined and low <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(high, joined[-1][1]))
        else:
            joined.append((low, high))
    return joined


def read_table(path: Path, name: str, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Read the table at `path`, which must follow the schema `name` and its current version.

    Raises:
        TableError: the file is missing, is not such a table, or breaks its schema.
    """
    import polars as pl

    with _opened(path, schema(name)) as file:
        table = pl.DataFrame(_sound(file.read(), schema(name), path))
    _conform(table, schema(name), path)
    return table if columns is None else table.select(columns)


def part_rows(path: Path, name: str) -> tuple[int, ...]:
    """How many rows each part of a table has, that is each row group of its file.

    Raises:
        TableError: the file is missing or is not such a table.
    """
    with _opened(path, schema(name)) as file:
        metadata = file.metadata
        return tuple(metadata.row_group(number).num_rows for number in range(metadata.num_row_groups))


def column_names(path: Path, name: str) -> tuple[str, ...]:
    """The names of all columns of a table.

    Raises:
        TableError: the file is missing or is not such a table.
    """
    with _opened(path, schema(name)) as file:
        return tuple(file.schema_arrow.names)


def array_lengths(path: Path, name: str) -> dict[str, int]:
    """The lengths of a table's arrays by the letters that its schema gives them.

    Raises:
        TableError: the file is missing or is not such a table.
    """
    import pyarrow as pa

    found: dict[str, int] = {}
    with _opened(path, schema(name)) as file:
        types = {field.name: field.type for field in file.schema_arrow}
        for column in schema(name).columns:
            type_ = types.get(column.name, pa.null())
            for letter in reversed(column.lengths):
                if pa.types.is_fixed_size_list(type_):
                    found[letter], type_ = type_.list_size, type_.value_type
    return found


def read_part(path: Path, name: str, number: int, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Read one part of a table, checked as far as the columns asked for go; all of them by default.

    Raises:
        TableError: as `read_table`.
    """
    import polars as pl

    contract = schema(name)
    with _opened(path, contract) as file:
        present = file.schema_arrow.names
        absent = [column for column in columns or () if column not in present]
        if absent:
            raise TableError(
                f"{path}: table {name!r} lacks the column {absent[0]!r}; it has {', '.join(present)}; make it again "
                "with `dvc repro`"
            )
        first = sum(file.metadata.row_group(before).num_rows for before in range(number))
        part = pl.DataFrame(
            _sound(file.read_row_group(number, columns=None if columns is None else list(columns)), contract, path)
        )
    _conform(part, contract if columns is None else _narrowed(contract, columns), path, first)
    return part if columns is None else part.select(columns)


def _narrowed(contract: TableSchema, columns: Sequence[str]) -> TableSchema:
    """The contract of some of the columns; without a column of the key, rows may repeat."""
    kept = tuple(column for column in contract.columns if column.name in columns)
    key = contract.key if set(contract.key) <= set(columns) else ()
    return replace(contract, columns=kept, key=key)


@contextmanager
def _opened(path: Path, contract: TableSchema) -> Iterator[pq.ParquetFile]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with path.open("rb") as stream, pq.ParquetFile(stream, page_checksum_verification=True) as file:
            stated = _stated(file.schema_arrow.metadata or {}, path)
            if stated != (contract.name, contract.version):
                raise TableError(
                    f"{path}: holds table {stated[0]!r} version {stated[1]}, needed is {contract.name!r} version "
                    f"{contract.version}; make it again with `dvc repro`"
                )
            yield file
    except FileNotFoundError:
        raise TableError(f"{path}: there is no such file; run the stage that makes it with `dvc repro`") from None
    except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
        raise TableError(
            f"{path}: cannot be read as Parquet ({_one_line(error)}); make it again with `dvc repro`"
        ) from None


def _sound(table: pa.Table, contract: TableSchema, path: Path) -> pa.Table:
    """The table without metadata, its types those of the schema and its texts valid, as polars takes for granted."""
    import pyarrow as pa

    known = {column.name: column for column in contract.columns}
    for field in table.schema:
        column = known.get(field.name, contract.further)
        inner, depth = field.type, 0
        while pa.types.is_fixed_size_list(inner):
            inner, depth = inner.value_type, depth + 1
        if column is not None and (inner != _scalars()[column.scalar] or depth != len(column.lengths)):
            raise TableError(
                f"{path}: column {field.name!r} is {field.type}, needed is {column.type}; make it again with `dvc repro`"
            )
    table.validate(full=True)
    return table.cast(pa.schema([pa.field(field.name, field.type) for field in table.schema]))


def _scalars() -> dict[str, pa.DataType]:
    import pyarrow as pa

    return {
        "string": pa.string(), "bool": pa.bool_(), "int64": pa.int64(), "float": pa.float32(), "double": pa.float64(),
    }  # fmt: skip


def read_provenance(path: Path) -> dict[str, object]:
    """What `write_table` stored about where the rows of `path` came from.

    Raises:
        TableError: the file is missing or is no Parquet.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_schema(path).metadata or {}
    except (pa.ArrowInvalid, OSError) as error:
        raise TableError(
            f"{path}: cannot be read as Parquet ({_one_line(error)}); make it again with `dvc repro`"
        ) from None
    provenance: dict[str, object] = json.loads(metadata.get(PROVENANCE_KEY, b"{}"))
    return provenance


def _stated(metadata: Mapping[bytes, bytes], path: Path) -> tuple[str, int]:
    try:
        stated = json.loads(metadata[SCHEMA_KEY])
        return str(stated["name"]), int(stated["version"])
    except (KeyError, TypeError, ValueError):
        raise TableError(f"{path}: does not say which table it holds; make it again with `dvc repro`") from None


def _conform(table: pl.DataFrame, contract: TableSchema, path: Path, first: int = 0) -> pa.Table:
    """The table as the schema has it; `first` rows of the file are before it."""
    import polars as pl
    import pyarrow as pa

    known = {column.name: column for column in contract.columns}
    missing = [name for name in known if name not in table.columns]
    further = [name for name in table.columns if name not in known]
    if missing:
        raise TableError(
            f"{path}: table {contract.name!r} lacks the column {missing[0]!r}; it has {', '.join(table.columns)}"
        )
    if further and contract.further is None:
        raise TableError(
            f"{path}: table {contract.name!r} has no column {further[0]!r}; allowed are {', '.join(known)}"
        )
    lengths: dict[str, int] = {}
    arrays, fields = [], []
    for name in [*known, *further]:
        column = known[name] if name in known else cast("Column", contract.further)
        _check_values(table, name, column, path, first)
        type_ = _arrow_type(table, name, column, lengths, path)
        arrays.append(table[name].to_arrow().cast(type_))
        fields.append(pa.field(name, type_, nullable=column.nullable))
    repeated = table.select(contract.key).is_duplicated() if contract.key else pl.Series([], dtype=pl.Boolean)
    if repeated.any():
        place = int(repeated.arg_max() or 0)
        row = table.select(contract.key).row(place, named=True)
        raise TableError(
            f"{path}: table {contract.name!r} has more than one row for {row}, the first is row {first + place + 1}; each row is "
            f"{contract.row}"
        )
    return pa.table(arrays, schema=pa.schema(fields))


def _check_values(table: pl.DataFrame, name: str, column: Column, path: Path, first: int) -> None:
    values = table[name]
    if not column.nullable and values.null_count():
        raise TableError(
            f"{path}: column {name!r} has {values.null_count()} missing values, which it may not have; the first is in "
            f"row {_row(values.is_null(), table, first)}"
        )
    for _ in column.lengths:
        if not hasattr(values.dtype, "inner"):
            raise TableError(f"{path}: column {name!r} is {table[name].dtype}, needed is {column.type}")
        values = values.explode()
        if not column.nullable and values.null_count():
            raise TableError(
                f"{path}: column {name!r} has a gap within row {_row(values.is_null(), table, first)}, which it may not have"
            )
    if column.scalar in ("float", "double"):
        if not values.dtype.is_numeric():
            raise TableError(f"{path}: column {name!r} is {values.dtype}, needed is {column.type}")
        if not values.dtype.is_float():
            return
        for what, found in (
            ("NaN", values.is_nan()),
            *([("an infinite value", values.is_infinite())] if column.finite or column.positive else []),
            *([("a value that is not above 0", values <= 0)] if column.positive else []),
        ):
            if found.any():
                raise TableError(
                    f"{path}: column {name!r} holds {what} in row {_row(found, table, first)}, which is never allowed"
                )


def _row(found: pl.Series, table: pl.DataFrame, first: int) -> int:
    """The row of the table, from 1, that holds the first of the values found; arrays lie one behind the other."""
    return first + int(found.fill_null(False).arg_max() or 0) // (len(found) // table.height) + 1


def _arrow_type(table: pl.DataFrame, name: str, column: Column, lengths: dict[str, int], path: Path) -> pa.DataType:
    import polars as pl
    import pyarrow as pa

    type_ = _scalars()[column.scalar]
    dtype = table.schema[name]
    shape = dtype.shape if isinstance(dtype, pl.Array) else ()
    if len(shape) != len(column.lengths):
        raise TableError(f"{path}: column {name!r} is {dtype}, needed is {column.type} (arrays of fixed length)")
    for letter, length in zip(column.lengths, reversed(shape), strict=True):
        if lengths.setdefault(letter, length) != length:
            raise TableError(f"{path}: column {name!r} has {length} where the table has {letter} = {lengths[letter]}")
        type_ = pa.list_(type_, length)
    return type_


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
