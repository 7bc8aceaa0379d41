"""What planning a path for a task needs: where it starts and ends, what is allowed, and what a path costs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.scaling import feature_scale
from pipeline.errors import StageError
from pipeline.params import Task
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.replay import replay
from pipeline.replay.scene import Scene
from pipeline.replay.surface import Surface, clear_of
from pipeline.trajectories.optimise import Assess, Search
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.samplers import Deformation, Draw, Sampler, draw_admissible

POOL = 1000  # trajectories on which the terms of the cost are brought to one scale
SEARCH = Search(iterations=60)  # closes nine tenths of the gap from the straight path to what a long search finds


@dataclass(frozen=True)
class Room:
    """Where an arm may be: within its joints' limits and above the task's surface, if it has one."""

    scene: Scene
    surface: str | None

    def admissible(self, waypoints: FloatArray) -> BoolArray:
        """(N, T, J) -> (N,): nothing goes through the surface."""
        if self.surface is None:
            return np.ones(len(waypoints), dtype=bool)
        return clear_of(self.scene, waypoints, self.surface)

    def limits(self, anchor: Anchor) -> tuple[FloatArray, FloatArray]:
        """Least and greatest joint positions (J,). A person may start or end beyond a limit: then that is the limit."""
        lower = np.minimum(self.scene.lower, np.minimum(anchor.start, anchor.goal))
        return lower, np.maximum(self.scene.upper, np.maximum(anchor.start, anchor.goal))

    def draw(self, sampler: Sampler, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int) -> Draw:
        """Alternatives that keep to it."""
        lower, upper = self.limits(anchor)
        return draw_admissible(
            sampler, rng, anchor, count, n_waypoints, lower=lower, upper=upper, admissible=self.admissible
        )


@dataclass(frozen=True)
class Planning:
    """The scene of a task as the samplers and the optimiser see it."""

    scene: Scene
    task: Task
    waypoints: int

    @property
    def anchor(self) -> Anchor:
        """The scene's start and goal.

        Raises:
            StageError: the scene has no start or no goal.
        """
        if self.scene.start is None or self.scene.goal is None:
            raise StageError(
                f"{self.task.scene}: has no keyframes `start` and `goal`, which are needed to plan paths; add them, or "
                "set the task's anchor to demonstration"
            )
        return Anchor(self.scene.start, self.scene.goal)

    @cached_property
    def preferences(self) -> FeatureSet:
        """What a path may be planned for: features of any registered kind, since a plan is judged by its replay.

        The task lists them apart from the robot's features. Those are its guess at what people care about, and a change
        of the guess must change neither the people nor the paths that were sampled.
        """
        return bind_features(self.scene, self.task.preferences, "preferences")

    @property
    def room(self) -> Room:
        """Where the arm may be."""
        return Room(self.scene, self.task.surface)

    def assess(self, waypoints: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(N, T, J) -> raw cost terms (N, F) and whether the surface is cleared (N,), from one replay."""
        top = Surface(self.scene, self.task.surface) if self.task.surface else None
        parts = [
            (self.preferences.of(motion), top.cleared_by(motion) if top else np.ones(len(motion.waypoints), bool))
            for motion in replay(self.scene, waypoints)
        ]
        return np.concatenate([terms for terms, _ in parts]), np.concatenate([clear for _, clear in parts])

    def preference_scales(self, rng: np.random.Generator, anchor: Anchor, sampler: Deformation) -> FloatArray:
        """(F,) what each term is divided by: its range over deformations of the straight path."""
        draw = self.room.draw(sampler, rng, anchor, POOL, self.waypoints)
        return feature_scale(self.assess(draw.waypoints)[0], "range", self.preferences.names)

    def scaled(self, scales: FloatArray) -> Assess:
        """`assess` with its terms divided by `scales` (F,)."""

        def assess(waypoints: FloatArray) -> tuple[FloatArray, BoolArray]:
            terms, clear = self.assess(waypoints)
            return terms / scales, clear

        return assess
