"""Signs of a damaged or mixed-up recording in the motion of the arm: rates, gaps, speeds, outliers, rests and returns.

Times are those of the recording's clock, which may be nominal: recordings that were made from lists of poses without
times often have 10 Hz or half a second between poses. Measures therefore avoid time where they can, and otherwise also
compare with the recording's own interval between samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IntArray

SPEED_WINDOW_S = 0.05
"""Speeds are averaged over at least this long, because messages that arrive in bursts may be stamped on arrival."""
OUTLIER = 8.0
"""A step is an outlier if it is this many times as long as those around it; at most 4.7 in 80 recordings of people."""
ODD_STEP = 0.05
"""rad or m; a shorter outlier is taken for noise."""
MISSED = 2.5
"""Samples are missing between two if their distance in time is more than this many median intervals."""
SHAKING = 0.5
"""An arm shakes if more than this share of its steps reverses the step before; pure noise has 2 / 3."""
HOME, AWAY = 0.2, 0.5
"""The arm is back at its first pose below the first share of its greatest distance, and away above the second."""
_AROUND = 3  # a step is compared with this many steps on either side
_FEWEST_AROUND = 4  # recordings with no more steps than this have no outliers
_GRID = 2001  # number of poses, evenly spaced in time, among which rests and returns are searched


@dataclass(frozen=True)
class Event:
    """What was measured at a time.

    Attributes:
        at_s: time on the recording's clock, s.
        size: the measured value.
        joint: index of the joint, or -1 if it concerns none.
    """

    at_s: float
    size: float
    joint: int = -1


def rate_hz(time_s: FloatArray) -> float:
    """Samples per second at the times (M,), by the median interval, so that gaps do not count."""
    return 1 / float(np.median(np.diff(time_s)))


def longest_gap(time_s: FloatArray) -> Event:
    """The longest interval (s) between two of the samples (M,), and when it begins."""
    steps = np.diff(time_s)
    row = int(steps.argmax())
    return Event(float(time_s[row]), float(steps[row]))


def greatest_speeds(time_s: FloatArray, q: FloatArray) -> list[Event]:
    """The greatest speed (rad/s or m/s) of each of the J joints, averaged over `SPEED_WINDOW_S` or more, and when.

    Args:
        time_s: (M,) strictly increasing.
        q: (M, J) unwrapped.
    """
    last = len(time_s) - 1
    end = np.searchsorted(time_s, time_s + SPEED_WINDOW_S, side="left")
    begin = np.flatnonzero(end <= last) if (end <= last).any() else np.array([0])
    end = np.minimum(end[begin], last)
    speeds = np.abs(q[end] - q[begin]) / (time_s[end] - time_s[begin])[:, None]
    rows = speeds.argmax(axis=0)
    return [Event(float(time_s[begin[row]]), float(speeds[row, j]), j) for j, row in enumerate(rows)]


def outlying_steps(time_s: FloatArray, q: FloatArray) -> list[Event]:
    """The longest step (rad or m) of each of the J joints that is an outlier; 0 if there is none.

    A step is an outlier if it is more than `OUTLIER` times as long as the median of the three steps before and the
    three after it, where each of these is that of the joint that moves most. A step that takes longer than the median
    interval may be longer in proportion.

    Args:
        time_s: (M,) strictly increasing.
        q: (M, J) unwrapped.
    """
    intervals = np.diff(time_s)
    steps = np.abs(np.diff(q, axis=0)) * np.minimum(1, np.median(intervals) / intervals)[:, None]
    around = _median_around(steps.max(axis=1))
    outlying = np.where(steps > OUTLIER * around[:, None], steps, 0.0)
    rows = outlying.argmax(axis=0)
    return [Event(float(time_s[row + 1]), float(outlying[row, j]), j) for j, row in enumerate(rows)]


def _median_around(steps: FloatArray) -> FloatArray:
    """(M,) the median of the steps (M,) around each, without itself; infinite if there are too few."""
    if len(steps) <= _FEWEST_AROUND:
        return np.full(len(steps), np.inf)
    padded = np.pad(steps, _AROUND, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1)
    others = np.delete(windows, _AROUND, axis=1)
    return np.asarray(np.nanmedian(others, axis=1))


def shaking(q: FloatArray) -> list[Event]:
    """How far each of the J joints shakes (rad or m): the median of its reversing steps, 0 if they are few.

    A joint shakes if more than `SHAKING` of its steps reverse the step before, which happens in noise but in no motion.

    Args:
        q: (M, J) unwrapped.
    """
    steps = np.diff(q, axis=0)
    reversing = steps[1:] * steps[:-1] < 0
    sizes = np.abs(steps[1:])
    return [
        Event(0.0, float(np.median(sizes[reversing[:, j], j])) if reversing[:, j].mean() > SHAKING else 0.0, j)
        for j in range(q.shape[1])
        if len(reversing)
    ]


def irregularity(time_s: FloatArray) -> float:
    """How much the intervals between samples (M,) differ: the range of the middle 90 %, in median intervals."""
    intervals = np.diff(time_s)
    low, high = np.percentile(intervals, [5, 95])
    return float((high - low) / np.median(intervals))


def changing_pace(time_s: FloatArray) -> float:
    """The longest median interval of a tenth of the samples, as a multiple of the shortest."""
    intervals = np.diff(time_s)
    medians = [float(np.median(tenth)) for tenth in np.array_split(intervals, min(10, max(1, len(intervals) // 5)))]
    return max(medians) / min(medians)


def longest_rest(time_s: FloatArray, q: FloatArray, threshold_rad: float) -> Event:
    """The longest time (s) in which no joint moves farther than the threshold, and when it begins."""
    times, poses = _on_grid(time_s, q)
    best, begin = Event(float(times[0]), 0.0), 0
    while begin < len(times) - 1:
        moved = np.abs(poses[begin:] - poses[begin]).max(axis=1) > threshold_rad
        end = begin + (int(moved.argmax()) if moved.any() else len(moved))
        rest = float(times[end - 1] - times[begin])
        best = Event(float(times[begin]), rest) if rest > best.size else best
        begin = max(end, begin + 1)
    return best


def returns(time_s: FloatArray, q: FloatArray) -> list[float]:
    """The times (s) at which the arm is back at its first pose before it leaves again.

    There is one if a recording holds two demonstrations. The distance is the norm of the joints' differences; `AWAY`
    and `HOME` are shares of its greatest value. Of each return, the time is that of the smallest distance.
    """
    times, poses = _on_grid(time_s, q)
    distance = np.linalg.norm(poses - poses[0], axis=1)
    away, home = distance > AWAY * distance.max(), distance < HOME * distance.max()
    moments = []
    for first, last in _runs(~away):
        inner = distance[first:last]
        if first > 0 and last < len(times) and home[first:last].any():
            moments.append(float(times[first + int(inner.argmin())]))
    return moments


def _runs(mask: BoolArray) -> list[tuple[int, int]]:
    """The bounds of each run of true values: the index of its first, and one after its last."""
    edges: IntArray = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _on_grid(time_s: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times and poses at even intervals; the samples themselves if there are few."""
    if len(time_s) <= _GRID:
        return time_s, q
    times = np.linspace(time_s[0], time_s[-1], _GRID)
    return times, np.stack([np.interp(times, time_s, joint) for joint in q.T], axis=1)
