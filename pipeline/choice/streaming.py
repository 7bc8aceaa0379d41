"""Kernel sums and likelihoods of a choice set that is never in memory as a whole: what each part of it adds.

Sketches, kernel sums at given points and normalisers of the set are sums over its parts, added in a fixed order. They
agree with those of the whole set in memory to rounding, and those from sketches to the error bound of
`kernel/fourier.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.kernel import cost_model
from pipeline.choice.kernel.density import RELATIVE_ERROR
from pipeline.choice.kernel.domain_split import MOST, Slab, cut
from pipeline.choice.kernel.fourier import DIMENSIONS, Grid, Sketch
from pipeline.choice.kernel.join import join, own_log_weights
from pipeline.choice.kernel.pairwise import NEGLIGIBLE, Neighbours
from pipeline.choice.kernel.unique_rows import distinct_rows
from pipeline.choice.log_sum_exp import LogSumExp, log_likelihood_joined, partial_normaliser
from pipeline.choice.validation import matrix
from pipeline.errors import ArgumentError
from pipeline.vocabulary import BOLTZMANN, LESS

STREAMED_MODELS = (BOLTZMANN, LESS)
"""The models whose likelihoods are sums over parts of a set."""
_JOINED = 4_000_000  # weights of joined sets that are held at once: 32 MB


def sketch_slabs(
    lower: Sequence[float], upper: Sequence[float], sigma: float, total: int, rows: int, memory_bytes: float
) -> tuple[Slab, ...] | None:
    """Cuts the box of a set into the fewest slabs whose transforms fit into memory.

    Args:
        lower: (F,) least value of each feature.
        upper: (F,) largest value of each feature.
        sigma: the kernel's bandwidth.
        total: number of rows of the set.
        rows: number of rows of its largest part.
        memory_bytes: working memory that the transform of one part may use.

    Returns:
        The slabs; None if there are more than three features, or if 64 slabs would not fit into memory either.
    """
    if len(lower) > DIMENSIONS:
        return None
    count = 1
    while count <= MOST:
        try:
            slabs = cut(np.array([lower, upper], dtype=np.float64), total, sigma, count)
        except ArgumentError:
            return None
        if all(cost_model.transform_bytes(slab.grid, rows) <= memory_bytes for slab in slabs):
            return slabs
        count *= 2
    return None


def sketch_seconds(slabs: Sequence[Slab], total: int, rows: int) -> float:
    """Predicted seconds on one core for the transforms of all parts: two for each slab and part.

    It is an upper bound, because every slab is counted as if it held all rows of a part.
    """
    return sum(2 * cost_model.transform_seconds(slab.grid, rows) for slab in slabs) * -(-total // rows)


def sketch_of_part(rows: ArrayLike, grid: Grid) -> Sketch:
    """The sketch of the rows (M, F) of a part; the sum over all parts is the sketch of their set."""
    groups = distinct_rows(matrix("rows", rows))
    return Sketch.of(groups.rows, grid, groups.counts)


def slab_of_part(rows: ArrayLike, slab: Slab) -> Sketch:
    """The sketch of those rows of a part that lie in a slab or its halo; the sum over all parts is that of the set."""
    features = matrix("rows", rows)
    sketched = slab.contains_or_adjoins(features)
    if not sketched.any():
        return Sketch(slab.grid, np.zeros(slab.grid.shape, dtype=np.complex128), 0.0)
    return sketch_of_part(features[sketched], slab.grid)


def log_sums_of_part(
    rows: ArrayLike, slabs: Sequence[Slab], sketches: Iterable[Sketch], sigma: float
) -> tuple[FloatArray, BoolArray]:
    """Log kernel sums over the whole set at the rows (M, F) of a part, from the sketches of the set's slabs.

    Returns:
        (M,) log sums, and (M,) which of them are to be discarded as their relative error may be above 1e-6.
    """
    groups = distinct_rows(matrix("rows", rows))
    sums, errors = np.ones(len(groups.rows)), np.zeros(len(groups.rows))
    error_beyond_halo = NEGLIGIBLE if len(slabs) > 1 else 0.0
    for slab, sketch in zip(slabs, sketches, strict=True):
        inside = slab.contains(groups.rows)
        if inside.any():
            sums[inside], error = sketch.sums(groups.rows[inside], sigma)
            errors[inside] = error + error_beyond_halo
    sums = np.maximum(sums, groups.counts)  # identical rows alone add up to their number
    inaccurate = sums * RELATIVE_ERROR < errors
    return np.log(sums)[groups.index], inaccurate[groups.index]


def log_sums_over_part(points: ArrayLike, rows: ArrayLike, sigma: float) -> FloatArray:
    """(M,) log kernel sums at any points (M, F) over the rows of one part; `np.logaddexp` adds those of other parts."""
    groups = distinct_rows(matrix("rows", rows))
    return Neighbours(groups.rows, groups.counts).log_sums_at(matrix("points", points), sigma)


def others_in_part(points: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How often points (M, F) that are rows of a set occur in one part of it, and how far its other rows are.

    Returns:
        (M,) how often each point is a row of the part, whose sum over all parts is that for the set; and (M,) squared
        distances to the nearest row of the part that is not the point, whose least over all parts is that for the set.
    """
    combined = distinct_rows(np.concatenate([points, rows]))
    occurrences_of_distinct = np.bincount(combined.index[len(points) :], minlength=len(combined.rows))
    occurrences = occurrences_of_distinct[combined.index[: len(points)]]
    groups, nearest = distinct_rows(rows), np.empty(len(points))
    neighbours = Neighbours(groups.rows, groups.counts)
    for selected, are_rows in ((occurrences > 0, True), (occurrences == 0, False)):
        if selected.any():
            nearest[selected] = neighbours.nearest(points[selected], others=are_rows)
    return occurrences.astype(np.float64), nearest


