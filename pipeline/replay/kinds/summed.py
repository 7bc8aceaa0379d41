"""The kinds of features of LESS, section 6, which sum over waypoints, and two more of their sort."""

from __future__ import annotations

from pipeline.arrays import FloatArray
from pipeline.replay.kinds.register import feature
from pipeline.replay.replay import Motion
from pipeline.replay.scene import Scene
from pipeline.trajectories import measures


def _squared_joint_unit(scene: Scene) -> str:
    units = {"m^2" if slides else "rad^2" for slides in scene.slides}
    return " + ".join(sorted(units))


@feature("efficiency", unit=_squared_joint_unit)
def efficiency(motion: Motion) -> FloatArray:
    """Squared joint steps, summed: small for short and even paths."""
    return measures.squared_steps(motion.waypoints)


@feature("height", unit="m")
def height(motion: Motion, *, above: str = "world", of: str = "") -> FloatArray:
    """Height of a body or site (the end effector) over the origin of another, summed over waypoints."""
    return measures.summed_height(motion.looked_at(of)[..., 2] - motion.position(above)[..., 2])


@feature("proximity", unit="m")
def proximity(motion: Motion, *, object: str, radius_m: float = 0.4, of: str = "") -> FloatArray:
    """How far a body or site (the end effector) is inside a vertical cylinder around another, summed over waypoints."""
    return measures.summed_closeness(motion.looked_at(of), motion.position(object), radius_m)


@feature("path_length", unit="m")
def path_length(motion: Motion, *, of: str = "") -> FloatArray:
    """Distance that a body or site (the end effector) travels."""
    return measures.path_lengths(motion.looked_at(of))


@feature("tilt", unit="rad")
def tilt(motion: Motion, *, body: str) -> FloatArray:
    """Angle between a body's z axis and the vertical, summed over waypoints: 0 for a mug that stays upright."""
    return measures.summed_tilt(motion.rotation(body)[..., 2])
