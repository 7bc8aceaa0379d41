"""The mode of a group's weights and all its people's weights together, by Newton's method on the arrow-shaped
Hessian.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.choice.weights.choices import Likelihood
from pipeline.choice.weights.laplace import gaussian_log_density
from pipeline.errors import WorkbenchError

_ITERATIONS = 100
_PRECISE = 1e-6  # nats that a further step could gain


@dataclass(frozen=True, eq=False)
class JointModes:
    """One mode for each cell of a prior scale and a spread.

    Attributes:
        scale, spread: (C,) of the cells.
        mu: (C, F) the group's weights at the mode.
        mu_curvature: (C, F, F) negative Hessian of mu with the people's weights profiled out.
        log_evidence: (C,) Laplace's approximation.
    """

    scale: FloatArray
    spread: FloatArray
    mu: FloatArray
    mu_curvature: FloatArray
    log_evidence: FloatArray


@dataclass(frozen=True, eq=False)
class _State:
    """Log joint density at C points and its derivatives; people along the second axis of `omega`."""

    mu: FloatArray
    omega: FloatArray
    value: FloatArray
    gradient: FloatArray
    curvature: FloatArray


def find_joint_modes(people: Sequence[Likelihood], scales: Sequence[float], spreads: Sequence[float]) -> JointModes:
    """The modes of all cells of `scales` x `spreads`.

    Raises:
        WorkbenchError: 100 steps did not suffice.
    """
    scale, spread = (axis.ravel() for axis in np.meshgrid(np.array(scales), np.array(spreads), indexing="ij"))
    size = people[0].features
    start = np.zeros((len(scale), size))
    state = _evaluated(people, start, np.repeat(start[:, None], len(people), axis=1), scale, spread)
    length = np.ones(len(scale))
    for _ in range(_ITERATIONS):
        step_mu, step_omega, gain, schur = _newton_step(state, scale, spread)
        active = np.flatnonzero(gain > _PRECISE)
        if not active.size:
            return JointModes(scale, spread, state.mu, schur, _log_evidence(state, schur, spread))
        moved = length[active, None] * step_mu[active], length[active, None, None] * step_omega[active]
        new = _evaluated(
            people, state.mu[active] + moved[0], state.omega[active] + moved[1], scale[active], spread[active]
        )
        better = new.value >= state.value[active] + 0.1 * length[active] * gain[active] - 1e-12 * np.abs(new.value)
        state = _replaced(state, active[better], new, better)
        length[active[better]] = np.minimum(1.0, 2 * length[active[better]])
        length[active[~better]] *= 0.25
    raise WorkbenchError(
        f"no joint mode was found in {_ITERATIONS} Newton steps for a spread of {spread[active[0]]:g}; "
        "scale the features to ranges near one."
    )


def _evaluated(
    people: Sequence[Likelihood], mu: FloatArray, omega: FloatArray, scale: FloatArray, spread: FloatArray
) -> _State:
    each = [person.derivatives(omega[:, index]) for index, person in enumerate(people)]
    value = sum((found.value for found in each), start=np.zeros(len(mu)))
    value = value + gaussian_log_density(mu, np.zeros_like(mu), scale)
    value = value + gaussian_log_density(omega, mu[:, None], spread[:, None]).sum(axis=1)
    return _State(
        mu,
        omega,
        value,
        np.stack([found.gradient for found in each], axis=1),
        np.stack([found.curvature for found in each], axis=1),
    )


def _newton_step(
    state: _State, scale: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Steps of mu (C, F) and omega (C, P, F), half the decrement squared (C,), and the Schur complement (C, F, F).

    With A_p = C_p + I / s^2 the complement is I / tau^2 + sum_p (I + s^2 C_p)^-1 C_p: nothing cancels as s falls.
    """
    identity = np.eye(state.mu.shape[1])
    s2 = (spread**2)[:, None, None]
    pull = (state.omega - state.mu[:, None]) / s2
    gradient_omega = state.gradient - pull
    gradient_mu = pull.sum(axis=1) - state.mu / (scale**2)[:, None]
    relative = identity + s2[..., None] * state.curvature  # s^2 A_p
    schur = identity / (scale**2)[:, None, None] + np.linalg.solve(relative, state.curvature).sum(axis=1)
    schur = (schur + np.swapaxes(schur, 1, 2)) / 2
    eliminated = np.linalg.solve(relative, gradient_omega[..., None])[..., 0]  # A_p^-1 g_p / s^2
    step_mu = np.linalg.solve(schur, (gradient_mu + eliminated.sum(axis=1))[..., None])[..., 0]
    right = s2 * gradient_omega + step_mu[:, None]
    step_omega = np.linalg.solve(relative, right[..., None])[..., 0]
    gain = 0.5 * ((gradient_mu * step_mu).sum(axis=1) + (gradient_omega * step_omega).sum(axis=(1, 2)))
    return np.asarray(step_mu), np.asarray(step_omega), np.asarray(gain), np.asarray(schur)


def _log_evidence(state: _State, schur: FloatArray, spread: FloatArray) -> FloatArray:
    people, size = state.omega.shape[1:]
    precision = np.eye(size) / (spread**2)[:, None, None, None] + state.curvature
    log_volume = np.linalg.slogdet(precision)[1].sum(axis=1) + np.linalg.slogdet(schur)[1]
    return np.asarray(state.value + 0.5 * (people + 1) * size * math.log(2 * math.pi) - 0.5 * log_volume)


def _replaced(state: _State, rows: IndexArray, new: _State, kept: BoolArray) -> _State:
    parts = []
    for name in ("mu", "omega", "value", "gradient", "curvature"):
        values = getattr(state, name).copy()
        values[rows] = getattr(new, name)[kept]
        parts.append(values)
    return _State(*parts)
