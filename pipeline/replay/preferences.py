"""What a path is planned for, by simulated people and by the planner sampler.

These are kept apart from the features on purpose: a robot's features are its guess at what people care about, and a
change of the guess changes neither the people nor the paths that were sampled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ParameterError, one_of
from pipeline.replay.replay import Motion
from pipeline.replay.scene import Scene
from pipeline.trajectories.measures import squared_steps, summed_closeness, summed_height

ARGUMENTS = {"efficiency": set[str](), "height": set[str](), "proximity": {"object", "radius_m"}}


@dataclass(frozen=True)
class Preferences:
    """Cost terms of replayed trajectories, in the order of `specs`.

    Attributes:
        scene: where the trajectories are replayed.
        specs: per name, `kind` (efficiency, height or proximity) and its arguments; see `measures`.
    """

    scene: Scene
    specs: Mapping[str, Mapping[str, object]]

    def __post_init__(self) -> None:
        for name, spec in self.specs.items():
            kind = spec.get("kind")
            if kind not in ARGUMENTS:
                raise ParameterError(f"preferences.{name} has the kind {kind!r}; allowed are {one_of(ARGUMENTS)}")
            if set(spec) - {"kind"} != ARGUMENTS[str(kind)]:
                needed = one_of(ARGUMENTS[str(kind)]) or "none"
                raise ParameterError(f"preferences.{name} has {one_of(spec)}; besides `kind`, {kind} takes {needed}")

    @property
    def names(self) -> tuple[str, ...]:
        """The F names."""
        return tuple(self.specs)

    def terms(self, motion: Motion) -> FloatArray:
        """Raw cost terms (n, F) of the n trajectories of a replay."""
        return np.stack([_term(motion, spec) for spec in self.specs.values()], axis=1)


def _term(motion: Motion, spec: Mapping[str, object]) -> FloatArray:
    if spec["kind"] == "efficiency":
        return squared_steps(motion.waypoints)
    if spec["kind"] == "height":
        return summed_height(motion.end_effector[:, :, 2])
    centre = motion.position(str(spec["object"]))[0, 0, :2]
    return summed_closeness(motion.end_effector, centre, float(str(spec["radius_m"])))
