"""Kinematic replay: every waypoint of every trajectory is posed in the scene, in batches, on all cores.

The result does not depend on the number of threads or on how the trajectories are cut into chunks, to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from pipeline.errors import ArgumentError, SceneError
from pipeline.replay.scene import Scene

Array = NDArray[np.float64]

_CONFIGURATIONS_PER_CHUNK = 8192
_CONFIGURATIONS_PER_THREAD = 256  # fewer are not worth waking a thread for


@dataclass(frozen=True, eq=False)
class Motion:
    """Where everything is while n trajectories of T waypoints are replayed.

    Attributes:
        scene: the scene replayed in.
        first: index of the first of these trajectories among those given to `replay`.
        waypoints: (n, T, J) rad or m.
    """

    scene: Scene
    first: int
    waypoints: Array
    _body_positions: Array = field(repr=False)
    _body_quaternions: Array = field(repr=False)
    _site_positions: Array = field(repr=False)

    def position(self, name: str) -> Array:
        """Origin of a body or site in the world frame, (n, T, 3) m.

        Raises:
            SceneError: the scene has no body or site of that name.
        """
        kind, index = self.scene.place(name)
        positions = self._body_positions if kind == "body" else self._site_positions
        return positions[:, :, index]

    def quaternion(self, body: str) -> Array:
        """Orientation of a body in the world frame, (n, T, 4) wxyz.

        Raises:
            SceneError: the scene has no body of that name.
        """
        return self._body_quaternions[:, :, self.scene.body_id(body)]

    @property
    def end_effector(self) -> Array:
        """Origin of the scene's end effector in the world frame, (n, T, 3) m."""
        return self.position(self.scene.end_effector)


def replay(scene: Scene, waypoints: Array, *, chunk: int | None = None, threads: int | None = None) -> Iterator[Motion]:
    """Pose every waypoint; yield the trajectories in order, a chunk at a time, so that memory stays bounded.

    Args:
        scene: from `load_scene`.
        waypoints: (N, T, J), rad or m, the joints in the order of `scene.joints`. Limits are not enforced.
        chunk: trajectories per Motion; None: as many as make some 8,000 configurations.
        threads: None: one per CPU.

    Raises:
        ArgumentError: waypoints have another shape or are not finite, or chunk or threads is below one.
    """
    waypoints = _checked(scene, waypoints)
    trajectories, length, _ = waypoints.shape
    for name, value in (("chunk", chunk), ("threads", threads)):
        if value is not None and value < 1:
            raise ArgumentError(f"{name} is {value}; it must be at least 1, or None.")
    most = chunk or max(1, _CONFIGURATIONS_PER_CHUNK // length)
    # of even size: a batch poses all its states, used or not
    even = -(-trajectories // max(1, -(-trajectories // most)))
    return _chunks(scene, waypoints, even, threads)


def body_positions(scene: Scene, waypoints: Array, names: Sequence[str]) -> dict[str, Array]:
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

    def cleared_by(self, motion: Motion) -> NDArray[np.bool_]:
        """(n,) whether no moving body's origin is ever under the top within the extent."""
        local = (motion._body_positions[:, :, self._bodies] - self._centre) @ self._axes
        under = (local[..., 2] < self._size[2]) & (np.abs(local[..., :2]) <= self._size[:2]).all(axis=-1)
        return np.asarray(~under.any(axis=(1, 2)))


def clear_of(scene: Scene, waypoints: Array, surface: str = "table_top") -> NDArray[np.bool_]:
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


def _chunks(scene: Scene, waypoints: Array, chunk: int, threads: int | None) -> Iterator[Motion]:
    trajectories, length, joints = waypoints.shape
    if trajectories == 0:
        return
    simulations = chunk * length
    batch = Batch(scene.skeleton, nsim=simulations, nthread=_threads(simulations, threads))
    outputs = [batch.bind(name) for name in ("xpos", "xquat", "site_xpos")]
    qpos = batch.bind("qpos")
    qpos[:] = scene.home
    for first in range(0, trajectories, chunk):
        part = waypoints[first : first + chunk]
        rows = len(part) * length
        qpos[:rows, scene.qpos_addresses] = part.reshape(rows, joints)
        batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_POS.value))
        # copies, because the next chunk overwrites the batch
        yield Motion(
            scene,
            first,
            part,
            *(_frozen(output[:rows].reshape(len(part), length, *output.shape[1:])) for output in outputs),
        )


def _threads(configurations: int, threads: int | None) -> int:
    """0 stands for one per CPU."""
    if threads is not None:
        return threads
    return 1 if configurations < 2 * _CONFIGURATIONS_PER_THREAD else 0


def _checked(scene: Scene, waypoints: Array) -> Array:
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


def _frozen(values: Array) -> Array:
    copy = np.array(values)
    copy.flags.writeable = False
    return copy
