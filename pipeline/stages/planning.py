"""What planning a path for a task needs: where it starts and ends, what is allowed, and what a path costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.choice.scaling import feature_scale
from pipeline.errors import StageError
from pipeline.params import Task
from pipeline.replay.preferences import Preferences
from pipeline.replay.replay import clear_of
from pipeline.replay.scene import Scene
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.samplers import Deformation, draw_admissible

Array = NDArray[np.float64]
POOL = 1000  # trajectories on which the terms of the cost are brought to one scale


@dataclass(frozen=True)
class Planning:
    """The scene of a task as the samplers and the optimiser see it."""

    scene: Scene
    task: Task
    waypoints: int

    def admissible(self, waypoints: Array) -> NDArray[np.bool_]:
        """(N, T, J) -> (N,): nothing goes through the task's surface."""
        if self.task.surface is None:
            return np.ones(len(waypoints), dtype=bool)
        return clear_of(self.scene, waypoints, self.task.surface)

    @property
    def anchor(self) -> Anchor:
        """The scene's start and goal.

        Raises:
            StageError: the scene has no goal.
        """
        if self.scene.start is None or self.scene.goal is None:
            raise StageError(
                f"{self.task.scene}: has no keyframes `start` and `goal`, which are needed to plan paths; add them, or "
                "set sample.anchor to demonstration"
            )
        return Anchor(self.scene.start, self.scene.goal)

    def preferences(self) -> Preferences:
        """The terms that a path may be planned for."""
        return Preferences(self.scene, self.task.preferences)

    def preference_scales(self, rng: np.random.Generator, sampler: Deformation) -> Array:
        """(F,) what each term is divided by: its range over deformations of the straight path."""
        draw = draw_admissible(
            sampler, rng, self.anchor, POOL, self.waypoints,
            lower=self.scene.lower, upper=self.scene.upper, admissible=self.admissible,
        )  # fmt: skip
        return feature_scale(self.preferences()(draw.waypoints), "range", self.preferences().names)