def log_sums_of_others_in_part(
    points: FloatArray, rows: FloatArray, sigmas: FloatArray, negligible: float
) -> FloatArray:
    """(K, M) log kernel sums at points (M, F) over those rows of a part that differ from the point, for K bandwidths.

    `np.logaddexp` adds those of other parts.
    """
    groups = distinct_rows(rows)
    neighbours = Neighbours(groups.rows, groups.counts)
    inside = neighbours.nearest(points) == 0
    log_sums = np.full((len(sigmas), len(points)), -np.inf)
    if inside.any() and len(groups.rows) > 1:
        log_sums[:, inside] = neighbours.log_sums_of_others(points[inside], sigmas, negligible)
    if not inside.all():
        log_sums[:, ~inside] = [neighbours.log_sums_at(points[~inside], sigma) for sigma in sigmas]
    return log_sums


@dataclass(frozen=True, eq=False)
class JoinedSums:
    """What parts of a choice set add to the likelihoods of n demonstrations that each join it; add them in order.

    Attributes:
        normaliser: partial normalisers of every hypothesis for each demonstration; the same for all demonstrations
            under Boltzmann, which has no weights.
        log_kernel: (n,) log kernel sums at the demonstrations; None under Boltzmann.
    """

    normaliser: LogSumExp
    log_kernel: FloatArray | None

    def __add__(self, other: JoinedSums) -> JoinedSums:
        if self.log_kernel is None or other.log_kernel is None:
            return JoinedSums(self.normaliser + other.normaliser, None)
        return JoinedSums(self.normaliser + other.normaliser, np.logaddexp(self.log_kernel, other.log_kernel))

    def log_likelihood(
        self, demonstrations: ArrayLike, thetas: ArrayLike, betas: ArrayLike, origin: ArrayLike
    ) -> FloatArray:
        """(n, K, B) log likelihoods, if these sums are over all parts of the set; arguments as in `joined_sums`."""
        points = matrix("demonstrations", demonstrations)
        log_w = np.zeros(len(points)) if self.log_kernel is None else own_log_weights(self.log_kernel)
        totals = np.broadcast_to(self.normaliser.total, (len(points), self.normaliser.total.shape[1]))
        normaliser = LogSumExp(self.normaliser.peak, totals)
        return log_likelihood_joined(normaliser, points, log_w, thetas, betas, origin)


def joined_sums(
    alternatives: ArrayLike,
    demonstrations: ArrayLike,
    thetas: ArrayLike,
    betas: ArrayLike,
    origin: ArrayLike,
    log_densities: ArrayLike | None = None,
    sigma: float = 1.0,
) -> JoinedSums:
    """What one part of a choice set adds to the likelihoods under LESS, or under Boltzmann if no densities are given.

    >>> from pipeline.choice import Boltzmann, log_likelihood
    >>> rows, chosen, thetas = [[0.0], [1.0], [2.0]], [[0.5]], [[1.0]]
    >>> sums = [joined_sums(part, chosen, thetas, [1.0], [0.0]) for part in (rows[:2], rows[2:])]
    >>> (sums[0] + sums[1]).log_likelihood(chosen, thetas, [1.0], [0.0]).round(6) == log_likelihood(
    ...     Boltzmann(), chosen, rows, thetas
    ... ).round(6)
    array([[[ True]]])

    Args:
        alternatives: (M, F) scaled features of the part.
        demonstrations: (n, F) scaled features of trajectories outside the set.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        origin: (F,) subtracted from all features, the same for all parts. A point near them keeps their digits.
        log_densities: (M,) log kernel sums over the whole set at the part's rows; None for Boltzmann.
        sigma: the kernel's bandwidth.

    Returns:
        The sums of the part.

    Raises:
        ArgumentError: an argument is out of range.
    """
    rows = matrix("alternatives", alternatives)
    if log_densities is None:
        return JoinedSums(partial_normaliser(rows, np.zeros(len(rows)), thetas, betas, origin), None)
    points, log_sums = matrix("demonstrations", demonstrations), np.asarray(log_densities, dtype=np.float64)
    step = max(_JOINED // len(points), 1)
    sums = []
    for first in range(0, len(rows), step):
        block = slice(first, first + step)
        joined, at_points = join(rows[block], log_sums[block], points, sigma)
        normaliser = partial_normaliser(rows[block], 0.0 - log_sums[block], thetas, betas, origin, joined)
        sums.append(JoinedSums(normaliser, at_points))
    return sum(sums[1:], start=sums[0])
