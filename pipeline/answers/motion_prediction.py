"""How well the rest of a motion is predicted: errors of the end effector and log scores that all methods share.

A prediction is a weighted set of possible positions over the remaining time; straight-on and nearest-neighbour
predictions have one member. Its density is a mixture of Student t's around the members, whose width is chosen on other
people, for every method alike: a method that knows its uncertainty gains, and one that has none is not refused. The
tails are heavy, or one person who does something else would decide the comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pipeline.arrays import FloatArray
from pipeline.choice.logspace import log, log_sum_exp
from pipeline.errors import ArgumentError

FREEDOM = 3.0  # degrees of freedom of the densities around each possible position
WIDTHS_M = tuple(float(width) for width in np.geomspace(0.005, 0.5, 21))


@dataclass(frozen=True, eq=False)
class Forecast:
    """Where the end effector may be over the rest of a motion.

    Attributes:
        positions: (N, M, 3) m, of each possible continuation at M remaining waypoints.
        probabilities: (N,) that sum to one.
        actual: (M, 3) m, where it was.
    """

    positions: FloatArray
    probabilities: FloatArray
    actual: FloatArray

    def __post_init__(self) -> None:
        n, m = np.shape(self.probabilities)[0], len(self.actual)
        if np.shape(self.positions) != (n, m, 3) or np.shape(self.actual) != (m, 3):
            raise ArgumentError(
                f"positions has shape {np.shape(self.positions)}, probabilities "
                f"{np.shape(self.probabilities)} and actual "
                f"{np.shape(self.actual)}; (N, M, 3), (N,) and (M, 3) are needed."
            )

    @classmethod
    def single(cls, positions: ArrayLike, actual: ArrayLike) -> Forecast:
        """Of one continuation (M, 3)."""
        return cls(np.asarray(positions, dtype=np.float64)[None], np.ones(1), np.asarray(actual, dtype=np.float64))

    @property
    def error_m(self) -> float:
        """Mean distance of the mean prediction from where the end effector was."""
        mean = np.einsum("n,nmc->mc", self.probabilities, self.positions)
        return float(np.linalg.norm(mean - self.actual, axis=1).mean())

    def log_score(self, width_m: float) -> float:
        """Log density, per waypoint, of where it was (nats; m^-3): the mean over waypoints of the log mixture
        density.
        """
        squared = ((self.positions - self.actual) ** 2).sum(axis=2)
        log_peak = special.gammaln(FREEDOM / 2 + 1.5) - special.gammaln(FREEDOM / 2)
        log_peak -= 1.5 * np.log(FREEDOM * np.pi * width_m**2)
        log_kernel = log_peak - (FREEDOM + 3) / 2 * np.log1p(squared / (FREEDOM * width_m**2))
        return float(log_sum_exp(log_kernel + log(self.probabilities)[:, None], axis=0).mean())


@dataclass(frozen=True, eq=False)
class ForecastScore:
    """Of n forecasts by one method.

    Attributes:
        error_m: (n,) mean end-effector error of each.
        log_score: (n,) each with the width that is best for the others.
    """

    error_m: FloatArray
    log_score: FloatArray


def score_forecasts(forecasts: Sequence[Forecast], widths_m: Sequence[float] = WIDTHS_M) -> ForecastScore:
    """Score forecasts of one method, one for each person, each with the width chosen on the others.

    Raises:
        ArgumentError: there are fewer than two forecasts.
    """
    if len(forecasts) < 2:
        raise ArgumentError(
            f"forecasts has {len(forecasts)}; two or more are needed, as the width is chosen on the others."
        )
    scores = np.array([[forecast.log_score(width) for width in widths_m] for forecast in forecasts])
    others = scores.sum(axis=0) - scores
    best = others.argmax(axis=1)
    errors = np.array([forecast.error_m for forecast in forecasts])
    return ForecastScore(errors, scores[np.arange(len(scores)), best])
