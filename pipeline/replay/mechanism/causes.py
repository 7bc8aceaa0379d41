"""What joint positions that cannot be right look like: degrees, encoder ticks, percentages, joints in another order."""

from __future__ import annotations

from math import degrees, pi, radians
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import FloatArray

if TYPE_CHECKING:
    from pipeline.replay.mechanism.limits import Limits

RADIANS_AS_DEGREES = radians(2 * pi)  # a whole turn, if its number of radians is taken for degrees
_PERCENT = 100.5
_TICKS = 720.0  # degrees beyond two turns are no degrees
_FAR = 10.0  # times as far as would be usual: nearer positions are out by something smaller
_UNFIT = 1e6
_MANY_TURNS = 4


def likely_cause(limits: Limits, positions: FloatArray) -> str | None:
    """A sentence on what positions (T, J), some beyond their limits, look like, and what to do; or None."""
    for found in (_zeros, _ticks, _degrees_or_percent, _millimetres, _range_in_radians, _another_order):
        cause = found(limits, positions)
        if cause is not None:
            return cause
    return None


def many_turns(limits: Limits, positions: FloatArray) -> str | None:
    """A sentence if a hinge without limits is so many turns away from zero that its positions may be degrees."""
    free = ~limits.slides & np.isinf(limits.lower) & np.isinf(limits.upper)
    turns = np.where(free, np.abs(positions).max(axis=0), 0.0) / (2 * pi)
    j = int(turns.argmax())
    if turns[j] <= _MANY_TURNS:
        return None
    value = positions[np.abs(positions[:, j]).argmax(), j]
    return (
        f"Joint {limits.joints[j]!r} is at {value:.6g} rad, {turns[j]:.0f} turns; if these are degrees, convert them "
        "to radians."
    )


def ranges_in_radians(limits: Limits) -> list[str]:
    """Names of the hinges whose whole range is so small that its radians must have been taken for degrees."""
    return [limits.joints[j] for j in _tiny_ranges(limits)]


def _tiny_ranges(limits: Limits) -> list[int]:
    tiny = ~limits.slides & (limits.upper - limits.lower <= RADIANS_AS_DEGREES)
    return [int(j) for j in np.flatnonzero(tiny)]


def _zeros(limits: Limits, positions: FloatArray) -> str | None:
    silent = ~positions.any(axis=1)
    if not silent.any() or not (silent.all() or limits.fit(positions[~silent]).all()):
        return None
    which = "All positions are" if silent.all() else f"{int(silent.sum())} of {len(positions)} rows are all"
    return f"{which} zero, as a driver or a second publisher without a reading sends them; leave them out."


def _ticks(limits: Limits, positions: FloatArray) -> str | None:
    hinges = positions[:, ~limits.slides]
    if hinges.size and (hinges == np.rint(hinges)).all() and np.abs(hinges).max() > _TICKS:
        return "All are whole numbers, as encoders count ticks; convert them to radians."
    return None


def _degrees_or_percent(limits: Limits, positions: FloatArray) -> str | None:
    hinges = positions[:, ~limits.slides]
    if not hinges.size or np.abs(hinges).max() <= 2 * pi:
        return None
    converted = np.where(limits.slides, positions, np.radians(positions))
    looks = [
        *(["degrees"] if limits.fit(converted)[~limits.slides].all() else []),
        *(["percentages from -100 to 100"] if np.abs(hinges).max() <= _PERCENT else []),
    ]
    return f"They look like {' or '.join(looks)}; convert them to radians." if looks else None


def _millimetres(limits: Limits, positions: FloatArray) -> str | None:
    unfit = ~limits.fit(positions)
    far = np.abs(positions).max(axis=0) > _FAR * np.maximum(np.abs(limits.lower), np.abs(limits.upper))
    if unfit[~limits.slides].any() or not (far & limits.fit(positions / 1000))[unfit].all():
        return None
    return "They look like millimetres; convert them to metres."


def _range_in_radians(limits: Limits, positions: FloatArray) -> str | None:
    for j in _tiny_ranges(limits):
        low, high = degrees(limits.lower[j]), degrees(limits.upper[j])
        if not limits.fit(positions)[j] and ((positions[:, j] >= low) & (positions[:, j] <= high)).all():
            return (
                f"The range of {limits.joints[j]!r} reads as {low:.4g} to {high:.4g} radians that were taken for "
                'degrees: MuJoCo takes degrees unless the file that has the joint says <compiler angle="radian"/>; add '
                "it, or give the range in degrees."
            )
    return None


def _another_order(limits: Limits, positions: FloatArray) -> str | None:
    """Which joints' positions would fit if they were exchanged: the assignment that moves the fewest."""
    if not (limits.excess(positions) > _FAR * limits.tolerance).any():
        return None
    from scipy.optimize import linear_sum_assignment

    beyond = np.maximum(limits.lower[:, None, None] - positions.T, positions.T - limits.upper[:, None, None])
    unfit = (beyond > limits.tolerance[:, None, None]).any(axis=2)  # (J limits, J columns)
    unfit |= limits.slides[:, None] != limits.slides
    cost = np.where(unfit, _UNFIT, 1.0 - np.eye(len(unfit)))
    rows, columns = linear_sum_assignment(cost)
    if cost[rows, columns].sum() >= _UNFIT:
        return None
    moved = [
        f"those of {limits.joints[j]!r} to {limits.joints[i]!r}" for i, j in zip(rows, columns, strict=True) if i != j
    ]
    return f"They would fit in another order ({', '.join(moved)}); check which joint each column belongs to."
