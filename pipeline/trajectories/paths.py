"""Paths in joint space: where they start and end, and the shapes that samplers and optimisers build them from.

Conventions: waypoints are (N, T, J), N trajectories of T waypoints of J joints (rad, or m for a sliding joint),
evenly spaced in time; `s` in [0, 1] is the fraction of that time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import ArgumentError

Admissible = Callable[[FloatArray], BoolArray]
"""From waypoints (N, T, J) to (N,) booleans: which paths the scene allows."""


@dataclass(frozen=True, eq=False)
class Anchor:
    """Where a trajectory starts and ends: two (J,) joint positions, in the same turn of every continuous joint."""

    start: FloatArray
    goal: FloatArray

    def __post_init__(self) -> None:
        for name in ("start", "goal"):
            value = frozen(getattr(self, name))
            object.__setattr__(self, name, value)
            if value.ndim != 1 or not np.isfinite(value).all():
                raise ArgumentError(f"anchor.{name} is {value}; it must be a vector of finite joint positions.")
        if self.start.shape != self.goal.shape:
            raise ArgumentError(
                f"anchor.start has {self.start.size} joints and anchor.goal {self.goal.size}; give both the same."
            )


def straight_path(anchor: Anchor, n_waypoints: int) -> FloatArray:
    """(T, J) the straight joint path at even speed; its first and last row equal the anchor's to the last bit."""
    s = np.linspace(0.0, 1.0, n_waypoints)[:, None]
    line = anchor.start + s * (anchor.goal - anchor.start)
    line[-1] = anchor.goal
    return line


def sine_basis(n_waypoints: int, modes: int, decay: float) -> FloatArray:
    """Half waves (modes, T), b_k(s) = c k^-decay sin(pi k s), scaled so that sum_k b_k^2 averages to one over s.

    They are exactly zero at both ends. With decay 1 the sum of squared steps of sum_k z_k b_k is a multiple of |z|^2,
    up to the discretisation.

    Raises:
        ArgumentError: modes is not between 1 and the number of inner waypoints, or decay is negative.
    """
    if not 1 <= modes <= n_waypoints - 2:
        raise ArgumentError(
            f"modes is {modes}; {n_waypoints} waypoints allow 1 to {n_waypoints - 2} (their inner waypoints)."
        )
    if not 0 <= decay < np.inf:
        raise ArgumentError(f"decay is {decay}; it must be a finite number >= 0.")
    k = np.arange(1.0, modes + 1)[:, None]
    amplitude = k**-decay
    basis = amplitude * np.sin(np.pi * k * np.linspace(0.0, 1.0, n_waypoints))
    basis[:, [0, -1]] = 0.0
    scaled: FloatArray = basis * np.sqrt(2 / (amplitude**2).sum())
    return scaled


def natural_bump(s: FloatArray, peak: FloatArray) -> FloatArray:
    """(N, T) natural cubic splines through (0, 0), (peak, 1) and (1, 0), at s (T,), for peaks (N, 1) between 0 and 1.

    It is the shape of a beam resting on its ends under a point load at `peak`.
    """
    before_peak = s <= peak
    to_end = np.where(before_peak, s, 1 - s)  # distance from the end on this side of the load
    load = np.where(before_peak, 1 - peak, peak)  # distance of the load from the other end
    bump: FloatArray = to_end * load * (1 - load**2 - to_end**2) / (2 * peak**2 * (1 - peak) ** 2)
    bump[:, [0, -1]] = 0.0
    return bump


def within_limits(waypoints: FloatArray, lower: FloatArray, upper: FloatArray) -> BoolArray:
    """(N,) whether each trajectory (N, T, J) keeps the joint limits (J,) at every waypoint."""
    return np.asarray(((waypoints >= lower) & (waypoints <= upper)).all(axis=(1, 2)))


def require_anchor_within(anchor: Anchor, lower: FloatArray, upper: FloatArray) -> None:
    """Raise an ArgumentError if start or goal is outside the joint limits (J,)."""
    for name, value in (("start", anchor.start), ("goal", anchor.goal)):
        outside = np.flatnonzero((value < lower) | (value > upper))
        if outside.size:
            j = int(outside[0])
            raise ArgumentError(
                f"anchor.{name} has joint {j + 1} at {value[j]:.6g}; its limits are {lower[j]:.6g} to {upper[j]:.6g}."
            )


def require_positive(name: str, value: float) -> None:
    """Raise an ArgumentError if `value` is not a finite number above zero."""
    if not 0 < value < np.inf:
        raise ArgumentError(f"{name} is {value}; it must be a finite number > 0.")


def frozen(values: FloatArray) -> FloatArray:
    """A read-only float64 copy."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
