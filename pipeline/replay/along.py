"""Features along a trajectory: which part of a feature's value each waypoint has."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import WorkbenchError
from pipeline.vocabulary import GREATEST, LEAST, MEAN, SUM

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pipeline.arrays import FloatArray
    from pipeline.replay.features import FeatureSet

_STILL = 2  # waypoints of a trajectory that stays where it is: kinds that look at steps need two
_JOINED: Mapping[str, Callable[..., FloatArray]] = {MEAN: np.mean, LEAST: np.min, GREATEST: np.max}


def along(features: FeatureSet, waypoints: FloatArray) -> FloatArray:
    """The value of every feature at every waypoint.

    Of a feature that is a sum it is what the waypoint adds: the value up to and with it, less that up to the one
    before; the first has none, as the robot is there before it moves. Of any other it is the value of staying at the
    waypoint. A feature whose values along a trajectory do not make up its value of the whole, such as one of speed, has
    none.

    Args:
        features: bound to their scene.
        waypoints: (n, T, J) rad or m.

    Returns:
        (n, T, F) in the features' units; NaN where there is none.
    """
    n, length, joints = waypoints.shape
    found = np.full((n, length, len(features.names)), np.nan)
    still = np.repeat(waypoints.reshape(-1, 1, joints), _STILL, axis=1)
    for column, over_time in enumerate(features.over_time):
        one = features.only(column)
        try:
            whole = one.evaluate(waypoints)[:, 0]
            if over_time == SUM:
                sums = np.stack([one.evaluate(waypoints[:, : t + 1])[:, 0] for t in range(length)], axis=1)
                values = np.diff(sums, axis=1, prepend=0.0)
                if not sums[:, 0].any():
                    values[:, 0] = np.nan
                joined = sums[:, -1]
            else:
                values = one.evaluate(still)[:, 0].reshape(n, length)
                joined = _JOINED[over_time](values, axis=1)
        except WorkbenchError:
            continue  # a kind that needs more waypoints than these
        if np.allclose(joined, whole, rtol=1e-6, atol=1e-9):
            found[:, :, column] = values
    return found
