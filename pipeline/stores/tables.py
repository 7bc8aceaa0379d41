"""Parquet tables that follow a schema of `schemas/`: checked when written and when read, whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from pipeline.errors import TableError
from pipeline.stores.whole import written_whole
from schemas import Column, TableSchema, schema

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa

SCHEMA_KEY = b"lessbench.schema"
PROVENANCE_KEY = b"lessbench.provenance"


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
    import pyarrow.parquet as pq

    contract = schema(name)
    arrow = _conform(table, contract, path)
    metadata = {
        SCHEMA_KEY: json.dumps({"name": contract.name, "version": contract.version}).encode(),
        PROVENANCE_KEY: json.dumps(provenance, sort_keys=True).encode(),
    }
    with written_whole(path) as stream:
        pq.write_table(arrow.replace_schema_metadata(metadata), stream, compression="zstd")


def read_table(path: Path, name: str, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Read the table at `path`, which must follow the schema `name` and its current version.

    Raises:
        TableError: the file is missing, is not such a table, or breaks its schema.
    """
    import polars as pl
    import pyarrow as pa
    import pyarrow.parquet as pq

    contract = schema(name)
    try:
        with path.open("rb") as stream, pq.ParquetFile(stream) as file:
            stated = _stated(file.schema_arrow.metadata or {}, path)
            if stated != (contract.name, contract.version):
                raise TableError(
                    f"{path}: holds table {stated[0]!r} version {stated[1]}, needed is {contract.name!r} version "
                    f"{contract.version}; make it again with `dvc repro`"
                )
            table = pl.DataFrame(file.read())
    except FileNotFoundError:
        raise TableError(f"{path}: there is no such file; run the stage that makes it with `dvc repro`") from None
    except (pa.ArrowInvalid, OSError) as error:
        raise TableError(
            f"{path}: cannot be read as Parquet ({_one_line(error)}); make it again with `dvc repro`"
        ) from None
    _conform(table, contract, path)
    return table if columns is None else table.select(columns)


def read_provenance(path: Path) -> dict[str, object]:
    """What `write_table` stored about where the rows of `path` came from."""
    import pyarrow.parquet as pq

    metadata = pq.read_schema(path).metadata or {}
    provenance: dict[str, object] = json.loads(metadata.get(PROVENANCE_KEY, b"{}"))
    return provenance


def _stated(metadata: Mapping[bytes, bytes], path: Path) -> tuple[str, int]:
    try:
        stated = json.loads(metadata[SCHEMA_KEY])
        return str(stated["name"]), int(stated["version"])
    except (KeyError, TypeError, ValueError):
        raise TableError(f"{path}: does not say which table it holds; make it again with `dvc repro`") from None


def _conform(table: pl.DataFrame, contract: TableSchema, path: Path) -> pa.Table:
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
        _check_values(table, name, column, path)
        type_ = _arrow_type(table, name, column, lengths, path)
        arrays.append(table[name].to_arrow().cast(type_))
        fields.append(pa.field(name, type_, nullable=column.nullable))
    repeated = table.select(contract.key).is_duplicated()
    if repeated.any():
        row = table.select(contract.key).row(int(repeated.arg_max() or 0), named=True)
        raise TableError(f"{path}: table {contract.name!r} has more than one row for {row}; each row is {contract.row}")
    return pa.table(arrays, schema=pa.schema(fields))


def _check_values(table: pl.DataFrame, name: str, column: Column, path: Path) -> None:
    values = table[name]
    if not column.nullable and values.null_count():
        raise TableError(f"{path}: column {name!r} has {values.null_count()} missing values, which it may not have")
    for _ in column.lengths:
        if not hasattr(values.dtype, "inner"):
            raise TableError(f"{path}: column {name!r} is {table[name].dtype}, needed is {column.type}")
        values = values.explode()
    if column.scalar in ("float", "double"):
        if not values.dtype.is_numeric():
            raise TableError(f"{path}: column {name!r} is {values.dtype}, needed is {column.type}")
        if values.is_nan().any() if values.dtype.is_float() else False:
            raise TableError(f"{path}: column {name!r} holds NaN, which is never allowed")


def _arrow_type(table: pl.DataFrame, name: str, column: Column, lengths: dict[str, int], path: Path) -> pa.DataType:
    import polars as pl
    import pyarrow as pa

    scalars = {
        "string": pa.string(), "bool": pa.bool_(), "int64": pa.int64(), "float": pa.float32(), "double": pa.float64(),
    }  # fmt: skip
    type_ = scalars[column.scalar]
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
