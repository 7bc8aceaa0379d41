"""How people's hands move an arm, as measured on recordings: how far they wander, in what shapes, how evenly.

The reference is 81 demonstrations that the lab of the paper's first author recorded on a JACO 2 arm of seven joints,
published in the repositories andreea7b/FERL (60 of twelve people in five conditions, in its history at commit 9707350,
and the 20 of `FERL_demos_tablelaptop_case1.p`) and andreea7b/jaco_learning (one). What stands here are quantiles over
these recordings, measured by `measure` on 41 waypoints uniform in time. No recording is in this project. They say how
hands move, and nothing of what was inferred. `benchmarks/measured_hand.py` makes them from the recordings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.trajectories.paths import sine_basis

MODES = 8
LEVELS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
LENGTH = (1.18, 1.711, 1.907, 2.414, 2.864, 3.356, 3.96, 4.807, 5.459, 6.998, 8.743, 9.522, 20.39)
"""Quantiles of the squared length of the path over the squared distance between its ends, at LEVELS."""
UNEVENNESS = (1.057, 1.1, 1.124, 1.144, 1.163, 1.175, 1.204, 1.222, 1.246, 1.297, 1.356, 1.385, 1.459)
"""Quantiles of the mean squared speed over the squared mean speed, at LEVELS."""
SHARES = (0.8637, 0.08299, 0.03141, 0.008598, 0.005338, 0.002597, 0.001467, 0.0009202)
"""Mean share of the squared deviation from the straight path in half wave 1, 2, ... MODES."""
_TRIMMED = 0.0025  # of the path at either end, which counted as rest when the recordings were measured


@dataclass(frozen=True)
class Habit:
    """How one person moves.

    Attributes:
        length: squared length of the path over the squared distance between its ends, >= 1.
        unevenness: mean squared speed over the squared mean speed, >= 1.
    """

    length: float
    unevenness: float


def draw_habit(rng: np.random.Generator) -> Habit:
    """A habit whose two numbers follow the measured quantiles, independently of each other."""
    length, unevenness = (float(np.interp(rng.random(), LEVELS, values)) for values in (LENGTH, UNEVENNESS))
    return Habit(length, unevenness)


def measure(waypoints: FloatArray) -> tuple[Habit, FloatArray]:
    """How a motion wanders.

    Args:
        waypoints: (T, J), uniform in time, continuous joints unwrapped; start and goal differ.

    Returns:
        Its habit, and (MODES,) shares of the squared deviation from the straight path in joint space.
    """
    steps = np.sqrt((np.diff(waypoints, axis=0) ** 2).sum(axis=1))
    distance = waypoints[-1] - waypoints[0]
    straight = waypoints[0] + np.linspace(0.0, 1.0, len(waypoints))[:, None] * distance
    waves = sine_basis(len(waypoints), MODES, 1.0)
    waves = waves / np.sqrt((waves**2).sum(axis=1))[:, None]
    energies = ((waves @ (waypoints - straight)) ** 2).sum(axis=1)
    habit = Habit(float(steps.sum() ** 2 / (distance @ distance)), float((steps**2).mean() / steps.mean() ** 2))
    return habit, energies / ((waypoints - straight) ** 2).sum()


def wandering(rng: np.random.Generator, path: FloatArray, length: float) -> FloatArray:
    """The path with a slow deviation that makes it as long as asked; unchanged if it is as long already.

    The deviation is a sum of half waves of each joint, with normal heights of the measured shares.

    Args:
        rng: draws the deviation.
        path: (T, J).
        length: squared length over the squared distance of the ends that the path is to have.
    """
    waves = sine_basis(len(path), MODES, 1.0)
    heights = rng.standard_normal((MODES, path.shape[1])) * np.sqrt(SHARES)[:, None]
    deviation = (waves / np.sqrt((waves**2).sum(axis=1))[:, None]).T @ heights
    distance = float(np.linalg.norm(path[-1] - path[0]))
    wanted = np.sqrt(length) * distance

    def long(amplitude: float) -> float:
        return float(np.sqrt((np.diff(path + amplitude * deviation, axis=0) ** 2).sum(axis=1)).sum())

    if distance == 0 or long(0.0) >= wanted:
        return path
    low, high = 0.0, 0.1
    while long(high) < wanted:
        low, high = high, 2 * high
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if long(middle) < wanted else (low, middle)
    return np.asarray(path + high * deviation)


def uneven_speed(rng: np.random.Generator, ramp: FloatArray, unevenness: float) -> FloatArray:
    """A speed profile of the unevenness asked for, or that of the ramp if it is more uneven already.

    Args:
        rng: draws how the speed varies.
        ramp: (M,) speed while nothing varies: zero at both ends.
        unevenness: mean squared speed over the squared mean speed.
    """
    variation = rng.standard_normal(4) @ sine_basis(len(ramp), 4, 1.0)

    def uneven(strength: float) -> float:
        speed = ramp * np.exp(strength * variation)
        covered = np.cumsum(speed) / speed.sum()
        speed = speed[(covered > _TRIMMED) & (covered < 1 - _TRIMMED)]
        return float((speed**2).mean() / speed.mean() ** 2)

    low, high = 0.0, 0.1
    while uneven(high) < unevenness and high < 20:
        low, high = high, 2 * high
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if uneven(middle) < unevenness else (low, middle)
    return np.asarray(ramp * np.exp(high * variation)) if uneven(0.0) < unevenness else ramp
