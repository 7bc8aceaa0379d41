"""Kernel sums by sketches of bounded memory: a box whose grid is too large for one sketch is cut into slabs.

All slabs are equally thick, along the feature with the widest range. The sketch of a slab holds the rows in the slab
and those in its halo, which are within the cut-off of its walls. Rows farther away add less than 1e-8 to any sum in
the slab.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.kernel.fourier import Grid, Sketch
from pipeline.choice.kernel.pairwise import NEGLIGIBLE, cut_off

MOST = 64  # the most slabs of a box; thinner ones would be mostly halo


@dataclass(frozen=True)
class Slab:
    """A part of a box, between two values of one feature.

    Attributes:
        grid: grid of the sketch, which covers the slab and its halo.
        axis: the feature along which the box is cut.
        lower: least value of that feature in the slab; -inf for the first slab.
        upper: the value at which the next slab starts; inf for the last slab.
        halo: width of the halo; 0 if the slab is the whole box.
    """

    grid: Grid
    axis: int
    lower: float
    upper: float
    halo: float

    def contains(self, points: FloatArray) -> BoolArray:
        """(M,) which points lie in the slab."""
        return np.asarray((points[:, self.axis] >= self.lower) & (points[:, self.axis] < self.upper))

    def contains_or_adjoins(self, rows: FloatArray) -> BoolArray:
        """(N,) which rows lie in the slab or its halo; these are the rows that its sketch holds."""
        values = rows[:, self.axis]
        return np.asarray((values >= self.lower - self.halo) & (values <= self.upper + self.halo))


def cut(rows: FloatArray, total: float, sigma: float, count: int) -> tuple[Slab, ...]:
    """Cuts the box of the rows (N, F) into `count` slabs, for a set of `total` rows and one bandwidth."""
    lower, upper = rows.min(axis=0), rows.max(axis=0)
    axis = int(np.argmax(upper - lower))
    walls = np.linspace(lower[axis], upper[axis], count + 1)
    halo = cut_off(total, sigma) if count > 1 else 0.0
    slabs = []
    for number in range(count):
        low, high = lower.copy(), upper.copy()
        low[axis] = max(walls[number] - halo, lower[axis])
        high[axis] = min(walls[number + 1] + halo, upper[axis])
        grid = Grid.covering(low, high, sigma, sigma, total)
        slabs.append(
            Slab(
                grid,
                axis,
                float(walls[number]) if number else -np.inf,
                float(walls[number + 1]) if number + 1 < count else np.inf,
                halo,
            )
        )
    return tuple(slabs)


def sums_in_slabs(
    slabs: tuple[Slab, ...], rows: FloatArray, counts: FloatArray, points: FloatArray, sigma: float
) -> tuple[FloatArray, float]:
    """(M,) kernel sums at points in the box of the rows, and a bound on their error."""
    if len(slabs) == 1:
        return Sketch.of(rows, slabs[0].grid, counts).sums(points, sigma)
    sums, largest_error = np.empty(len(points)), 0.0
    for slab in slabs:
        inside, sketched = slab.contains(points), slab.contains_or_adjoins(rows)
        if inside.any():
            sketch = Sketch.of(rows[sketched], slab.grid, counts[sketched])
            sums[inside], error = sketch.sums(points[inside], sigma)
            largest_error = max(largest_error, error)
    return sums, largest_error + NEGLIGIBLE
