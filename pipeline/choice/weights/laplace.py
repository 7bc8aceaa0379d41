"""Modes by Newton's method, and draws around them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.weights.choices import Likelihood
from pipeline.errors import WorkbenchError

FREEDOM = 5.0  # degrees of freedom of the draws around a mode: tails heavier than any log-concave target's
_ITERATIONS = 100
PRECISE = 1e-10  # nats that a further step could gain


@dataclass(frozen=True, eq=False)
class Modes:
    """The modes of G log-concave posteriors.

    Attributes:
        omega: (G, F).
        value: (G,) log likelihood plus log prior density there.
        curvature: (G, F, F) the negative Hessian there.
    """

    omega: FloatArray
    value: FloatArray
    curvature: FloatArray

    @property
    def log_evidence(self) -> FloatArray:
        """(G,) Laplace's approximation to the log integral."""
        size = self.omega.shape[1]
        return np.asarray(self.value + 0.5 * size * math.log(2 * math.pi) - 0.5 * np.linalg.slogdet(self.curvature)[1])


def gaussian_log_density(omega: FloatArray, mean: FloatArray, scale: FloatArray) -> FloatArray:
    """(G,) log N(omega_g; mean_g, scale_g^2 I); arguments (G, F), broadcast, and (G,)."""
    size = omega.shape[-1]
    squared = ((omega - mean) ** 2).sum(axis=-1)
    return np.asarray(-squared / (2 * scale**2) - size * (np.log(scale) + 0.5 * math.log(2 * math.pi)))


def find_modes(choices: Likelihood, mean: FloatArray, scale: FloatArray, precise: float = PRECISE) -> Modes:
    """The mode of every posterior under the prior N(mean_g, scale_g^2 I), by damped Newton steps.

    Args:
        choices: the demonstrations.
        mean: (G, F) prior means.
        scale: (G,) prior standard deviations.
        precise: nats that a further step may gain at most.

    Raises:
        WorkbenchError: 100 steps did not suffice.
    """
    omega = np.array(mean)
    precision = scale**-2.0
    identity = np.eye(omega.shape[1])

    def evaluated(points: FloatArray, rows: IndexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        found = choices.derivatives(points)
        value = found.value + gaussian_log_density(points, mean[rows], scale[rows])
        gradient = found.gradient - precision[rows, None] * (points - mean[rows])
        return value, gradient, found.curvature + precision[rows, None, None] * identity

    everyone = np.arange(len(omega))
    value, gradient, curvature = evaluated(omega, everyone)
    length = np.ones(len(omega))
    for _ in range(_ITERATIONS):
        step = np.linalg.solve(curvature, gradient[:, :, None])[:, :, 0]
        gain = 0.5 * (gradient * step).sum(axis=1)
        active = np.flatnonzero(gain > precise)
        if not active.size:
            return Modes(omega, value, curvature)
        proposed = omega[active] + length[active, None] * step[active]
        new = evaluated(proposed, active)
        better = new[0] >= value[active] + 0.1 * length[active] * gain[active] - 1e-13 * np.abs(value[active])
        moved = active[better]
        omega[moved] = proposed[better]
        value[moved], gradient[moved], curvature[moved] = (part[better] for part in new)
        length[moved] = np.minimum(1.0, 2 * length[moved])
        length[active[~better]] *= 0.25
    raise WorkbenchError(
        f"no mode was found in {_ITERATIONS} Newton steps; the best point so far is "
        f"{omega[active[0]].round(4).tolist()}. "
        "Scale the features to ranges near one."
    )


def lattice(rng: np.random.Generator, count: int, size: int) -> FloatArray:
    """(count, size) evenly spread points in the open unit cube: a Kronecker lattice under a random shift.

    Its steps are the powers of 1/g with g the positive root of g^(size + 1) = g + 1 (the golden ratio for size 1). Each
    point is uniform, so estimates are unbiased; their errors fall nearly as 1 / count.

    Source: Cranley and Patterson (1976) for the shift; M. Roberts (2018), the R sequence, for the steps.
    """
    root = 2.0
    for _ in range(60):
        root = (1 + root) ** (1 / (size + 1))
    steps = root ** -np.arange(1.0, size + 1)
    points = (rng.random(size) + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return np.asarray(np.clip(points, 1e-12, 1 - 1e-12))


def student_draws(points: FloatArray, mean: FloatArray, curvature: FloatArray) -> FloatArray:
    """Points (M, F + 1) of the unit cube to draws (M, F) of the Student t around `mean` with scale curvature^-1.

    `mean` is (F,) or (M, F) and `curvature` (F, F) or (M, F, F).
    """
    normal = special.ndtri(points[:, :-1])
    stretch = np.sqrt(FREEDOM / special.chdtri(FREEDOM, points[:, -1]))
    factor = np.linalg.cholesky(curvature)
    flat = np.linalg.solve(np.swapaxes(factor, -1, -2), (normal * stretch[:, None])[:, :, None])[:, :, 0]
    return np.asarray(mean + flat)


def student_log_density(omega: FloatArray, mean: FloatArray, curvature: FloatArray) -> FloatArray:
    """(M,) log density of `student_draws` at `omega` (M, F)."""
    size = omega.shape[-1]
    offset = omega - mean
    squared = np.einsum("...f,...fh,...h->...", offset, curvature, offset)
    constant = (
        special.gammaln((FREEDOM + size) / 2) - special.gammaln(FREEDOM / 2) - 0.5 * size * math.log(FREEDOM * math.pi)
    )
    log_volume = 0.5 * np.linalg.slogdet(curvature)[1]
    return np.asarray(constant + log_volume - 0.5 * (FREEDOM + size) * np.log1p(squared / FREEDOM))
