"""The data contracts: one versioned, closed schema per table, each in its own TOML file beside this one.

A column's type is `string`, `bool`, `int64`, `float` or `double`, followed by array lengths, innermost first, as
DuckDB writes them: `double[J][T]` is T waypoints of J joint values. Letters stand for lengths that differ between
tasks but must agree within one table (J joints, T waypoints, F features).
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

SCALARS = ("string", "bool", "int64", "float", "double")
_TYPE = re.compile(r"(?P<scalar>[a-z0-9]+)(?P<lengths>(\[[A-Z]\])*)")


@dataclass(frozen=True)
class Column:
    """One column: `type` as above, `unit` ("" when it has none), what it means, and whether it may be missing."""

    name: str
    type: str
    description: str
    unit: str = ""
    nullable: bool = False

    @property
    def scalar(self) -> str:
        """The type of one element."""
        return _parse(self.type)[0]

    @property
    def lengths(self) -> tuple[str, ...]:
        """The letters of the array lengths, innermost first."""
        return _parse(self.type)[1]


@dataclass(frozen=True)
class TableSchema:
    """A table: what one row is, its key columns, its columns in order, and the pattern of further columns, if any."""

    name: str
    version: int
    row: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]
    further: Column | None = None


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
    )


def _parse(type_: str) -> tuple[str, tuple[str, ...]]:
    match = _TYPE.fullmatch(type_)
    if match is None or match["scalar"] not in SCALARS:
        raise ValueError(f"unknown column type {type_!r}; a scalar is one of {', '.join(SCALARS)}")
    return match["scalar"], tuple(match["lengths"].replace("[", "").split("]")[:-1])
