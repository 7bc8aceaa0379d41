"""Sums over the waypoints of a trajectory, and shares of its time: the formulas behind the features.

The robot is at the first waypoint before it moves, so sums run over waypoints 1 to T-1 (LESS, section 6, as the
authors' lab defines its features on the arm).
"""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError


def squared_steps(waypoints: FloatArray) -> FloatArray:
    """Sum of squared steps, sum_{t=1}^{T-1} |q_t - q_{t-1}|^2.

    Args:
        waypoints: (N, T, J) rad or m; continuous joints unwrapped.

    Returns:
        (N,) rad^2 or m^2.

    Raises:
        ArgumentError: waypoints are not (N, T, J).
    """
    steps = np.diff(_shaped("waypoints", waypoints, 3), axis=1)
    return np.asarray(np.einsum("ntj,ntj->n", steps, steps))


def path_lengths(positions: FloatArray) -> FloatArray:
    """Length of each path, sum_{t=1}^{T-1} |x_t - x_{t-1}|.

    Args:
        positions: (N, T, D) m.

    Returns:
        (N,) m.

    Raises:
        ArgumentError: positions are not (N, T, D).
    """
    steps = np.diff(_shaped("positions", positions, 3), axis=1)
    return np.asarray(np.sqrt(np.einsum("ntd,ntd->nt", steps, steps)).sum(axis=1))


def summed_height(heights: FloatArray) -> FloatArray:
    """Sum of heights, sum_{t=1}^{T-1} z_t.

    Args:
        heights: (N, T) m.

    Returns:
        (N,) m.

    Raises:
        ArgumentError: heights are not (N, T).
    """
    return np.asarray(_shaped("heights", heights, 2)[:, 1:].sum(axis=1))


def summed_closeness(positions: FloatArray, centre: FloatArray, radius_m: float) -> FloatArray:
    """Closeness to a centre, sum_{t=1}^{T-1} max(0, radius - horizontal distance of x_t to the centre).

    Args:
        positions: (N, T, 2 or 3) m; a third coordinate is ignored.
        centre: (2 or 3,) m, or one per waypoint (N, T, 2 or 3).
        radius_m: distance from which on the centre no longer matters, > 0.

    Returns:
        (N,) m.

    Raises:
        ArgumentError: positions or centre have another shape, or the radius is not positive and finite.
    """
    positions, centre = _shaped("positions", positions, 3), np.asarray(centre, dtype=np.float64)
    if positions.shape[2] not in (2, 3):
        raise ArgumentError(f"positions have {positions.shape[2]} coordinates; allowed are 2 or 3.")
    if centre.shape[-1:] not in ((2,), (3,)) or centre.shape[:-1] not in ((), positions.shape[:2]):
        raise ArgumentError(
            f"centre has shape {centre.shape}; it must be (2,), (3,) or one such point per waypoint of positions."
        )
    if not 0 < radius_m < np.inf:
        raise ArgumentError(f"radius_m is {radius_m}; it must be positive and finite.")
    offsets = (positions[..., :2] - centre[..., :2])[:, 1:]
    distances = np.sqrt(offsets[..., 0] ** 2 + offsets[..., 1] ** 2)  # faster than hypot; nothing overflows
    return np.asarray(np.maximum(0.0, radius_m - distances).sum(axis=1))


def summed_tilt(axes: FloatArray) -> FloatArray:
    """Sum over t = 1 to T-1 of the angle between an axis and the vertical, atan2(|horizontal part|, z).

    Args:
        axes: (N, T, 3), each of any positive length.

    Returns:
        (N,) rad.

    Raises:
        ArgumentError: axes are not (N, T, 3).
    """
    axes = _shaped("axes", axes, 3)
    if axes.shape[2] != 3:
        raise ArgumentError(f"axes have {axes.shape[2]} coordinates; allowed are 3.")
    angles = np.arctan2(np.hypot(axes[:, 1:, 0], axes[:, 1:, 1]), axes[:, 1:, 2])
    return np.asarray(angles.sum(axis=1))


def share_within(offsets: FloatArray, radius_m: float) -> FloatArray:
    """Share of the time in which |offset| <= radius, the offset linear in time between waypoints.

    Args:
        offsets: (N, T, D) m, from a centre, at waypoints that are evenly spaced in time; T >= 2.
        radius_m: > 0.

    Returns:
        (N,) from 0 to 1.

    Raises:
        ArgumentError: the radius is not positive and finite, or there are fewer than two waypoints.
    """
    if not 0 < radius_m < np.inf:
        raise ArgumentError(f"radius_m is {radius_m}; it must be positive and finite.")
    if offsets.ndim != 3 or offsets.shape[1] < 2:
        raise ArgumentError(f"offsets have shape {offsets.shape}; they must be (N, T, D) with at least 2 waypoints.")
    first, step = offsets[:, :-1], np.diff(offsets, axis=1)
    # |first + s step|^2 = radius^2 at the ends of an interval of s, which is cut to 0..1
    square = np.einsum("ntd,ntd->nt", step, step)
    middle = np.einsum("ntd,ntd->nt", first, step)
    beyond = np.einsum("ntd,ntd->nt", first, first) - radius_m**2
    still = square == 0
    safe = np.where(still, 1.0, square)
    root = np.sqrt(np.maximum(middle**2 - safe * beyond, 0.0))
    enters, leaves = (np.clip((-middle + sign * root) / safe, 0.0, 1.0) for sign in (-1, 1))
    return np.asarray(np.where(still, beyond <= 0, leaves - enters).mean(axis=1))


def _shaped(name: str, values: FloatArray, dimensions: int) -> FloatArray:
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != dimensions or values.shape[1] < 1:
        axes = ("N", "T", "D")[:dimensions]
        raise ArgumentError(
            f"{name} have shape {values.shape}; they must be ({', '.join(axes)}) with at least one waypoint."
        )
    return values
