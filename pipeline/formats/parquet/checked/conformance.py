"""Whether columns and values are those that a schema of `schemas/` asks for, in memory and in a file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, cast

from pipeline.errors import TableError
from schemas import Column, TableSchema

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa

SCHEMA_KEY = b"lessbench.schema"
PROVENANCE_KEY = b"lessbench.provenance"
CONTENT_KEY = b"lessbench.content"
GROUPS = ("anchor", "set_size", "set_id")  # columns that say which set of alternatives a row belongs to
ROUNDING = 1e-9  # beyond a bound: sums of probabilities and logarithms of them carry errors of 1e-12
REMEDY = "make it again with `dvc repro`"


def to_arrow(table: pl.DataFrame, contract: TableSchema, path: Path) -> pa.Table:
    """A table with the columns of its schema in their order and types, its values checked.

    Raises:
        TableError: a column is missing, unknown or of another type, a value is not allowed, or a key repeats.
    """
    import pyarrow as pa

    columns = _ordered(table.columns, contract, path)
    check_values(table, columns, path)
    check_keys(table, contract, path)
    lengths: dict[str, int] = {}
    arrays, fields = [], []
    for name, column in columns.items():
        type_ = _arrow_type(table, name, column, lengths, path)
        arrays.append(table[name].to_arrow().cast(type_))
        fields.append(pa.field(name, type_, nullable=column.nullable))
    return pa.table(arrays, schema=pa.schema(fields))


def check_file_schema(columns: pa.Schema, contract: TableSchema, path: Path) -> dict[str, int]:
    """Check what a file says of its table and columns, before any row is read.

    Returns:
        the lengths of the table's arrays by the letters that its schema gives them.

    Raises:
        TableError: it holds another table or version, or a column is missing, unknown or of another type.
    """
    import pyarrow as pa

    name, version = _named_schema(columns.metadata or {}, path)
    if (name, version) != (contract.name, contract.version):
        raise TableError(
            f"{path}: holds table {name!r} version {version}, needed is {contract.name!r} version {contract.version}; "
            f"{REMEDY}"
        )
    lengths: dict[str, int] = {}
    for name, column in _ordered(columns.names, contract, path, f"; {REMEDY}").items():
        inner, sizes = columns.field(name).type, list[int]()
        while pa.types.is_fixed_size_list(inner):
            sizes.append(inner.list_size)
            inner = inner.value_type
        if inner != _scalars()[column.scalar] or len(sizes) != len(column.lengths):
            raise TableError(
                f"{path}: column {name!r} is {columns.field(name).type}, needed is {column.type}; {REMEDY}"
            )
        for letter, size in zip(reversed(column.lengths), sizes, strict=True):
            _agree(lengths, letter, size, name, path)
    return lengths


def stored_provenance(metadata: Mapping[bytes, bytes], path: Path) -> dict[str, object]:
    """What the metadata of a file says about where its rows came from.

    Raises:
        TableError: it cannot be read.
    """
    try:
        provenance = json.loads(metadata.get(PROVENANCE_KEY, b"{}"))
        sound = isinstance(provenance, dict) and all(
            _is_digests(value) if key == "inputs" else value is None or _is_plain(key, value)
            for key, value in provenance.items()
        )
    except (ValueError, RecursionError):
        sound = False
    if not sound:
        raise TableError(f"{path}: what it says of its making is not what a stage writes; {REMEDY}")
    return dict(provenance)


def _is_digests(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(digest, str) for digest in value.values())


def _is_plain(key: str, value: object) -> bool:
    if key == "seed":
        return type(value) is int and abs(value) < 1 << 63
    return isinstance(value, str)


def check_values(table: pl.DataFrame, columns: Mapping[str, Column], path: Path, first: int = 0) -> None:
    """Check that no value is missing, NaN, infinite or out of range where that is not allowed.

    Args:
        table: some rows.
        columns: those of its columns that are checked.
        path: of the file, for the message.
        first: how many rows of the file are before them.

    Raises:
        TableError: a value is not allowed; the message names its row.
    """
    for name, column in columns.items():
        _check_column(table, name, column, path, first)


def check_keys(table: pl.DataFrame, contract: TableSchema, path: Path, first: int = 0) -> None:
    """Check that no key repeats within some rows; arguments as in `check_values`.

    Raises:
        TableError: a key repeats; the message names its row.
    """
    keys = table.select(contract.key)
    if keys.hash_rows().n_unique() == keys.height:  # different hashes are of different keys
        return
    repeated = keys.is_duplicated()
    if repeated.any():
        place = int(repeated.arg_max() or 0)
        raise TableError(
            f"{path}: table {contract.name!r} has more than one row for {keys.row(place, named=True)}, the first is "
            f"row {first + place + 1}; each row is {contract.row}"
        )


def columns_of(names: Iterable[str], contract: TableSchema) -> dict[str, Column]:
    """The columns of these names; those that the schema does not name are what it says of further ones."""
    known = {column.name: column for column in contract.columns}
    return {name: known[name] if name in known else cast("Column", contract.further) for name in names}


def _ordered(names: list[str], contract: TableSchema, path: Path, remedy: str = "") -> dict[str, Column]:
    """All columns, those of the schema first."""
    known = [column.name for column in contract.columns]
    missing = [name for name in known if name not in names]
    further = [name for name in names if name not in known]
    if missing:
        raise TableError(
            f"{path}: table {contract.name!r} lacks the column {missing[0]!r}; it has {', '.join(names)}{remedy}"
        )
    if further and contract.further is None:
        raise TableError(
            f"{path}: table {contract.name!r} has no column {further[0]!r}; allowed are {', '.join(known)}{remedy}"
        )
    return columns_of([*known, *further], contract)


def _named_schema(metadata: Mapping[bytes, bytes], path: Path) -> tuple[str, int]:
    try:
        stated = json.loads(metadata[SCHEMA_KEY])
        return str(stated["name"]), int(stated["version"])
    except (KeyError, TypeError, ValueError):
        raise TableError(f"{path}: does not say which table it holds; {REMEDY}") from None


def _check_column(table: pl.DataFrame, name: str, column: Column, path: Path, first: int) -> None:
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
                f"{path}: column {name!r} has a gap within row {_row(values.is_null(), table, first)}, which it may "
                "not have"
            )
    if column.scalar in ("int64", "float", "double"):
        if not values.dtype.is_numeric():
            raise TableError(f"{path}: column {name!r} is {values.dtype}, needed is {column.type}")
        floats = values.dtype.is_float()
        for what, wrong in (
            *([("NaN", values.is_nan())] if floats else []),
            *([("an infinite value", values.is_infinite())] if floats and (column.finite or column.positive) else []),
            *([("a value that is not above 0", values <= 0)] if column.positive else []),
        ):
            if wrong.any():
                raise TableError(
                    f"{path}: column {name!r} holds {what} in row {_row(wrong, table, first)}, which is never allowed"
                )
        _check_range(values, table, name, column, path, first)


def _check_range(values: pl.Series, table: pl.DataFrame, name: str, column: Column, path: Path, first: int) -> None:
    for bound, side in ((column.least, "least"), (column.most, "most")):
        if bound is None:
            continue
        beyond = values < bound - ROUNDING if side == "least" else values > bound + ROUNDING
        if beyond.any():
            value = values.filter(beyond)[0]
            raise TableError(
                f"{path}: column {name!r} holds {value:g} in row {_row(beyond, table, first)}; it is at {side} "
                f"{bound:g}; {REMEDY}"
            )


def _row(wrong: pl.Series, table: pl.DataFrame, first: int) -> int:
    """The row of the file, from 1, that holds the first wrong value; arrays lie one behind the other."""
    return first + int(wrong.fill_null(False).arg_max() or 0) // (len(wrong) // table.height) + 1


def _arrow_type(table: pl.DataFrame, name: str, column: Column, lengths: dict[str, int], path: Path) -> pa.DataType:
    import polars as pl
    import pyarrow as pa

    type_ = _scalars()[column.scalar]
    dtype = table.schema[name]
    shape = dtype.shape if isinstance(dtype, pl.Array) else ()
    if len(shape) != len(column.lengths):
        raise TableError(f"{path}: column {name!r} is {dtype}, needed is {column.type} (arrays of fixed length)")
    for letter, length in zip(column.lengths, reversed(shape), strict=True):
        _agree(lengths, letter, length, name, path)
        type_ = pa.list_(type_, length)
    return type_


def _agree(lengths: dict[str, int], letter: str, length: int, name: str, path: Path) -> None:
    if lengths.setdefault(letter, length) != length:
        raise TableError(f"{path}: column {name!r} has {length} where the table has {letter} = {lengths[letter]}")


def _scalars() -> dict[str, pa.DataType]:
    import pyarrow as pa

    return {
        "string": pa.string(), "bool": pa.bool_(), "int64": pa.int64(), "float": pa.float32(), "double": pa.float64(),
    }  # fmt: skip
