"""From the poses of a recording to the waypoints of a demonstration: unwrap, trim, choose the branch, resample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import ArgumentError, RecordingError

TURN = 2 * np.pi


def unwrap(q: ArrayLike, continuous: ArrayLike) -> FloatArray:
    """Remove the jumps of whole turns of continuous joints: consecutive values end up at most half a turn apart.

    Args:
        q: (M, J) rad or m.
        continuous: (J,) bool, which joints have no limits; the others are left as they are.

    Returns:
        (M, J), the first pose unchanged.

    Raises:
        ArgumentError: an argument has the wrong shape or a value that is not finite.
    """
    poses = _poses(q)
    free = _continuous(continuous, poses.shape[1])
    turns = np.cumsum(np.rint(np.diff(poses[:, free], axis=0) / TURN), axis=0)
    poses[1:, free] -= TURN * turns
    return poses


def to_branch(q: ArrayLike, reference: ArrayLike, continuous: ArrayLike) -> FloatArray:
    """Shift a whole trajectory by full turns, per continuous joint, so that it starts nearest to `reference`.

    Args:
        q: (M, J) rad or m, unwrapped.
        reference: (J,) the pose whose branch is wanted, e.g. the start of the scene.
        continuous: (J,) bool, which joints have no limits; the others are left as they are.

    Returns:
        (M, J).

    Raises:
        ArgumentError: an argument has the wrong shape or a value that is not finite.
    """
    poses = _poses(q)
    free = _continuous(continuous, poses.shape[1])
    target = np.asarray(reference, np.float64)
    if target.shape != free.shape or not np.isfinite(target).all():
        raise ArgumentError(f"reference must be {len(free)} finite values, one per joint, got {reference!r}.")
    poses[:, free] += TURN * np.rint((target - poses[0]) / TURN)[free]
    return poses


def trim_idle(time_s: ArrayLike, q: ArrayLike, threshold_rad: float = 0.01) -> slice:
    """Find the part of a recording in which the arm moves.

    The head ends with the last pose before any joint first differs by more than the threshold from the first pose; the
    tail starts likewise, seen from the end. Comparing poses with the resting pose, and not with their neighbours, gives
    the same answer at any rate: the rule "consecutive samples move less than 0.01 rad" suits recordings of about 10 Hz,
    but at 100 Hz it holds for an arm moving at 1 rad/s too. Noise and drift below the threshold count as rest.

    Args:
        time_s: (M,) strictly increasing.
        q: (M, J) rad (m for prismatic joints), unwrapped.
        threshold_rad: largest deviation at rest, per joint.

    Returns:
        The rows from the last pose at rest to the first one at rest again; at least two.

    Raises:
        ArgumentError: an argument is outside what is allowed.
        RecordingError: does-not-move.
    """
    poses = _poses(q)
    _times(time_s, len(poses))
    if not threshold_rad >= 0:
        raise ArgumentError(f"threshold_rad must be 0 or more, got {threshold_rad}.")
    left = np.flatnonzero(np.abs(poses - poses[0]).max(axis=1) > threshold_rad)
    coming = np.flatnonzero(np.abs(poses - poses[-1]).max(axis=1) > threshold_rad)
    # where the poses at rest before and after overlap, nothing is left in between
    if not len(left) or not len(coming) or left[0] > coming[-1] + 1:
        raise RecordingError(
            "does-not-move",
            f"The arm does not move: no joint goes clearly further than {threshold_rad:g} rad from where it rests; "
            "record a motion or lower the idle threshold.",
        )
    return slice(int(left[0]) - 1, int(coming[-1]) + 2)


def resample(time_s: ArrayLike, q: ArrayLike, waypoint_count: int) -> FloatArray:
    """Interpolate linearly at times spread evenly from the first pose to the last; both come out exactly.

    Args:
        time_s: (M,) strictly increasing; relative to the recording's start, epoch seconds lose digits.
        q: (M, J) rad or m, unwrapped.
        waypoint_count: T >= 2.

    Returns:
        (T, J).

    Raises:
        ArgumentError: an argument is outside what is allowed.
    """
    poses = _poses(q)
    times = _times(time_s, len(poses))
    if waypoint_count < 2:
        raise ArgumentError(f"waypoint_count must be 2 or more, got {waypoint_count}.")
    grid = np.linspace(times[0], times[-1], waypoint_count)
    waypoints = np.stack([np.interp(grid, times, joint) for joint in poses.T], axis=1)
    waypoints[0], waypoints[-1] = poses[0], poses[-1]
    return waypoints


@dataclass(frozen=True, eq=False)
class Moving:
    """The part of a recording in which the arm moves.

    Attributes:
        time_s: (M,) on the recording's clock, M >= 2.
        positions: (M, J) rad or m, unwrapped.
    """

    time_s: FloatArray
    positions: FloatArray

    @property
    def start_s(self) -> float:
        """When it begins."""
        return float(self.time_s[0])

    @property
    def duration_s(self) -> float:
        """From its first pose to its last."""
        return float(self.time_s[-1] - self.time_s[0])

    def waypoints(self, reference: ArrayLike, continuous: ArrayLike, count: int) -> FloatArray:
        """(T, J) waypoints, uniform in time, on the branch of `reference`; see `to_branch` and `resample`."""
        return resample(self.time_s, to_branch(self.positions, reference, continuous), count)


def moving_part(time_s: ArrayLike, q: ArrayLike, continuous: ArrayLike, idle_threshold_rad: float = 0.01) -> Moving:
    """Unwrap recorded poses and leave out the rest at both ends; see `unwrap` and `trim_idle`.

    Args:
        time_s: (M,) strictly increasing, relative to the recording's start.
        q: (M, J) rad or m, as recorded.
        continuous: (J,) bool, which joints have no limits.
        idle_threshold_rad: see `trim_idle`.

    Raises:
        ArgumentError: an argument is outside what is allowed.
        RecordingError: does-not-move.
    """
    poses = unwrap(q, continuous)
    times = _times(time_s, len(poses))
    part = trim_idle(times, poses, idle_threshold_rad)
    return Moving(times[part], poses[part])


def _poses(q: ArrayLike) -> FloatArray:
    poses = np.array(q, np.float64)
    if poses.ndim != 2 or len(poses) < 2 or poses.shape[1] < 1:
        raise ArgumentError(f"q must be two or more poses (M, J) of one or more joints, got shape {poses.shape}.")
    if not np.isfinite(poses).all():
        raise ArgumentError("q must be finite.")
    return poses


def _times(time_s: ArrayLike, count: int) -> FloatArray:
    times = np.asarray(time_s, np.float64)
    if times.shape != (count,):
        raise ArgumentError(f"time_s must have one value per pose, shape {(count,)}, got {times.shape}.")
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise ArgumentError("time_s must be finite and increase from each pose to the next.")
    return times


def _continuous(continuous: ArrayLike, count: int) -> BoolArray:
    free = np.asarray(continuous)
    if free.shape != (count,) or free.dtype != np.bool_:
        raise ArgumentError(f"continuous must be {count} booleans, one per joint, got {continuous!r}.")
    return free
