"""Kinds of features that average over a motion or take its extreme: how it moves, where it is, how the arm stands.

Alternatives are paths without a duration. So kinds that speak of time take every motion to last `duration_s`.
"""

from __future__ import annotations

import mujoco
import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError, SceneError, one_of
from pipeline.replay.kinds.register import feature
from pipeline.replay.replay import Motion
from pipeline.replay.scene import Scene
from pipeline.trajectories.measures import share_within
from pipeline.vocabulary import COST, EITHER, GREATEST, LEAST, MEAN, WISH

_AXES = "xyz"


@feature("speed", unit="m/s", direction=COST, over_time=GREATEST)
def speed(motion: Motion, *, of: str = "", duration_s: float = 1.0) -> FloatArray:
    """Greatest speed of a body or site (the end effector), from one waypoint to the next."""
    steps = np.diff(motion.looked_at(of), axis=1)
    per_step_s = _duration(duration_s) / steps.shape[1]
    return np.asarray(np.linalg.norm(steps, axis=-1).max(axis=1) / per_step_s)


@feature("jerk", unit="m^2/s^6", direction=COST, over_time=MEAN)
def jerk(motion: Motion, *, of: str = "", duration_s: float = 1.0) -> FloatArray:
    """Squared third derivative of the position of a body or site (the end effector), by finite differences."""
    positions = motion.looked_at(of)
    if positions.shape[1] < 4:
        raise ArgumentError("jerk needs at least 4 waypoints; raise ingest.waypoints.")
    per_step_s = _duration(duration_s) / (positions.shape[1] - 1)
    third = np.diff(positions, n=3, axis=1) / per_step_s**3
    return np.asarray(np.einsum("ntd,ntd->nt", third, third).mean(axis=1))


@feature("clearance", unit="m", direction=WISH, over_time=LEAST)
def clearance(motion: Motion, *, over: str, of: str = "") -> FloatArray:
    """Least height of a body or site (the end effector) over a box site's upper side, or over another's origin."""
    height = motion.looked_at(of)[..., 2] - motion.position(over)[..., 2]
    return np.asarray((height - _half_height(motion, over)).min(axis=1))


@feature("distance", unit="m", direction=EITHER, over_time=MEAN)
def distance(motion: Motion, *, object: str, of: str = "") -> FloatArray:
    """Distance of a body or site (the end effector) from another."""
    return _mean_distance(motion.looked_at(of), motion.position(object))


@feature("point_distance", unit="m", direction=EITHER, over_time=MEAN)
def point_distance(motion: Motion, *, x_m: float, y_m: float, z_m: float, of: str = "") -> FloatArray:
    """Distance of a body or site (the end effector) from a point of the world."""
    return _mean_distance(motion.looked_at(of), np.array([x_m, y_m, z_m]))


@feature("upright", unit="rad", direction=COST, over_time=GREATEST)
def upright(motion: Motion, *, body: str, axis: str = "z") -> FloatArray:
    """Greatest angle between an axis of a body or site and the vertical: 0 for a cup that is never tilted."""
    if axis not in tuple(_AXES):
        raise ArgumentError(f"axis is {axis!r}; allowed are {one_of(_AXES)}.")
    along = motion.axes(body)[..., _AXES.index(axis)]
    return np.asarray(np.arctan2(np.hypot(along[..., 0], along[..., 1]), along[..., 2]).max(axis=1))


@feature("time_near", unit="share of the time", direction=EITHER, over_time=MEAN)
def time_near(motion: Motion, *, object: str, radius_m: float, of: str = "") -> FloatArray:
    """Share of the time in which a body or site (the end effector) is within a radius of another."""
    return share_within(motion.looked_at(of) - motion.position(object), radius_m)


@feature("contact", unit="share of the time", direction=COST, over_time=MEAN)
def contact(motion: Motion, *, object: str = "", of: str = "") -> FloatArray:
    """Share of the waypoints at which a body touches another, each with its children in the scene.

    Without `of`, everything that the joints move; without `object`, anything, the arm itself too. What touches is what
    MuJoCo says, see `Motion.touching`.

    Raises:
        SceneError: nothing that the joints move can touch anything, or there is no such body.
    """
    return np.asarray(motion.touching(of, object).mean(axis=1))


@feature("limit_nearness", unit="share of half the range", direction=COST, over_time=GREATEST)
def limit_nearness(motion: Motion) -> FloatArray:
    """How far any joint is from the middle of its range: 0 in the middle, 1 at a limit.

    Joints without two limits are left out.

    Raises:
        SceneError: no joint has two limits.
    """
    lower, upper = motion.scene.lower, motion.scene.upper
    limited = np.isfinite(lower) & np.isfinite(upper)
    if not limited.any():
        raise SceneError(f"{motion.scene.path}: no joint has limits, so none can be near; leave limit_nearness out.")
    middle, half = (lower[limited] + upper[limited]) / 2, (upper[limited] - lower[limited]) / 2
    return np.asarray((np.abs(motion.waypoints[..., limited] - middle) / half).max(axis=(1, 2)))


def _volume_unit(scene: Scene) -> str:
    power = min(3, len(scene.joints))
    if scene.slides.any():
        return "1" if scene.slides.all() else f"m^{power}/rad^{power}, or m/m of slides"
    return f"m^{power}/rad^{power}" if power > 1 else "m/rad"


@feature("manipulability", unit=_volume_unit, direction=WISH, over_time=LEAST)
def manipulability(motion: Motion, *, of: str = "") -> FloatArray:
    """Least sqrt(det(J J^T)) of the Jacobian of the position of a body or site (the end effector): 0 in a singularity.

    With fewer than three joints det(J^T J), so that it is the volume that unit joint velocities span in any case.

    Source: Yoshikawa, Manipulability of Robotic Mechanisms, 1985, equation 8.
    """
    jacobian = motion.jacobian(of or motion.scene.end_effector)
    transposed = np.swapaxes(jacobian, -1, -2)
    squares = jacobian @ transposed if jacobian.shape[-1] >= 3 else transposed @ jacobian
    return np.asarray(np.sqrt(np.maximum(np.linalg.det(squares), 0.0)).min(axis=1))


def _duration(duration_s: float) -> float:
    if not 0 < duration_s < np.inf:
        raise ArgumentError(f"duration_s is {duration_s}; it must be positive and finite.")
    return duration_s


def _mean_distance(positions: FloatArray, others: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(positions - others, axis=-1).mean(axis=1))


def _half_height(motion: Motion, name: str) -> FloatArray | float:
    """From the origin of a box site to its highest corner, whichever way it is turned; 0 of all else."""
    kind, index = motion.scene.place(name)
    model = motion.scene.model
    if kind == "body" or model.site_type[index] != mujoco.mjtGeom.mjGEOM_BOX:
        return 0.0
    return np.asarray(np.abs(motion.axes(name)[..., 2, :]) @ model.site_size[index])
