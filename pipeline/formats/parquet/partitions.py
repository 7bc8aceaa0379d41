"""Sets of alternatives in tables that are read part by part: where their rows are, and how they get there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.formats.parquet.tables import GROUPS, KeyRanges, TableWriter, part_rows, read_part
from schemas import schema

PARTITIONS = 10  # of alternatives whose features are read at once: their rows are far smaller than waypoints


@dataclass(frozen=True)
class Piece:
    """Rows of one part: `count` of them from `first` on."""

    part: int
    first: int
    count: int


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
    def key(self) -> tuple[str, int, str]:
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


def contents(path: Path, name: str) -> Contents:
    """Where the rows of a table with sets of alternatives are; its keys are checked from part to part.

    Raises:
        TableError: the table is missing, breaks its schema, or has a key in two parts.
    """
    contract = schema(name)
    keys, pieces, others = KeyRanges(path, contract), dict[tuple[str, int, str], list[Piece]](), list[Piece]()
    for number in range(len(part_rows(path, name))):
        part = read_part(path, name, number, [*dict.fromkeys([*contract.key, *GROUPS])])
        keys.add(part)
        runs = (
            part.lazy()
            .select(*GROUPS, row=pl.int_range(pl.len()), run=pl.struct(GROUPS).rle_id())
            .group_by("run", maintain_order=True)
            .agg(*(pl.col(column).first() for column in GROUPS), first=pl.col("row").first(), count=pl.len())
            .collect()
        )
        for _, anchor, set_size, set_id, first, count in runs.iter_rows():
            piece = Piece(number, first, count)
            (others if set_id is None else pieces.setdefault((anchor, set_size, set_id), [])).append(piece)
    return Contents(tuple(SetRows(*key, tuple(found)) for key, found in pieces.items()), tuple(others))


def read_pieces(path: Path, name: str, pieces: Sequence[Piece], columns: Sequence[str]) -> pl.DataFrame:
    """The rows of the pieces, one after another; each part is read once."""
    parts = {part: read_part(path, name, part, columns) for part in dict.fromkeys(piece.part for piece in pieces)}
    return pl.concat([parts[piece.part].slice(piece.first, piece.count) for piece in pieces])


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
        path: features.parquet.
        names: of the features.
        scale: (F,) what they are divided by.
    """

    path: Path
    names: tuple[str, ...]
    scale: FloatArray

    def read(self, pieces: Sequence[Piece]) -> FloatArray:
        """(M, F) of some rows."""
        return np.asarray(read_pieces(self.path, "features", pieces, self.names).to_numpy() / self.scale)
