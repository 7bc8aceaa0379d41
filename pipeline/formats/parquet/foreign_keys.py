"""Tables that refer to one another, as their schemas say: rows whose counterpart is missing are found and named.

Tables of any size are looked at part by part. Where every row of one must have a row of the other, sums of hashes of the
keys tell whether they do; only where they do not are the keys themselves compared, to name one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import TableError
from pipeline.formats.parquet.tables import array_lengths, column_names, part_rows, read_part
from schemas import FURTHER, Reference, schema

if TYPE_CHECKING:
    import polars as pl

REMEDY = "they are not from one run, make them again with `dvc repro`"


def check_references(files: Mapping[str, Path]) -> None:
    """Check tables that are read together.

    Args:
        files: the tables by the names of their schemas.

    Raises:
        TableError: a row refers to one that is not there, or arrays that should be of one length are not; or a file is
            missing or breaks its schema.
    """
    _check_lengths(files)
    for name, path in files.items():
        for reference in schema(name).references:
            if reference.table in files:
                _check(name, path, reference, files[reference.table])


def check_table(path: Path, name: str) -> None:
    """Check a whole table against its schema, part by part; each part alone, as reading does.

    Raises:
        TableError: see `read_part`.
    """
    for number in range(len(part_rows(path, name))):
        read_part(path, name, number)


def _check_lengths(files: Mapping[str, Path]) -> None:
    known: dict[str, tuple[int, Path]] = {}
    for name, path in files.items():
        for letter, length in array_lengths(path, name).items():
            other, where = known.setdefault(letter, (length, path))
            if other != length:
                raise TableError(
                    f"{path}: has arrays of {letter} = {length} where {where} has {letter} = {other}; {REMEDY}"
                )


def _check(name: str, path: Path, reference: Reference, target: Path) -> None:
    here = _Keys(path, name, reference.columns, reference.where)
    there = _Keys(target, reference.table, reference.to, reference.of)
    if reference.complete and here.fingerprint() == there.fingerprint():
        return
    here.find_orphan(there, reference.other_than)
    if reference.complete:
        there.find_orphan(here, ())


@dataclass(frozen=True)
class _Keys:
    """Columns of a table, or the names of its further columns, as keys that are read part by part."""

    path: Path
    name: str
    columns: tuple[str, ...]
    where: Mapping[str, str]

    @property
    def labels(self) -> list[str]:
        """What the columns of the keys are called."""
        return [f"key {number}" for number, _ in enumerate(self.columns)]

    def parts(self) -> Iterator[pl.DataFrame]:
        """The keys, with the number of their row."""
        import polars as pl

        if self.columns == (FURTHER,):
            own = {column.name for column in schema(self.name).columns}
            names = [column for column in column_names(self.path, self.name) if column not in own]
            yield pl.DataFrame({self.labels[0]: names}, schema={self.labels[0]: pl.String}).with_row_index("row")
            return
        before = 0
        for number, rows in enumerate(part_rows(self.path, self.name)):
            part = read_part(self.path, self.name, number, [*dict.fromkeys([*self.columns, *self.where])])
            rows_kept = part.with_row_index("row", before).filter(
                *(pl.col(column) == value for column, value in self.where.items())
            )
            keys = (pl.col(column).alias(label) for column, label in zip(self.columns, self.labels, strict=True))
            yield rows_kept.select("row", *keys)
            before += rows

    def fingerprint(self) -> tuple[int, int]:
        """How many keys there are, and the sum of their hashes, whatever their order."""
        import numpy as np

        count, total = 0, 0
        for part in self.parts():
            count += part.height
            total += int(part.select(self.labels).hash_rows().to_numpy().sum(dtype=np.uint64))
        return count, total % (1 << 64)

    def find_orphan(self, others: _Keys, other_than: tuple[str, ...]) -> None:
        """Name a key that the others do not have."""
        import polars as pl

        known = pl.concat([part.select(self.labels).unique() for part in others.parts()])
        for part in self.parts():
            asked = part.filter(~pl.col(self.labels[0]).is_in(list(other_than)))
            orphans = asked.join(known, on=self.labels, how="anti", nulls_equal=True, maintain_order="left")
            if orphans.is_empty():
                continue
            row, *values = orphans.row(0)
            if self.columns == (FURTHER,):
                said = f"has the column {values[0]!r}"
            else:
                pairs = zip(self.columns, values, strict=True)
                said = f"row {row + 1} has " + ", ".join(f"{column} {value!r}" for column, value in pairs)
            lacking = "column" if others.columns == (FURTHER,) else "row"
            raise TableError(f"{self.path}: {said}, for which {others.path} has no {lacking}; {REMEDY}")
