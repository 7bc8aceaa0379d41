"""The distinct rows of an array. Two rows are identical if all their numbers are equal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray, IndexArray


@dataclass(frozen=True)
class DistinctRows:
    """The distinct rows of an (N, F) array.

    Attributes:
        rows: (G, F) distinct rows in lexicographic order, so that the order of the input does not matter.
        counts: (G,) how often each occurs in the input.
        index: (N,) the distinct row that each input row equals: `rows[index]` is the input.
    """

    rows: FloatArray
    counts: FloatArray
    index: IndexArray


def distinct_rows(rows: FloatArray) -> DistinctRows:
    """The distinct rows of `rows` (N, F) with their counts; 0.0 and -0.0 are the same number."""
    order = _lexicographic(rows)
    ordered = rows[order] + 0.0
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = np.any(ordered[1:] != ordered[:-1], axis=1)
    index = np.empty(len(rows), dtype=np.intp)
    index[order] = np.cumsum(starts) - 1
    return DistinctRows(ordered[starts], np.bincount(index).astype(np.float64), index)


def _lexicographic(rows: FloatArray) -> IndexArray:
    """(N,) positions in lexicographic order: by the first column, which often suffices, and then within its ties."""
    order = np.argsort(np.ascontiguousarray(rows[:, 0]))
    first = rows[order, 0]
    same = first[1:] == first[:-1]
    tied = np.zeros(len(rows), dtype=bool)
    tied[1:] = same
    tied[:-1] |= same
    tied_rows = order[tied]
    order[tied] = tied_rows[np.lexsort(rows[tied_rows].T[::-1])]
    return order
