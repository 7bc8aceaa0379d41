"""The data contracts: one versioned, closed schema per table, each in its own TOML file beside this one.

A column's type is `string`, `bool`, `int64`, `float` or `double`, followed by array lengths, innermost first, as
DuckDB writes them: `double[J][T]` is T waypoints of J joint values. Letters stand for lengths that differ between
tasks but must agree within one table (J joints, T waypoints, F features).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

FURTHER = "*"  # in a reference: the names of the further columns
SCALARS = ("string", "bool", "int64", "float", "double")
_TYPE = re.compile(r"(?P<scalar>[a-z0-9]+)(?P<lengths>(\[[A-Z]\])*)")


@dataclass(frozen=True)
class Column:
    """One column: `type` as above, `unit` ("" when it has none), what it means, and what its values may be.

    Attributes:
        nullable: whether a value may be missing.
        finite: whether infinities are refused, as NaN always is.
        positive: whether values must be above 0, and finite.
        least, most: bounds of the values, but for rounding; None: there is none.
    """

    name: str
    type: str
    description: str
    unit: str = ""
    nullable: bool = False
    finite: bool = False
    positive: bool = False
    least: float | None = None
    most: float | None = None

    @property
    def scalar(self) -> str:
        """The type of one element."""
        return _parse(self.type)[0]

    @property
    def lengths(self) -> tuple[str, ...]:
        """The letters of the array lengths, innermost first."""
        return _parse(self.type)[1]


@dataclass(frozen=True)
class Reference:
    """Rows that must have a counterpart in another table of the task.

    Attributes:
        columns: the columns that refer; `*` alone stands for the names of the further columns.
        table: the table referred to.
        to: its columns, one for each of `columns`; here too `*` stands for column names.
        where: which rows refer, column to value; all if empty.
        of: which rows are referred to, likewise.
        other_than: values of the first column that refer to nothing.
        complete: whether each row referred to must also have a row that refers to it.
    """

    columns: tuple[str, ...]
    table: str
    to: tuple[str, ...]
    where: Mapping[str, str]
    of: Mapping[str, str]
    other_than: tuple[str, ...]
    complete: bool


@dataclass(frozen=True)
class TableSchema:
    """A table: what a row is, key columns, columns in order, the pattern of any further columns, what rows refer to."""

    name: str
    version: int
    row: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]
    further: Column | None = None
    references: tuple[Reference, ...] = ()


@cache
def names() -> tuple[str, ...]:
    """The names of all tables that have a schema."""
    return tuple(sorted(f.name.removesuffix(".toml") for f in files(__name__).iterdir() if f.name.endswith(".toml")))


@cache
def schema(name: str) -> TableSchema:
    """The schema of the table `name`.

    Raises:
        KeyError: there is no such table.
    """
    if name not in names():
        raise KeyError(f"no schema named {name!r}; there are {', '.join(names())}")
    document = tomllib.loads((files(__name__) / f"{name}.toml").read_text(encoding="utf-8"))
    return TableSchema(
        name=name,
        version=int(document["version"]),
        row=document["row"],
        key=tuple(document["key"]),
        columns=tuple(Column(**column) for column in document["columns"]),
        further=Column(**document["further"]) if "further" in document else None,
        references=tuple(_reference(reference) for reference in document.get("references", ())),
    )


def _reference(document: Mapping[str, Any]) -> Reference:
    return Reference(
        columns=tuple(document["columns"]),
        table=document["table"],
        to=tuple(document["to"]),
        where=document.get("where", {}),
        of=document.get("of", {}),
        other_than=tuple(document.get("other_than", ())),
        complete=document.get("complete", False),
    )


def _parse(type_: str) -> tuple[str, tuple[str, ...]]:
    match = _TYPE.fullmatch(type_)
    if match is None or match["scalar"] not in SCALARS:
        raise ValueError(f"unknown column type {type_!r}; a scalar is one of {', '.join(SCALARS)}")
    return match["scalar"], tuple(match["lengths"].replace("[", "").split("]")[:-1])
