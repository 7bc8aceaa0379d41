"""Features and admissibility of trajectories from one replay, for searches that look at very many of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatArray
from pipeline.replay.features import FeatureSet
from pipeline.replay.replay import replay
from pipeline.replay.room import Room
from pipeline.trajectories.samplers import Fate

CHUNK = 800  # trajectories that are looked at together: few, and calls take longer than numbers
Assess = Callable[[FloatArray], tuple[FloatArray, NDArray[np.bool_]]]
Measure = Callable[[FloatArray], FloatArray]


def assessment(features: FeatureSet, scales: FloatArray, room: Room) -> tuple[Assess, Measure]:
    """Two functions of waypoints (N, T, J).

    The first gives scaled features (N, F) and whether the room has each (N,), the second the features alone.

    Args:
        features: of the task.
        scales: (F,) what each feature is divided by.
        room: where the arm may be.
    """

    def measure(waypoints: FloatArray) -> FloatArray:
        return features.evaluate(waypoints) / scales

    def assess(waypoints: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        values = np.empty((len(waypoints), len(features.names)))
        allowed = np.ones(len(waypoints), dtype=bool)
        for motion in replay(features.scene, waypoints, chunk=CHUNK):
            rows = slice(motion.first, motion.first + len(motion.waypoints))
            values[rows] = features.of(motion)  # `FeatureSet.evaluate` would replay a second time
            if room.top is not None or room.contacts is not None:
                allowed[rows] = room.judge_motion(motion) == Fate.KEPT
        return values / scales, allowed

    return assess, measure
