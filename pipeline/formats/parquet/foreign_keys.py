"""Tables that refer to one another, as their schemas say: rows whose counterpart is missing are found and named.

A first pass over the tables tells whether any is missing: where every row of one must have a row of the other, from
sums of hashes of the keys, else from the distinct keys. Only if one is missing are the tables read again, to name it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from pipeline.errors import TableError
from pipeline.formats.parquet.checked.open_table import OpenTable
from schemas import FURTHER, Reference

if TYPE_CHECKING:
    import polars as pl

REMEDY = "they are not from one run, make them again with `dvc repro`"


def check_lengths(tables: Mapping[str, OpenTable]) -> None:
    """Check that arrays which several tables have are of one length.

    Raises:
        TableError: they are not.
    """
    first: dict[str, OpenTable] = {}
    for table in tables.values():
        for letter, length in table.lengths.items():
            other = first.setdefault(letter, table)
            if other.lengths[letter] != length:
                raise TableError(
                    f"{table.path}: has arrays of {letter} = {length} where {other.path} has {letter} = "
                    f"{other.lengths[letter]}; {REMEDY}"
                )


class ReferenceCheck:
    """One reference between two tables.

    Args:
        reference: of the schema of `table`.
        table: refers.
        target: is referred to.

    Attributes:
        sides: what refers and what is referred to; both must `add` every part of their table before `finish`.
    """

    def __init__(self, reference: Reference, table: OpenTable, target: OpenTable) -> None:
        self._reference = reference
        self.sides = (
            Keys(table, reference.columns, reference.where, reference.complete),
            Keys(target, reference.to, reference.of, reference.complete),
        )

    def finish(self) -> None:
        """Say which row lacks its counterpart, if one does.

        Raises:
            TableError: one does.
        """
        here, there = self.sides
        if not here.covered_by(there, self._reference.other_than):
            here.find_orphan(there, self._reference.other_than)
            if self._reference.complete:
                there.find_orphan(here, ())


class Keys:
    """Columns of a table, or the names of its further columns, as keys.

    Args:
        table: whose columns.
        columns: their names, or `*` for the names of the further columns.
        where: which rows count, column to value; all if empty.
        hashed: whether all keys are added up as hashes, or the distinct ones kept, which then should be few.

    Attributes:
        table: as given.
        needed: columns of the table that `add` needs.
    """

    def __init__(
        self, table: OpenTable, columns: tuple[str, ...], where: Mapping[str, str], hashed: bool = False
    ) -> None:
        self.table, self._columns, self._where, self._hashed = table, columns, where, hashed
        self._of_names = columns == (FURTHER,)
        self.needed = () if self._of_names else tuple(dict.fromkeys([*columns, *where]))
        self._labels = [f"key {number}" for number, _ in enumerate(columns)]
        self._count, self._hashes = 0, 0
        self._distinct: list[pl.DataFrame] = []
        if self._of_names:
            for names in self._parts():
                self._add(names)

    def add(self, part: pl.DataFrame) -> None:
        """Take the keys of a part in."""
        if not self._of_names:
            self._add(self._select(part))

    def covered_by(self, others: Keys, other_than: tuple[str, ...]) -> bool:
        """Whether each key that was added is one of the others; of hashed keys, whether they are the same ones."""
        import polars as pl

        if self._hashed:
            return (self._count, self._hashes) == (others._count, others._hashes)
        asked = _without(pl.concat(self._distinct), other_than)
        return asked.join(pl.concat(others._distinct), on=self._labels, how="anti", nulls_equal=True).is_empty()

    def find_orphan(self, others: Keys, other_than: tuple[str, ...]) -> None:
        """Read both tables again and name a key that the others do not have.

        Raises:
            TableError: there is one.
        """
        import polars as pl

        targets = pl.concat([part.select(self._labels).unique() for part in others._parts()])
        for part in self._parts():
            asked = _without(part, other_than)
            orphans = asked.join(targets, on=self._labels, how="anti", nulls_equal=True, maintain_order="left")
            if orphans.is_empty():
                continue
            *values, row = orphans.row(0)
            if self._of_names:
                said = f"has the column {values[0]!r}"
            else:
                pairs = zip(self._columns, values, strict=True)
                said = f"row {row + 1} has " + ", ".join(f"{column} {value!r}" for column, value in pairs)
            lacking = "column" if others._of_names else "row"
            raise TableError(f"{self.table.path}: {said}, for which {others.table.path} has no {lacking}; {REMEDY}")

    def _add(self, keys: pl.DataFrame) -> None:
        import numpy as np
        import polars as pl

        keys = keys.select(self._labels)
        if self._hashed:
            self._count += keys.height
            self._hashes = (self._hashes + int(keys.hash_rows().to_numpy().sum(dtype=np.uint64))) % (1 << 64)
        else:
            self._distinct = [pl.concat([*self._distinct, keys.unique()]).unique()]

    def _select(self, part: pl.DataFrame, *also: str) -> pl.DataFrame:
        import polars as pl

        rows = part.filter(*(pl.col(column) == value for column, value in self._where.items())) if self._where else part
        keys = (pl.col(column).alias(label) for column, label in zip(self._columns, self._labels, strict=True))
        return rows.select(*keys, *also)

    def _parts(self) -> Iterator[pl.DataFrame]:
        """All keys, and the numbers of their rows."""
        import polars as pl

        if self._of_names:
            own = {column.name for column in self.table.contract.columns}
            names = [name for name in self.table.columns if name not in own]
            yield pl.DataFrame({self._labels[0]: names}, schema={self._labels[0]: pl.String}).with_columns(row=0)
            return
        before = 0
        for number, rows in enumerate(self.table.parts):
            part = self.table.part(number, self.needed)
            yield self._select(part.with_row_index("row", before), "row")
            before += rows


def _without(keys: pl.DataFrame, other_than: tuple[str, ...]) -> pl.DataFrame:
    import polars as pl

    return keys.filter(~pl.nth(0).is_in(list(other_than)))
