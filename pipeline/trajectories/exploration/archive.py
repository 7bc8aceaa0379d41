"""A map of the feature space: in each cell the trajectory nearest its centre, and how often the cell was visited.

The order in which trajectories arrive within a batch changes nothing, and neither does the order in which archives are
merged: an elite is the least of (distance to the centre, features) and visits add up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.trajectories.paths import require_positive

Keys = NDArray[np.int64]

GRID_FEATURES = 6  # with more, cells would be wider than what they are to tell apart


class Cells(Protocol):
    """How feature space is cut."""

    def locate(self, features: FloatArray) -> tuple[Keys, FloatArray]:
        """(N, F) -> the cell of each row (N,) and its squared distance (N,) to the cell's centre."""


@dataclass(frozen=True)
class Grid:
    """Cubes of one width in scaled features, for at most `GRID_FEATURES` features.

    Raises:
        ArgumentError: the width is not positive.
    """

    width: float

    def __post_init__(self) -> None:
        require_positive("width", self.width)

    def locate(self, features: FloatArray) -> tuple[Keys, FloatArray]:
        """See `Cells`.

        Raises:
            ArgumentError: too many features for a grid, or one so large that its cells cannot be numbered.
        """
        count = features.shape[1]
        if count > GRID_FEATURES:
            raise ArgumentError(f"features has {count} columns; a grid takes up to {GRID_FEATURES}; leave some out.")
        scaled = features / self.width
        cell = np.floor(scaled)
        digits = 62 // count
        if not np.abs(cell).max(initial=0.0) < 2 ** (digits - 1):
            raise ArgumentError(
                f"features reach {np.abs(features).max():g}, {np.abs(scaled).max():g} cells of width {self.width:g}; "
                f"up to {2 ** (digits - 1)} can be numbered, so scale the features or widen the cells."
            )
        key = np.zeros(len(features), dtype=np.int64)
        for column in cell.astype(np.int64).T:
            key = (key << digits) + column + (1 << (digits - 1))
        return key, np.asarray(((scaled - cell - 0.5) ** 2).sum(axis=1) * self.width**2)


def spread(features: FloatArray, count: int) -> FloatArray:
    """`count` of the rows (N, F), each the one furthest from those before: even over whatever the rows cover.

    The first is the row nearest the mean. Fewer come back if there are fewer distinct rows.

    Source: Gonzalez, "Clustering to minimize the maximum intercluster distance", Theoret. Comput. Sci. 38 (1985).
    """
    picked = [int(((features - features.mean(axis=0)) ** 2).sum(axis=1).argmin())]
    nearest = ((features - features[picked[0]]) ** 2).sum(axis=1)
    while len(picked) < count and nearest.max() > 0:
        picked.append(int(nearest.argmax()))
        np.minimum(nearest, ((features - features[picked[-1]]) ** 2).sum(axis=1), out=nearest)
    return np.asarray(features[picked])


class Archive:
    """Elites by cell, in the order in which their cells were first met.

    Args:
        cells: how feature space is cut.
        shape: (K, J) of the coefficients.
        features: F.
    """

    def __init__(self, cells: Cells, shape: tuple[int, int], features: int) -> None:
        self.cells = cells
        self._count = 0
        self._keys = np.empty(0, dtype=np.int64)  # sorted
        self._slots = np.empty(0, dtype=np.int64)  # of the sorted keys
        self._z = np.empty((1024, *shape))
        self._features = np.empty((1024, features))
        self._distance = np.empty(1024)
        self._visits = np.zeros(1024)

    def __len__(self) -> int:
        return self._count

    @property
    def z(self) -> FloatArray:
        """(C, K, J) coefficients of the elites."""
        return self._z[: self._count]

    @property
    def features(self) -> FloatArray:
        """(C, F) features of the elites."""
        return self._features[: self._count]

    @property
    def visits(self) -> FloatArray:
        """(C,) members that fell into each cell."""
        return self._visits[: self._count]

    def add(self, z: FloatArray, features: FloatArray, visits: FloatArray | None = None) -> int:
        """Add members of the space; return how many cells are new.

        Args:
            z: (N, K, J) coefficients.
            features: (N, F) finite.
            visits: (N,) what each counts for; one if not given.
        """
        if not len(z):
            return 0
        key, distance = self.cells.locate(features)
        order = np.lexsort((*features.T[::-1], distance, key))
        first = np.flatnonzero(np.diff(key[order], prepend=key[order[0]] - 1))
        best = order[first]
        counts = np.add.reduceat(np.ones(len(key)) if visits is None else visits[order], first)
        slot, new = self._slots_of(key[best])
        fresh = best[new]
        start = self._count - len(fresh)
        self._z[start : self._count] = z[fresh]
        self._features[start : self._count] = features[fresh]
        self._distance[start : self._count] = distance[fresh]
        known, slots = best[~new], slot[~new]
        better = _precedes(distance[known], features[known], self._distance[slots], self._features[slots])
        known, slots = known[better], slots[better]
        self._z[slots], self._features[slots], self._distance[slots] = z[known], features[known], distance[known]
        self._visits[slot] += counts
        return len(fresh)

    def merged(self, *others: Archive) -> Archive:
        """This archive and others over the same cells as one, its cells in the order of their keys."""
        return self.recut(self.cells, *others)

    def recut(self, cells: Cells, *others: Archive) -> Archive:
        """The elites of this archive and of others over other cells."""
        archive = Archive(cells, self._z.shape[1:], self._features.shape[1])
        parts = (self, *others)
        features = np.concatenate([part.features for part in parts])
        if len(features):
            # sorted by cell, so that the order of the parts shows nowhere
            order = np.argsort(cells.locate(features)[0], kind="stable")
            z, visits = (np.concatenate(x) for x in ([p.z for p in parts], [p.visits for p in parts]))
            archive.add(z[order], features[order], visits[order])
        return archive

    def _slots_of(self, keys: Keys) -> tuple[Keys, NDArray[np.bool_]]:
        """The slots of distinct sorted keys, new ones made where needed, and which are new."""
        place = np.searchsorted(self._keys, keys)
        inside = np.minimum(place, max(len(self._keys) - 1, 0))
        new = (
            np.ones(len(keys), bool)
            if not len(self._keys)
            else (place == len(self._keys)) | (self._keys[inside] != keys)
        )
        slot = np.empty(len(keys), dtype=np.int64)
        if len(self._keys):
            slot[~new] = self._slots[inside[~new]]
        slot[new] = np.arange(self._count, self._count + int(new.sum()))
        self._keys = np.insert(self._keys, place[new], keys[new])
        self._slots = np.insert(self._slots, place[new], slot[new])
        self._count += int(new.sum())
        while self._count > len(self._distance):
            for name in ("_z", "_features", "_distance", "_visits"):
                values = getattr(self, name)
                setattr(self, name, np.concatenate([values, np.zeros_like(values)]))
        return slot, new


def _precedes(
    distance: FloatArray, features: FloatArray, held: FloatArray, held_features: FloatArray
) -> NDArray[np.bool_]:
    """Whether each (distance, features) comes before what is held, in lexicographic order."""
    before = distance < held
    tied = distance == held
    for column, held_column in zip(features.T, held_features.T, strict=True):
        before |= tied & (column < held_column)
        tied &= column == held_column
    return np.asarray(before, dtype=np.bool_)
