"""Kinematic replay: every waypoint of every trajectory is posed in the scene, a chunk of trajectories at a time.

The result does not depend on how the trajectories are cut into chunks, to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import ArgumentError, SceneError
from pipeline.replay.chain import Posed, weighted
from pipeline.replay.scene import Scene

_CONFIGURATIONS_PER_CHUNK = 16384  # what is computed of them fits the processor's cache


@dataclass(frozen=True, eq=False)
class Motion:
    """Where everything is while n trajectories of T waypoints are replayed.

    Attributes:
        scene: the scene replayed in.
        first: index of the first of these trajectories among those given to `replay`.
        waypoints: (n, T, J) rad or m.
        posed: the chain of joints at each of the n x T configurations.
    """

    scene: Scene
    first: int
    waypoints: FloatArray
    posed: Posed = field(repr=False)

    def position(self, name: str) -> FloatArray:
        """Origin of a body or site in the world frame, (n, T, 3) m, read-only.

        Raises:
            SceneError: the scene has no body or site of that name.
        """
        kind, index = self.scene.place(name)
        chain = self.scene.chain
        return self._shaped(self.posed.origin((chain.bodies if kind == "body" else chain.sites)[index]))

    def rotation(self, body: str) -> FloatArray:
        """Orientation of a body in the world frame, (n, T, 3, 3), read-only; [..., k] is its axis number k.

        Raises:
            SceneError: the scene has no body of that name.
        """
        axes = self.posed.axes(self.scene.chain.bodies[self.scene.body_id(body)])
        return np.stack([self._shaped(axis) for axis in axes], axis=-1)

    @property
    def end_effector(self) -> FloatArray:
        """Origin of the scene's end effector in the world frame, (n, T, 3) m."""
        return self.position(self.scene.end_effector)

    def _shaped(self, vectors: FloatArray) -> FloatArray:
        trajectories, length, _ = self.waypoints.shape
        rows = vectors.reshape(3, trajectories, length) if vectors.shape[1] > 1 else vectors[:, :, None]
        return np.moveaxis(np.broadcast_to(rows, (3, trajectories, length)), 0, -1)


def replay(scene: Scene, waypoints: FloatArray, *, chunk: int | None = None) -> Iterator[Motion]:
    """Pose every waypoint; yield the trajectories in order, a chunk at a time, so that memory stays bounded.

    Args:
        scene: from `load_scene`.
        waypoints: (N, T, J), rad or m, the joints in the order of `scene.joints`. Limits are not enforced.
        chunk: trajectories per Motion; None: as many as make some 16,000 configurations.

    Raises:
        ArgumentError: waypoints have another shape or are not finite, or chunk is below one.
    """
    waypoints = _checked(scene, waypoints)
    if chunk is not None and chunk < 1:
        raise ArgumentError(f"chunk is {chunk}; it must be at least 1, or None.")
    return _chunks(scene, waypoints, chunk or max(1, _CONFIGURATIONS_PER_CHUNK // waypoints.shape[1]))


def body_positions(scene: Scene, waypoints: FloatArray, names: Sequence[str]) -> dict[str, FloatArray]:
    """Origins of bodies or sites in the world frame, (N, T, 3) m for each name.

    Args:
        scene: from `load_scene`.
        waypoints: (N, T, J) rad or m.
        names: bodies or sites.

    Raises:
        ArgumentError: see `replay`.
        SceneError: the scene has no body or site of one of the names.
    """
    for name in names:
        scene.place(name)
    waypoints = _checked(scene, waypoints)
    positions = {name: np.empty((*waypoints.shape[:2], 3)) for name in names}
    for motion in replay(scene, waypoints):
        rows = slice(motion.first, motion.first + len(motion.waypoints))
        for name in names:
            positions[name][rows] = motion.position(name)
    return positions


class Surface:
    """The top of a site of type box, which nothing that moves may go under, within its extent.

    Its top is its face towards its own +z, its extent that of the box in x and y, with the scene at rest.

    Args:
        scene: from `load_scene`.
        name: of the site.

    Raises:
        SceneError: the scene has no such site, or it is not a box.
    """

    def __init__(self, scene: Scene, name: str) -> None:
        site = scene.site_id(name)
        if scene.model.site_type[site] != mujoco.mjtGeom.mjGEOM_BOX:
            raise SceneError(f"site {name!r} of {scene.path} is not a box; its size must give the surface's extent.")
        data = mujoco.MjData(scene.model)
        data.qpos[:] = scene.home
        mujoco.mj_kinematics(scene.model, data)
        self._centre, self._axes = np.array(data.site_xpos[site]), np.array(data.site_xmat[site]).reshape(3, 3)
        self._size, self._bodies = np.array(scene.model.site_size[site]), scene.moving_bodies()
        self._top = self._centre @ self._axes[:, 2] + self._size[2]

    def cleared_by(self, motion: Motion) -> BoolArray:
        """(n,) whether no moving body's origin is ever under the top within the extent."""
        clear = np.ones(len(motion.waypoints), dtype=bool)
        for body in reversed(self._bodies):  # what is carried furthest out dips most often
            carried = motion.scene.chain.bodies[body]
            under = np.flatnonzero(motion.posed.coordinate(carried, self._axes[:, 2]) < self._top)
            under = under[clear[under // motion.waypoints.shape[1]]]
            if not under.size:
                continue
            offset = motion.posed.origin(carried, under) - self._centre[:, None]
            x, y = (np.abs(weighted(offset, axis)) for axis in self._axes[:, :2].T)
            within = (x <= self._size[0]) & (y <= self._size[1])
            clear[under[within] // motion.waypoints.shape[1]] = False
        return clear


def clear_of(scene: Scene, waypoints: FloatArray, surface: str = "table_top") -> BoolArray:
    """Whether each trajectory stays above a surface (see `Surface`).

    Args:
        scene: from `load_scene`.
        waypoints: (N, T, J) rad or m.
        surface: name of its site.

    Returns:
        (N,) true where the trajectory stays clear.

    Raises:
        ArgumentError: see `replay`.
        SceneError: see `Surface`.
    """
    top = Surface(scene, surface)
    clear = [top.cleared_by(motion) for motion in replay(scene, waypoints)]
    return np.concatenate(clear) if clear else np.empty(0, dtype=bool)


def _chunks(scene: Scene, waypoints: FloatArray, chunk: int) -> Iterator[Motion]:
    for first in range(0, len(waypoints), chunk):
        part = waypoints[first : first + chunk]
        yield Motion(scene, first, part, scene.chain.posed(part.reshape(-1, part.shape[2])))


def _checked(scene: Scene, waypoints: FloatArray) -> FloatArray:
    waypoints = np.asarray(waypoints, dtype=np.float64)
    joints = len(scene.joints)
    if waypoints.ndim != 3 or waypoints.shape[2] != joints or waypoints.shape[1] < 1:
        raise ArgumentError(
            f"waypoints have shape {waypoints.shape}; they must be (N, T, {joints}): "
            f"N trajectories, T >= 1 waypoints, the joints {', '.join(scene.joints)}."
        )
    if not np.isfinite(waypoints).all():
        first = int(np.flatnonzero(~np.isfinite(waypoints).all(axis=(1, 2)))[0])
        raise ArgumentError(f"waypoints of trajectory {first} are not all finite; every joint needs a value.")
    waypoints = waypoints.view()
    waypoints.flags.writeable = False
    return waypoints
