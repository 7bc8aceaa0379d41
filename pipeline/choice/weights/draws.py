"""Weighted draws of the weights, and what they say: intervals per weight, for the direction and for beta."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.metrics import angle_to
from pipeline.choice.validation import matrix, read_only, vector
from pipeline.choice.weights.pareto import effective_draws, largest_good_shape
from pipeline.choice.weights.prior import WeightPrior
from pipeline.errors import ArgumentError


@dataclass(frozen=True, eq=False)
class WeightDraws:
    """A posterior over omega = beta theta as weighted draws.

    Attributes:
        omega: (S, F) draws.
        log_weight: (S,) normalised.
        pareto_k: shape of the tail of the importance weights, see `pareto_smoothed`.
        log_evidence: log probability of the demonstrations, omega integrated out; NaN where it is not known.
    """

    omega: FloatArray
    log_weight: FloatArray
    pareto_k: float
    log_evidence: float

    def __post_init__(self) -> None:
        omega = matrix("omega", self.omega)
        log_weight = np.asarray(self.log_weight, dtype=np.float64)
        if log_weight.shape != (len(omega),) or not np.isclose(log_sum_exp(log_weight), 0.0, atol=1e-9):
            raise ArgumentError("log_weight must hold one log weight per draw, whose exponentials sum to one.")
        object.__setattr__(self, "omega", read_only(omega))
        object.__setattr__(self, "log_weight", read_only(log_weight))

    @cached_property
    def weight(self) -> FloatArray:
        """(S,) weights that sum to one."""
        return np.asarray(np.exp(self.log_weight))

    @property
    def effective(self) -> float:
        """How many independent draws these are worth (Kish)."""
        return effective_draws(self.log_weight)

    @property
    def trusted(self) -> bool:
        """Whether the tail of the weights is short enough and a hundred draws count."""
        return self.pareto_k <= largest_good_shape(len(self.omega)) and self.effective >= 100

    @property
    def mean(self) -> FloatArray:
        """(F,) posterior mean of omega: what a linear cost in expectation needs."""
        return np.asarray(self.weight @ self.omega)

    @cached_property
    def beta(self) -> FloatArray:
        """(S,) |omega|, how decided the person is."""
        return np.asarray(np.linalg.norm(self.omega, axis=1))

    @cached_property
    def directions(self) -> FloatArray:
        """(S, F) unit vectors theta."""
        return np.asarray(self.omega / np.maximum(self.beta, np.finfo(np.float64).tiny)[:, None])

    @property
    def direction(self) -> FloatArray:
        """(F,) the mean direction, of length one."""
        mean = self.weight @ self.directions
        return np.asarray(mean / np.linalg.norm(mean))

    def cap(self, level: float, about: FloatArray | None = None) -> float:
        """Angle (rad) around `direction`, or another unit vector, within which theta lies with probability `level`."""
        angles = self.angles(self.direction if about is None else about)
        return float(weighted_quantiles(angles[:, None], self.weight, [level])[0, 0])

    def within(self, theta: ArrayLike) -> float:
        """Probability that theta lies nearer to `direction` than the given one: beyond 0.9 it is outside `cap(0.9)`."""
        wanted = vector("theta", theta, length=self.omega.shape[1])
        mean = self.direction
        return float(self.weight[self.angles(mean) < angle_to(mean, wanted)].sum())

    def nearer(self, about: FloatArray, angle: float) -> float:
        """Probability that theta lies nearer than `angle` (rad) to the unit vector `about`."""
        return float(self.weight[self.angles(about) < angle].sum())

    def interval(self, level: float) -> FloatArray:
        """(F, 2) central interval of each weight."""
        return weighted_quantiles(self.omega, self.weight, [(1 - level) / 2, (1 + level) / 2]).T

    def beta_interval(self, level: float) -> FloatArray:
        """(2,) central interval of beta."""
        return weighted_quantiles(self.beta[:, None], self.weight, [(1 - level) / 2, (1 + level) / 2])[:, 0]

    @property
    def positive(self) -> FloatArray:
        """(F,) probability that each weight is positive: a wish for more of the feature, not a cost."""
        return np.asarray(self.weight @ (self.omega > 0))

    def by_scale(self, prior: WeightPrior) -> tuple[FloatArray, tuple[WeightDraws, ...]]:
        """What each scale of the prior alone would have concluded.

        Returns:
            (K,) posterior probability of each scale, and the draws reweighted to it.
        """
        relative = prior.log_components(self.omega) - prior.log_density(self.omega)[:, None]
        joint = self.log_weight[:, None] + relative
        total = log_sum_exp(joint, axis=0)
        evidence = self.log_evidence + total
        parts = [
            WeightDraws(self.omega, joint[:, k] - total[k], self.pareto_k, float(evidence[k]))
            for k in range(len(total))
        ]
        return np.exp(total - log_sum_exp(total)), tuple(parts)

    def given(self, log_likelihood: ArrayLike) -> WeightDraws:
        """The posterior once more is known: draws reweighted by (S,) log likelihoods."""
        added = self.log_weight + np.asarray(log_likelihood, dtype=np.float64)
        return WeightDraws(
            self.omega, added - log_sum_exp(added), self.pareto_k, self.log_evidence + float(log_sum_exp(added))
        )

    def resampled(self, rng: np.random.Generator, count: int) -> FloatArray:
        """(count, F) draws of equal weight, by systematic resampling, in random order."""
        places = (rng.random() + np.arange(count)) / count
        rows = np.searchsorted(np.cumsum(self.weight), places * self.weight.sum(), side="right")
        return np.asarray(self.omega[rng.permutation(np.minimum(rows, len(self.omega) - 1))])

    def angles(self, mean: FloatArray) -> FloatArray:
        """(S,) rad, between each direction and a unit vector."""
        # arccos of a dot product loses half the digits near 0
        return np.asarray(
            2
            * np.arctan2(np.linalg.norm(self.directions - mean, axis=1), np.linalg.norm(self.directions + mean, axis=1))
        )


@dataclass(frozen=True, eq=False)
class SortedColumns:
    """Columns in order, for quantiles under many weights.

    Attributes:
        order: (S, C) row numbers.
        values: (S, C) in that order.
    """

    order: IndexArray
    values: FloatArray

    @classmethod
    def of(cls, values: ArrayLike) -> SortedColumns:
        """Sort the columns of (S, C) values."""
        rows = matrix("values", values)
        order = np.argsort(rows, axis=0, kind="stable")
        return cls(order, np.take_along_axis(rows, order, axis=0))

    def quantiles(self, weights: ArrayLike, levels: Sequence[float]) -> FloatArray:
        """(L, C), as of `weighted_quantiles`."""
        weight = vector("weights", weights)
        if weight.shape != (len(self.order),) or weight.min() < 0 or not weight.sum() > 0:
            raise ArgumentError(f"weights must be {len(self.order)} numbers, none negative and not all zero.")
        wanted = vector("levels", levels)
        if not np.all((wanted >= 0) & (wanted <= 1)):
            raise ArgumentError(f"levels is {list(levels)}; each must be between 0 and 1.")
        steps = weight[self.order] / weight.sum()
        middles = np.cumsum(steps, axis=0) - steps / 2
        columns = range(middles.shape[1])
        return np.stack([np.interp(wanted, middles[:, c], self.values[:, c]) for c in columns], axis=1)


def weighted_quantiles(values: ArrayLike, weights: ArrayLike, levels: Sequence[float]) -> FloatArray:
    """Quantiles of the columns of (S, C) values under (S,) weights, linear between the middles of the weights' steps.

    >>> weighted_quantiles([[0.0], [1.0], [2.0]], [1, 1, 2], [0.5])
    array([[1.33333333]])

    Returns:
        (L, C), one row per level.

    Raises:
        ArgumentError: shapes do not fit, a weight is negative, or a level is not between 0 and 1.
    """
    return SortedColumns.of(values).quantiles(weights, levels)
