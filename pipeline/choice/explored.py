"""The two models over an explored choice space, as densities over feature vectors.

LESS divides by how crowded features are, so over an ever denser set it becomes uniform over the region that can be
reached: p(phi) = exp(omega . phi) / integral over the region. Boltzmann over a base measure mu is p(phi) = g(phi)
exp(omega . phi) / Z(omega) with g the density of states of mu. Both need a sum over weighted rows, and both are
densities with respect to d phi, so that their held-out scores can be compared. docs/choice_space.md derives them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.kernel.density import log_density
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.models import LESS, WeightedSet
from pipeline.choice.validation import inverse_temperatures, matrix, positive, read_only, vector
from pipeline.errors import ArgumentError

MERGED = 0.25  # width of the cubes in which rows are merged, in widths of the kernel


@dataclass(frozen=True, eq=False)
class Region:
    """What stands for a choice space under one model: features (N, F) of rows and their log weights (N,).

    Sums over the rows, each with its weight, are integrals over the space: of d phi for LESS, of the base measure for
    Boltzmann.
    """

    features: FloatArray
    log_w: FloatArray

    @classmethod
    def mean(cls, regions: Sequence[Region]) -> Region:
        """The rows of all, so that a sum over them is the mean of the sums."""
        if len(regions) == 1:
            return regions[0]
        weights = [one.log_w - np.log(len(regions)) for one in regions]
        return cls(np.concatenate([one.features for one in regions]), np.concatenate(weights))

    def merged(self, width: float) -> Region:
        """Rows in one cube of this width as one row, at the mean of their features and with all of their weight."""
        _, cube = np.unique(np.floor(self.features / width).astype(np.int64), axis=0, return_inverse=True)
        order = np.argsort(cube, kind="stable")
        starts = np.flatnonzero(np.diff(cube[order], prepend=-1))
        peak = np.maximum.reduceat(self.log_w[order], starts)
        share = np.exp(self.log_w[order] - np.repeat(peak, np.diff(starts, append=len(cube))))
        total = np.add.reduceat(share, starts)
        features = np.add.reduceat(self.features[order] * share[:, None], starts) / total[:, None]
        return Region(features, np.log(total) + peak)


@dataclass(frozen=True, eq=False)
class ExploredSpace:
    """A choice space as independent explorations have found it.

    Attributes:
        regions: by the label of a model, one for each exploration.
        kernel: width of the kernel behind the weights of LESS, in scaled features.
    """

    regions: Mapping[str, tuple[Region, ...]]
    kernel: float

    @cached_property
    def _means(self) -> dict[str, Region]:
        return {label: Region.mean(some).merged(self.kernel * MERGED) for label, some in self.regions.items()}

    def region(self, model: str) -> Region:
        """The mean of all explorations under a model, near rows merged.

        Merging keeps weights and means, so a sum of exp(omega . phi) becomes smaller, by a factor of at most
        exp((|omega| width)^2 F / 8). Source: Hoeffding, JASA 58 (1963), his lemma, for each cube.
        """
        return self._means[model]

    def smoothed(self, factor: float) -> tuple[Region, ...]:
        """The regions of LESS with weights from a kernel `factor` times as wide."""
        rows = [one.features for one in self.regions[LESS.name]]
        return tuple(Region(one, region_log_weights(one, factor * self.kernel)) for one in rows)


def region_log_weights(features: ArrayLike, bandwidth: float, pool: ArrayLike | None = None) -> FloatArray:
    """Log of the volume that each row stands for, so that a weighted sum over rows is an integral over the region.

    log_w_i = -log sum_j N(phi_i - phi_j; sigma^2 I), the sum over the rows themselves, i included. With a pool of which
    the rows are an even sample, the density is that of the pool times the share of it that the rows are.

    Args:
        features: (N, F) scaled features of the rows.
        bandwidth: sigma > 0.
        pool: (M, F) the larger set that the density is taken from.

    Returns:
        (N,); the exponentials sum to the volume of the region, widened by the kernel.
    """
    rows = matrix("features", features)
    sigma = positive("bandwidth", bandwidth)
    normaliser = rows.shape[1] * np.log(sigma * np.sqrt(2 * np.pi))
    if pool is None:
        return np.asarray(normaliser - log_density(rows, sigma))
    crowd = matrix("pool", pool, columns=rows.shape[1])
    return np.asarray(normaliser - log_density(crowd, sigma, at=rows) + np.log(len(crowd) / len(rows)))


def region_log_likelihood(
    demonstrations: ArrayLike, features: ArrayLike, log_w: ArrayLike, thetas: ArrayLike, betas: ArrayLike
) -> FloatArray:
    """Log density of demonstrations, omega . phi_d - log sum_i exp(omega . phi_i + log_w_i) with omega = beta theta.

    A demonstration has no part in the sum, unlike in a finite choice set: among all trajectories it weighs nothing.

    Args:
        demonstrations: (n, F) scaled features.
        features: (N, F) of the rows that stand for the space.
        log_w: (N,) their log weights: `region_log_weights` for LESS, `BaseWeights.log_w` for Boltzmann.
        thetas: (K, F).
        betas: (B,).

    Returns:
        (n, K, B): for LESS a density with respect to d phi; for Boltzmann with respect to the base measure, so add
        `log_states` to compare the two.
    """
    rows = matrix("features", features)
    weights = vector("log_w", log_w, length=len(rows))
    chosen = matrix("demonstrations", demonstrations, columns=rows.shape[1])
    directions, temperatures = matrix("thetas", thetas, columns=rows.shape[1]), inverse_temperatures(betas)
    likelihood = np.empty((len(chosen), len(directions), len(temperatures)))
    for k, theta in enumerate(directions):
        reward, own = rows @ theta, chosen @ theta
        for b, beta in enumerate(temperatures):
            likelihood[:, k, b] = beta * own - log_sum_exp(beta * reward + weights)
    return likelihood


def log_states(at: ArrayLike, features: ArrayLike, log_w: ArrayLike, bandwidth: float) -> FloatArray:
    """Log density of states of the base measure at feature vectors: log sum_i w_i N(x - phi_i; sigma^2 I).

    Args:
        at: (n, F) points x.
        features: (M, F).
        log_w: (M,) log weights whose exponentials sum to one.
        bandwidth: sigma > 0.

    Returns:
        (n,) with respect to d phi.
    """
    rows = matrix("features", features)
    points, weights, sigma = (
        matrix("at", at, columns=rows.shape[1]),
        vector("log_w", log_w, length=len(rows)),
        bandwidth,
    )
    positive("bandwidth", sigma)
    square = (((points[:, None] - rows) / sigma) ** 2).sum(axis=2)
    return np.asarray(log_sum_exp(weights - square / 2, axis=1) - rows.shape[1] * np.log(sigma * np.sqrt(2 * np.pi)))


def expected_choice(features: ArrayLike, thetas: ArrayLike, betas: ArrayLike) -> FloatArray:
    """How often each row is chosen, every theta and beta being as likely: what a search should look at more closely.

    Args:
        features: (N, F) scaled features of rows that are spread evenly over a region.
        thetas: (K, F).
        betas: (B,).

    Returns:
        (N,) probabilities that sum to one.
    """
    rows = matrix("features", features)
    directions = matrix("thetas", thetas, columns=rows.shape[1])
    total = np.zeros(len(rows))
    for beta in inverse_temperatures(betas):
        utility = beta * directions @ rows.T
        total += np.exp(utility - log_sum_exp(utility, axis=1)[:, None]).sum(axis=0)
    return np.asarray(total / total.sum())


@dataclass(frozen=True, eq=False)
class PooledLESS:
    """LESS whose density comes from a pool, while the choice set may be small.

    log_w_i = -log sum_{j in pool} s(phi_i, phi_j). With the pool equal to the choice set it is LESS itself.

    Attributes:
        pool: (M, F) scaled features; the choice set should be drawn from it, as each row counts itself there.
        bandwidth: sigma > 0.
    """

    pool: FloatArray
    bandwidth: float
    name: ClassVar[str] = LESS.name
    _pool: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        positive("bandwidth", self.bandwidth)
        object.__setattr__(self, "_pool", read_only(matrix("pool", self.pool)))

    def weigh(self, compared: Any) -> WeightedSet:
        """Weights from the pool's kernel sums."""
        rows = matrix("features", compared, columns=self._pool.shape[1])
        log_w = read_only(0.0 - log_density(self._pool, self.bandwidth, at=rows))

        def joined(row: Any) -> tuple[FloatArray, float]:
            point = matrix("demonstrations", row, columns=rows.shape[1])
            own = np.logaddexp(0.0, log_density(self._pool, self.bandwidth, at=point)[0])
            return -np.logaddexp(-log_w, log_density(point, self.bandwidth, at=rows)), -float(own)

        return WeightedSet(log_w, joined)


def sampling_corrected(log_w: ArrayLike, log_proposal: ArrayLike, what: str = "alternatives") -> FloatArray:
    """Log weights less the log density with which each trajectory was drawn (McFadden 1978, positive conditioning).

    The chosen trajectory is corrected by *its own* density too, even if it was not drawn. A density that is zero means
    that the sampler never offers the trajectory; no correction exists then, and it is an error rather than a large
    weight.

    Args:
        log_w: (N,) log weights of a model.
        log_proposal: (N,) log q up to a constant that all share, such as what rejection removed.
        what: the rows are called in a message.

    Raises:
        ArgumentError: a density is zero or not known.
    """
    weights = vector("log_w", log_w)
    density = np.asarray(log_proposal, dtype=np.float64)
    wrong = np.flatnonzero(~np.isfinite(density)) if density.shape == weights.shape else np.arange(1)
    if wrong.size:
        raise ArgumentError(
            f"log_proposal of {what} has shape {density.shape} and no finite value at row {wrong[0]}; every row needs "
            "a density, so use a sampler with jitter (see pipeline.trajectories.sampler_density) or leave the "
            "correction out."
        )
    return np.asarray(weights - density)
