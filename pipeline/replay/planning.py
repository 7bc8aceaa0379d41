"""What planning a path takes: the room that it has, and what it costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.scaling import ROUNDING
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.replay import replay
from pipeline.replay.room import Room
from pipeline.trajectories.optimise import Assess, Search, optimise_paths, random_weights
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import Deformation, Fate
from pipeline.vocabulary import WISH

POOL = 1000  # trajectories on which the terms of the cost are brought to one scale
SEARCH = Search(iterations=60)  # closes nine tenths of the gap from the straight path to what a long search finds


@dataclass(frozen=True, eq=False)
class Planning:
    """Paths between the two ends of a room.

    Attributes:
        room: where they may go.
        preferences: the terms of their cost: features of any registered kind, since a plan is judged by its replay.
        waypoints: T.
    """

    room: Room
    preferences: FeatureSet
    waypoints: int

    @classmethod
    def of(cls, room: Room, preferences: Mapping[str, Mapping[str, object]], waypoints: int) -> Planning:
        """Planning for what a task calls its preferences.

        The task lists them apart from the robot's features. Those are its guess at what people care about, and a change
        of the guess must change neither the people nor the paths that were sampled.

        Raises:
            ParameterError, SceneError: see `bind_features`.
        """
        return cls(room, bind_features(room.scene, preferences, "preferences"), waypoints)

    def assess(self, waypoints: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(N, T, J) -> raw cost terms (N, F) and whether the scene allows the path (N,), from one replay."""
        parts = [
            (self.preferences.of(motion), self.room.judge_motion(motion) == Fate.KEPT)
            for motion in replay(self.room.scene, waypoints)
        ]
        return np.concatenate([terms for terms, _ in parts]), np.concatenate([allowed for _, allowed in parts])

    def scales(self, rng: np.random.Generator) -> FloatArray:
        """(F,) what each term is divided by: its range over deformations of the straight path.

        Infinite for a term that is the same for all of them: no path can be planned for it, so its weight has no
        effect.

        Raises:
            StageError: hardly any deformation keeps to the room.
        """
        terms = self.assess(self.room.draw(Deformation(), rng, POOL, self.waypoints).waypoints)[0]
        ranges = terms.max(axis=0) - terms.min(axis=0)
        return np.where(ranges > ROUNDING * np.abs(terms).max(axis=0), ranges, np.inf)

    def scaled(self, scales: FloatArray) -> Assess:
        """`assess` with its terms divided by `scales` (F,), and negative for wishes, so that less is better of all."""
        signs = np.where(np.array(self.preferences.directions) == WISH, -1.0, 1.0)

        def assess(waypoints: FloatArray) -> tuple[FloatArray, BoolArray]:
            terms, allowed = self.assess(waypoints)
            return signs * terms / scales, allowed

        return assess

    def optimised(self, rngs: list[np.random.Generator], weights: FloatArray, scales: FloatArray) -> FloatArray:
        """Paths (P, T, J) of low cost under each row of weights (P, F) of the scaled terms.

        Raises:
            StageError: no admissible path was found for one of them.
        """
        scene = self.room.scene
        return optimise_paths(
            rngs, self.room.anchor, weights, self.scaled(scales),
            lower=scene.lower, upper=scene.upper, n_waypoints=self.waypoints, search=SEARCH,
        ).waypoints  # fmt: skip

    def unvaried(self, scales: FloatArray) -> tuple[str, ...]:
        """Names of the terms that no path can be planned for."""
        return tuple(name for name, scale in zip(self.preferences.names, scales, strict=True) if np.isinf(scale))


def planned_paths(planning: Planning, count: int, seed: int, *labels: str) -> tuple[FloatArray, tuple[str, ...]]:
    """Paths (P, T, J) under random weights, and the names of the terms that could not be planned for.

    Args:
        planning: for which ends and what.
        count: P.
        seed, labels: of the random streams.

    Raises:
        StageError: see `Planning.scales` and `Planning.optimised`.
    """
    scales = planning.scales(child_rng(seed, *labels, "scales"))
    weights = random_weights(child_rng(seed, *labels, "weights"), count, len(scales))
    rngs = [child_rng(seed, *labels, path) for path in range(count)]
    return planning.optimised(rngs, weights, scales), planning.unvaried(scales)
