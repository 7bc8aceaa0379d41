"""Features and admissibility of trajectories from one replay, for searches that look at very many of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatArray
from pipeline.replay.features import FeatureSet
from pipeline.replay.replay import replay
from pipeline.replay.surface import Surface


def assessment(
    features: FeatureSet, scales: FloatArray, surface: str | None
) -> Callable[[FloatArray], tuple[FloatArray, NDArray[np.bool_]]]:
    """A function from waypoints (N, T, J) to scaled features (N, F) and whether the surface is cleared (N,).

    Args:
        features: of the task.
        scales: (F,) what each feature is divided by.
        surface: name of the site that nothing may go under; None: there is none.

    Raises:
        SceneError: see `Surface`.
    """
    top = None if surface is None else Surface(features.scene, surface)

    def assess(waypoints: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        values = np.empty((len(waypoints), len(features.names)))
        clear = np.ones(len(waypoints), dtype=bool)
        for motion in replay(features.scene, waypoints):
            rows = slice(motion.first, motion.first + len(motion.waypoints))
            values[rows] = features.of(motion)  # `FeatureSet.evaluate` would replay a second time
            if top is not None:
                clear[rows] = top.cleared_by(motion)
        return values / scales, clear

    return assess
