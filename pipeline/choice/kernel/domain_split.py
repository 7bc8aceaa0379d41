"""Kernel sums by sketches of bounded memory: a box whose grid is too large for one is cut into slabs.

The slabs are of equal thickness, along the feature whose range holds most bandwidths. A slab's own sketch holds its rows
and those within the cut-off of its walls, its halo; what lies beyond adds less than 1e-8 to any sum in the slab.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.kernel.fourier import Grid, Sketch
from pipeline.choice.kernel.pairwise import NEGLIGIBLE, cut_off

MOST = 64  # slabs; thinner ones are mostly halo


@dataclass(frozen=True)
class Slab:
    """A part of the box.

    Attributes:
        grid: of the slab with its halo.
        axis: the feature along which the box is cut.
        lower: least value of that feature; none below the first slab.
        upper: the value at which the next slab starts; none above the last.
        halo: width of the halo; 0 if the slab is the whole box.
    """

    grid: Grid
    axis: int
    lower: float
    upper: float
    halo: float

    def own(self, points: FloatArray) -> BoolArray:
        """(M,) which points lie in the slab."""
        return np.asarray((points[:, self.axis] >= self.lower) & (points[:, self.axis] < self.upper))

    def around(self, rows: FloatArray) -> BoolArray:
        """(N,) which rows its sketch holds."""
        along = rows[:, self.axis]
        return np.asarray((along >= self.lower - self.halo) & (along <= self.upper + self.halo))


def cut(rows: FloatArray, total: float, sigma: float, count: int) -> tuple[Slab, ...]:
    """The box of the rows as `count` slabs, for `total` rows and one bandwidth."""
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
    found, worst = np.empty(len(points)), 0.0
    for slab in slabs:
        here, around = slab.own(points), slab.around(rows)
        if here.any():
            sketch = Sketch.of(rows[around], slab.grid, counts[around])
            found[here], error = sketch.sums(points[here], sigma)
            worst = max(worst, error)
    return found, worst + NEGLIGIBLE
