"""Kinematic replay: every waypoint of every trajectory is posed in the scene, a chunk of trajectories at a time.

The result does not depend on how the trajectories are cut into chunks, to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import ArgumentError
from pipeline.replay.contacts import Contacts, Touches
from pipeline.replay.mechanism.chain import Posed
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

    def axes(self, name: str) -> FloatArray:
        """Orientation of a body or site in the world frame, as `rotation` gives that of a body.

        Raises:
            SceneError: the scene has no body or site of that name.
        """
        return np.stack([self._shaped(axis) for axis in self.posed.axes(self.scene.carried(name))], axis=-1)

    @property
    def time(self) -> FloatArray:
        """When each waypoint is passed, (T,): 0 at the first and 1 at the last, evenly spaced.

        Alternatives are paths without a duration, so the duration of a motion is the unit of time here.
        """
        return np.linspace(0.0, 1.0, self.waypoints.shape[1])

    @property
    def joint_velocities(self) -> FloatArray:
        """(n, T, J) rad or m in the time of the motion, by central differences, one-sided at the ends.

        Raises:
            ArgumentError: there is a single waypoint.
        """
        return self._rate(self.waypoints)

    def velocity(self, name: str) -> FloatArray:
        """Velocity of the origin of a body or site, (n, T, 3) m in the time of the motion, as in `joint_velocities`.

        Raises:
            ArgumentError: there is a single waypoint.
            SceneError: the scene has no body or site of that name.
        """
        return self._rate(self.position(name))

    def jacobian(self, name: str) -> FloatArray:
        """How the origin of a body or site moves with the joints, (n, T, 3, J) m per rad or m.

        Raises:
            SceneError: the scene has no body or site of that name.
        """
        n, length, joints = self.waypoints.shape
        every = np.moveaxis(self.posed.jacobian(self.scene.carried(name)), -1, 0)
        followed = every @ self.scene.rig.expansion(self.waypoints.reshape(-1, joints))
        return followed.reshape(n, length, 3, joints)

    def _rate(self, values: FloatArray) -> FloatArray:
        if values.shape[1] < 2:
            raise ArgumentError("a velocity needs at least 2 waypoints; give ingest.waypoints of 3 or more.")
        return np.asarray(np.gradient(values, self.time, axis=1))

    @cached_property
    def contacts(self) -> Touches:
        """What touches what at the waypoints, by MuJoCo's own contacts: found when first asked for, which is slow.

        Raises:
            SceneError: nothing that the joints move can touch anything.
        """
        n, length, joints = self.waypoints.shape
        remedy = "leave features of contacts out"
        return Contacts(self.scene, remedy=remedy).touches(self.waypoints.reshape(n * length, joints))

    def touching(self, one: str = "", other: str = "") -> BoolArray:
        """Where two bodies, each with its children in the scene, touch, (n, T).

        A contact counts if its distance is one that the joints can change, so that neither what lies on a table nor
        what the hand holds touches.

        Args:
            one, other: names of bodies; nothing for any body, of which one is moved by the joints in any case.

        Raises:
            SceneError: nothing that the joints move can touch anything, or the scene has no body of such a name.
        """
        found = np.zeros(self.waypoints.shape[:2], dtype=bool)
        found.flat[self.contacts.between(self.scene.bodies_under(one), self.scene.bodies_under(other))] = True
        return found

    def looked_at(self, of: str = "") -> FloatArray:
        """Origin of a body or site, or of the scene's end effector if there is no name, (n, T, 3) m, read-only.

        Raises:
            SceneError: the scene has no body or site of that name.
        """
        return self.position(of or self.scene.end_effector)

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
