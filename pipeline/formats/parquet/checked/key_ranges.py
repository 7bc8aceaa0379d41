"""No key may be in two parts of a table. Only the ends of each run of keys are remembered, not every key."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.errors import TableError
from pipeline.formats.parquet.checked.conformance import GROUPS
from schemas import TableSchema

if TYPE_CHECKING:
    import polars as pl

_FLOATS = ("float", "double")


class KeyRanges:
    """The ranges of keys in the parts of a table, which may not overlap.

    A range goes over the last column of the key that is no floating-point number: alternative_id, or theta_id in
    posteriors, where all betas of a theta are in one part. The columns before it, and those that say which set of
    alternatives a row belongs to, tell the ranges of a part apart.
    """

    def __init__(self, path: Path, contract: TableSchema) -> None:
        self._path, self._contract = path, contract
        scalars = {column.name: column.scalar for column in contract.columns}
        last = max((i for i, name in enumerate(contract.key) if scalars[name] not in _FLOATS), default=0)
        self._within, self._over = contract.key[:last], contract.key[last]
        self._ranges: dict[tuple[object, ...], list[tuple[Any, Any]]] = {}

    def add(self, part: pl.DataFrame) -> None:
        """Take the keys of a part in.

        Raises:
            TableError: they lie among those of an earlier part.
        """
        for prefix, ranges in self._of(part).items():
            earlier = self._ranges.setdefault(prefix, [])
            joined = _disjoint(ranges)
            for low, high in joined:
                place = bisect_left(earlier, (low, high))
                if any(low <= end and begin <= high for begin, end in earlier[max(place - 1, 0) : place + 1]):
                    raise TableError(
                        f"{self._path}: a part of table {self._contract.name!r} has the {self._over} from {low!r} to "
                        f"{high!r}, among those of another part; each row is in one part, in order"
                    )
            for both in joined:
                insort(earlier, both)

    def _of(self, part: pl.DataFrame) -> dict[tuple[object, ...], list[tuple[Any, Any]]]:
        import polars as pl

        sets = [name for name in GROUPS if name in part.columns and name not in self._contract.key]
        ends = part.group_by(*self._within, *sets, pl.lit(0)).agg(
            low=pl.col(self._over).min(), high=pl.col(self._over).max()
        )
        ranges: dict[tuple[object, ...], list[tuple[Any, Any]]] = {}
        for *prefix, low, high in ends.select(*self._within, "low", "high").iter_rows():
            ranges.setdefault(tuple(prefix), []).append((low, high))
        return ranges


def _disjoint(ranges: Sequence[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """The ranges in order, those that overlap joined."""
    joined: list[tuple[Any, Any]] = []
    for low, high in sorted(ranges):
        if joined and low <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(high, joined[-1][1]))
        else:
            joined.append((low, high))
    return joined
