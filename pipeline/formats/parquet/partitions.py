"""Sets of alternatives in tables that are read part by part: where their rows are, and how they get there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.formats.parquet.checked.conformance import GROUPS
from pipeline.formats.parquet.checked.open_table import Piece
from pipeline.formats.parquet.table_file import TableFile
from pipeline.formats.parquet.tables import TableWriter

SetKey = tuple[str, int, str]  # anchor, set_size and set_id
PARTITIONS = 10  # of alternatives whose features are read at once: their rows are far smaller than waypoints


@dataclass(frozen=True)
class SetRows:
    """Where the rows of one set of alternatives are in a table, in order.

    Attributes:
        anchor, set_size, set_id: which set.
        pieces: its rows.
    """

    anchor: str
    set_size: int
    set_id: str
    pieces: tuple[Piece, ...]

    @property
    def key(self) -> SetKey:
        """Anchor, size and number of the set."""
        return self.anchor, self.set_size, self.set_id

    @property
    def rows(self) -> int:
        """How many."""
        return sum(piece.count for piece in self.pieces)

    def between(self, start: int, stop: int) -> tuple[Piece, ...]:
        """The pieces that hold the set's rows from `start` to `stop`."""
        found, before = [], 0
        for piece in self.pieces:
            first, last = max(start - before, 0), min(stop - before, piece.count)
            if first < last:
                found.append(replace(piece, first=piece.first + first, count=last - first))
            before += piece.count
        return tuple(found)


@dataclass(frozen=True)
class Contents:
    """Where the rows of a table are.

    Attributes:
        sets: all sets of alternatives, in order of their first rows.
        others: rows of no set, such as demonstrations.
    """

    sets: tuple[SetRows, ...]
    others: tuple[Piece, ...]


class SetIndex:
    """Finds the sets of a table while its parts go by, the first part first."""

    columns = GROUPS

    def __init__(self) -> None:
        self._pieces: dict[SetKey, list[Piece]] = {}
        self._others: list[Piece] = []

    def add(self, number: int, part: pl.DataFrame) -> None:
        """Take in the rows of a part."""
        for (anchor, set_size, set_id), piece in runs(number, part, GROUPS):
            where = self._others if set_id is None else self._pieces.setdefault((anchor, set_size, set_id), [])
            where.append(piece)

    @property
    def contents(self) -> Contents:
        """Where the rows of the parts are."""
        return Contents(
            tuple(SetRows(*key, tuple(pieces)) for key, pieces in self._pieces.items()), tuple(self._others)
        )


def runs(number: int, part: pl.DataFrame, columns: Sequence[str]) -> Iterator[tuple[tuple[Any, ...], Piece]]:
    """Runs of rows with the same values in some columns: these values, and where in the part the rows are."""
    firsts = (
        part.lazy()
        .select(*columns, row=pl.int_range(pl.len()), run=pl.struct(columns).rle_id())
        .group_by("run", maintain_order=True)
        .agg(*(pl.col(column).first() for column in columns), first=pl.col("row").first(), count=pl.len())
        .collect()
    )
    for _, *values, first, count in firsts.iter_rows():
        yield tuple(values), Piece(number, first, count)


class Gathered:
    """Rows on their way into a table, gathered to parts of about `partition` rows."""

    def __init__(self, writer: TableWriter, partition: int) -> None:
        self._writer, self._partition = writer, partition
        self._waiting: list[pl.DataFrame] = []
        self.rows = 0

    def add(self, rows: pl.DataFrame) -> None:
        """The next rows; they stay together in one part."""
        if self._waiting and sum(table.height for table in self._waiting) + rows.height > self._partition:
            self.flush()
        self._waiting.append(rows)
        self.rows += rows.height

    def flush(self) -> None:
        """Write what is waiting as a part."""
        if self._waiting:
            self._writer.write(pl.concat(self._waiting))
            self._waiting = []


@contextmanager
def gathered(writer: TableWriter, partition: int) -> Iterator[Gathered]:
    """Gather rows into parts of a table; the last is written at the end."""
    rows = Gathered(writer, partition)
    yield rows
    rows.flush()


def cut(count: int, partition: int) -> Iterator[tuple[int, int]]:
    """(first, rows) of each part of `count` rows."""
    for first in range(0, count, partition):
        yield first, min(partition, count - first)


def batches(sets: Sequence[SetRows], count: int, partition: int) -> list[tuple[SetRows, ...]]:
    """Sets that follow each other in some `count` batches of about as many rows, up to a partition."""
    most = min(-(-sum(one.rows for one in sets) // count), partition)
    found: list[tuple[SetRows, ...]] = []
    waiting: list[SetRows] = []
    for one in sets:
        if waiting and sum(other.rows for other in waiting) + one.rows > most:
            found.append(tuple(waiting))
            waiting = []
        waiting.append(one)
    return [*found, tuple(waiting)]


@dataclass(frozen=True, eq=False)
class Scaled:
    """Scaled features of a task's table.

    Attributes:
        file: features.parquet.
        names: of the features.
        scale: (F,) what they are divided by.
    """

    file: TableFile
    names: tuple[str, ...]
    scale: FloatArray

    def read(self, pieces: Sequence[Piece]) -> FloatArray:
        """(M, F) of some rows, one part of the table after another."""
        return np.asarray(self.file.table().numbers(pieces, self.names) / self.scale)
