"""What is thought of the weights before any demonstration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.validation import vector
from pipeline.errors import ArgumentError


@dataclass(frozen=True)
class WeightPrior:
    """omega ~ the equal mixture of N(0, tau^2 I) over the scales tau.

    With features scaled by their range over the alternatives, omega_f is the log odds between the two ends of
    feature f, all else equal. A scale of 0.3 is someone who hardly looks (odds of 1.3), one of 100 someone who all but
    optimises. The default says that how decided people are is unknown over more than two orders of magnitude: with
    three features beta = |omega| lies in 0.35 to 190 with probability 0.9, median 7.5; the grid's betas span 0.01 to
    100. The prior is symmetric, so wishes (positive) and costs (negative) are as probable as each other, and all
    directions too. It is proper and all its moments are finite, which a demonstration at the rim of its set needs: its
    likelihood does not fall as omega grows.

    Given tau the posterior is log-concave. `WeightDraws.by_scale` says what each scale alone would conclude.

    Attributes:
        scales: standard deviations tau, in nats per unit of scaled feature.
    """

    scales: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)

    def __post_init__(self) -> None:
        scales = vector("scales", self.scales)
        if not np.all(scales > 0):
            raise ArgumentError(f"scales contains {scales.min():g}; every scale of the prior is a positive number.")

    def log_components(self, omegas: FloatArray) -> FloatArray:
        """(G, K) log density of the points (G, F) under each scale alone."""
        squared = (omegas**2).sum(axis=1)[:, None]
        tau = np.array(self.scales)
        return np.asarray(-squared / (2 * tau**2) - omegas.shape[1] * (np.log(tau) + 0.5 * math.log(2 * math.pi)))

    def log_density(self, omegas: FloatArray) -> FloatArray:
        """(G,) log density at the points (G, F)."""
        return log_sum_exp(self.log_components(omegas), axis=1) - math.log(len(self.scales))

    def draw(self, rng: np.random.Generator, count: int, features: int) -> FloatArray:
        """(count, features) weights."""
        tau = rng.choice(np.array(self.scales), size=count)
        return np.asarray(tau[:, None] * rng.standard_normal((count, features)))


DEFAULT = WeightPrior()
