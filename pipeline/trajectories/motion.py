"""How an arm moves in a recording: its rate, gaps and speed, and what no arm does or no single demonstration has.

Times are those of the recording's clock, which may be nominal: recordings that were made from bare lists of poses have
10 Hz or half a second between poses by decree. What depends on time is therefore also measured against the recording's
own interval, and what can be told without time is told without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IntArray

SPEED_WINDOW_S = 0.05
"""Speeds are taken over at least this long, as messages may be stamped when they arrive, in bursts."""
OUTLIER = 8.0
"""Times as far as in the steps around it: a step that is an outlier. In 80 recordings of people the most is 4.7."""
ODD_STEP = 0.05
"""rad or m; an outlier below it is no more than noise."""
MISSED = 2.5
"""Sampling intervals; a longer step in time says that samples are missing."""
SHAKING = 0.5
"""Share of the steps that are against the step before them; of noise it is 2 / 3."""
HOME, AWAY = 0.2, 0.5
"""Shares of the greatest distance from the first pose: nearer than the one is back, farther than the other is away."""
_AROUND = 3  # steps on either side
_FEWEST_AROUND = 4
_GRID = 2001  # poses, evenly in time, on which rests and returns are looked for


@dataclass(frozen=True)
class Event:
    """Something at a time (s, on the recording's clock): how much, and the index of the joint, -1 if of none."""

    at_s: float
    size: float
    joint: int = -1


def rate_hz(time_s: FloatArray) -> float:
    """Samples (M,) per second, by the median interval, so that a gap does not count."""
    return 1 / float(np.median(np.diff(time_s)))


def longest_gap(time_s: FloatArray) -> Event:
    """The longest time between two samples, at its beginning."""
    steps = np.diff(time_s)
    row = int(steps.argmax())
    return Event(float(time_s[row]), float(steps[row]))


def greatest_speeds(time_s: FloatArray, q: FloatArray) -> list[Event]:
    """For each of the J joints its greatest speed (rad/s or m/s) over `SPEED_WINDOW_S` or more, and when.

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
    """For each of the J joints its longest step that is an outlier among the steps around it, 0 if there is none.

    A step is one if it is `OUTLIER` times as long as the median of the three steps before and the three after it, of
    whichever joint moves most. A step that takes longer than usual may be longer in proportion.

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
    """(M,) the median of the steps on either side, infinite where there are too few."""
    if len(steps) <= _FEWEST_AROUND:
        return np.full(len(steps), np.inf)
    padded = np.pad(steps, _AROUND, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1)
    others = np.delete(windows, _AROUND, axis=1)
    return np.asarray(np.nanmedian(others, axis=1))


def shaking(q: FloatArray) -> list[Event]:
    """For each of the J joints by how much it goes to and fro from sample to sample, 0 if it does so in few of them.

    It does if most of its steps are against the step before them, which noise does and no motion: the median of these.

    Args:
        q: (M, J) unwrapped.
    """
    steps = np.diff(q, axis=0)
    against = steps[1:] * steps[:-1] < 0
    sizes = np.abs(steps[1:])
    return [
        Event(0.0, float(np.median(sizes[against[:, j], j])) if against[:, j].mean() > SHAKING else 0.0, j)
        for j in range(q.shape[1])
        if len(against)
    ]


def irregularity(time_s: FloatArray) -> float:
    """How much intervals between samples differ: what 9 of 10 span, in median intervals."""
    intervals = np.diff(time_s)
    low, high = np.percentile(intervals, [5, 95])
    return float((high - low) / np.median(intervals))


def changing_pace(time_s: FloatArray) -> float:
    """The longest median interval of a tenth of the samples, as a multiple of the shortest."""
    intervals = np.diff(time_s)
    medians = [float(np.median(tenth)) for tenth in np.array_split(intervals, min(10, max(1, len(intervals) // 5)))]
    return max(medians) / min(medians)


def longest_rest(time_s: FloatArray, q: FloatArray, threshold_rad: float) -> Event:
    """The longest time during which no joint goes further than the threshold from where it is at its beginning."""
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
    """When the arm comes back to where it began and leaves again, s: once for two demonstrations in one recording.

    Of the greatest distance from the first pose, the length of the joints' differences, `AWAY` counts as away and `HOME`
    as back; the moment is that at which it is nearest.
    """
    times, poses = _on_grid(time_s, q)
    distance = np.linalg.norm(poses - poses[0], axis=1)
    away, home = distance > AWAY * distance.max(), distance < HOME * distance.max()
    found = []
    for first, last in _runs(~away):
        inner = distance[first:last]
        if first > 0 and last < len(times) and home[first:last].any():
            found.append(float(times[first + int(inner.argmin())]))
    return found


def _runs(mask: BoolArray) -> list[tuple[int, int]]:
    """First and behind the last of each run of true values."""
    edges: IntArray = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _on_grid(time_s: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    if len(time_s) <= _GRID:
        return time_s, q
    times = np.linspace(time_s[0], time_s[-1], _GRID)
    return times, np.stack([np.interp(times, time_s, joint) for joint in q.T], axis=1)
