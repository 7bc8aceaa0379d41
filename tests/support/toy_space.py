"""A choice space with closed forms: two joints, one feature the effort, the other linear in the coefficients."""

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.trajectories.exploration.choice_space import ChoiceSpace
from pipeline.trajectories.measures import squared_steps
from pipeline.trajectories.paths import Anchor, sine_basis, straight_path

ANCHOR = Anchor(np.array([0.0, 0.2]), np.array([1.0, -0.3]))
WAYPOINTS, MODES, WIDTH = 21, 3, 0.3
UNIT = 0.2  # rad^2 that the effort is divided by
PULL = 7.0  # rad that the summed deviation is divided by


def assess(waypoints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Features: effort, and the sum over waypoints of the first joint's deviation from the straight path."""
    deviation = (waypoints - straight_path(ANCHOR, WAYPOINTS))[:, :, 0].sum(axis=1) / PULL
    return np.column_stack([squared_steps(waypoints) / UNIT, deviation]), np.ones(len(waypoints), dtype=bool)


def toy_space(effort_multiple: float = 1000.0, **options: object) -> ChoiceSpace:
    """By default the bound is so far out that the base measure is a whole Gaussian."""
    free = np.full(2, np.inf)
    arguments = {"width_rad": WIDTH, "modes": MODES, "decay": 1.0, **options}
    return ChoiceSpace(ANCHOR, WAYPOINTS, -free, free, assess, effort_multiple, **arguments)  # type: ignore[arg-type]


def log_normaliser(omega: FloatArray) -> float:
    """log E[exp(omega . phi)] over the whole Gaussian, a product over modes and joints.

    E exp(-a z^2 + b z) = (1 + 2 a)^(-1/2) exp(b^2 / (2 (1 + 2 a))).
    """
    basis = WIDTH * sine_basis(WAYPOINTS, MODES, 1.0)
    stiffness = (np.diff(basis, axis=1) ** 2).sum(axis=1)
    least = float(squared_steps(straight_path(ANCHOR, WAYPOINTS)[None])[0])
    precision = 1 - 2 * omega[0] * stiffness / UNIT
    pull = omega[1] * basis.sum(axis=1) / PULL
    return float(omega[0] * least / UNIT - np.log(precision).sum() + (pull**2 / precision).sum() / 2)
