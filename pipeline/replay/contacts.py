"""Whether an arm touches itself or its surroundings on its way, by MuJoCo's own contacts, meshes included.

Which geoms may touch is what the scene says: `contype` and `conaffinity`, `exclude`, and MuJoCo's rule that a body does
not touch its parent. Of what touches, only that counts whose distance the joints can change.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.errors import SceneError
from pipeline.replay.geometry import is_drawn
from pipeline.replay.scene import Scene

STEP = 0.05  # rad or m: how far a joint may go between two poses that are looked at
Pair = tuple[int, int]
"""Indices of two geoms, the smaller first."""


@dataclass(frozen=True, eq=False)
class Touches:
    """What touches what at M configurations: K contacts.

    Attributes:
        configuration: (K,) at which of them.
        bodies: (K, 2) indices of the two bodies; a contact counts for the bodies of its geoms, what has none is of the
            world.
        depth: (K,) how deep they are in each other, m.
    """

    configuration: IndexArray
    bodies: IndexArray
    depth: FloatArray

    def between(self, some: BoolArray, others: BoolArray) -> IndexArray:
        """The configurations, each once, at which one of some bodies (nbody,) touches one of others (nbody,)."""
        first, second = self.bodies.T
        counted = (some[first] & others[second]) | (some[second] & others[first])
        return np.unique(self.configuration[counted])


class Contacts:
    """What the joints of a scene may not bring into contact.

    Args:
        scene: from `load_scene`.
        allowed: how deep pairs of geoms may be in each other, m; negative is how near they may be to each other.
        clearance_m: how near what moves must not come to what stays.
        remedy: what else to do where nothing can touch, for the sentence that says so.

    Raises:
        SceneError: nothing that the joints move can touch anything.
    """

    def __init__(
        self,
        scene: Scene,
        allowed: Mapping[Pair, float] | None = None,
        *,
        clearance_m: float = 0.0,
        remedy: str = "set the task's collisions to false",
    ) -> None:
        self.scene = _noticing(scene, clearance_m) if clearance_m else scene
        self._allowed, self._clearance = dict(allowed or {}), clearance_m
        self._carrier = np.append(scene.rig.carrier[scene.model.geom_bodyid], -1)  # no geom, as a flex has, stays
        if not self._anything_can_touch():
            raise SceneError(
                f"{scene.path}: nothing that the joints move can touch anything, as no geom's contype meets another's "
                f"conaffinity or contacts are disabled; give the arm geoms that collide, or {remedy}."
            )

    def free(self, waypoints: FloatArray) -> BoolArray:
        """(N, T, J) -> (N,): whether each trajectory is free of contacts, at its waypoints and between them.

        Between waypoints the joints go straight; there too they are looked at every `STEP`.
        """
        data = self.scene.rig.data()
        return np.array([self._is_free(data, trajectory) for trajectory in waypoints], dtype=bool)

    def depths(self, configuration: FloatArray) -> dict[Pair, float]:
        """The pairs of geoms that are in each other at a configuration (J,), and how deep, m.

        Those that are not, but nearer than the clearance, are among them; their depth is negative.
        """
        data, found = self.scene.rig.data(), dict[Pair, float]()
        for first, second, depth in self._touching(data, configuration):
            pair = (min(first, second), max(first, second))
            found[pair] = max(depth, found.get(pair, depth))
        return found

    def touches(self, configurations: FloatArray) -> Touches:
        """What touches what at each of M configurations (M, J), and nowhere between them."""
        data = self.scene.rig.data()
        bodies_of_geoms = np.append(self.scene.model.geom_bodyid, 0)
        found = [
            (number, first, second, depth)
            for number, configuration in enumerate(configurations)
            for first, second, depth in self._touching(data, configuration)
        ]
        numbers = np.array([row[:3] for row in found], dtype=np.intp).reshape(-1, 3)
        depths = np.array([row[3] for row in found], dtype=np.float64)
        return Touches(numbers[:, 0], bodies_of_geoms[numbers[:, 1:]].astype(np.intp), depths)

    def named(self, pair: Pair) -> str:
        """The bodies of two geoms, for a sentence."""
        model = self.scene.model
        first, second = (model.body(int(model.geom_bodyid[geom])).name or "world" for geom in pair)
        return f"{first!r} and {second!r}"

    def _is_free(self, data: Any, trajectory: FloatArray) -> bool:
        return not any(
            depth > self._allowed.get((min(first, second), max(first, second)), -np.inf)
            for configuration in spread_first(between(trajectory, STEP))
            for first, second, depth in self._touching(data, configuration)
        )

    def _touching(self, data: Any, configuration: FloatArray) -> Iterator[tuple[int, int, float]]:
        self.scene.rig.pose(data, configuration)
        mujoco.mj_collision(self.scene.model, data)
        if data.ncon:
            geoms, distances = data.contact.geom, data.contact.dist
            carriers = self._carrier[geoms]
            near = np.where((carriers < 0).any(axis=1), self._clearance, 0.0)
            counted = (distances < near) & (carriers[:, 0] != carriers[:, 1])
            for (first, second), distance in zip(geoms[counted].tolist(), distances[counted].tolist(), strict=True):
                yield first, second, -distance

    def _anything_can_touch(self) -> bool:
        model = self.scene.model
        if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
            return False
        if any(self._carrier[model.pair_geom1] != self._carrier[model.pair_geom2]):
            return True
        able = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
        carrier = self._carrier[:-1]
        return bool(((able | able.T) & (carrier[:, None] != carrier)).any())


def with_drawn_solids(scene: Scene) -> Scene:
    """The scene as if all solids that are drawn could touch: those that the joints move, and those that stay.

    It is for scenes whose geoms are there to be looked at and can touch nothing. Solids that move do not touch each
    other, as the shapes of links often overlap at joints.
    """
    model = copy.copy(scene.model)
    drawn = np.array([is_drawn(model, geom) for geom in range(model.ngeom)], dtype=bool)
    moved = scene.rig.carrier[model.geom_bodyid] >= 0
    model.geom_contype[:], model.geom_conaffinity[:] = drawn & moved, drawn & ~moved
    for of_bodies, of_geoms in (
        (model.body_contype, model.geom_contype), (model.body_conaffinity, model.geom_conaffinity),
    ):  # fmt: skip
        of_bodies[:] = 0
        np.bitwise_or.at(of_bodies, model.geom_bodyid, of_geoms)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return _with(scene, model)


def _noticing(scene: Scene, distance_m: float) -> Scene:
    """The scene with contacts between solids that are nearer to each other than this, whatever margins it states."""
    model = copy.copy(scene.model)
    model.geom_margin[:], model.body_margin[:] = distance_m, distance_m
    if model.npair:
        model.pair_margin[:] = distance_m
    return _with(scene, model)


def _with(scene: Scene, model: Any) -> Scene:
    """The scene with a changed model; the trees of the middle phase were made for the model as it was."""
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    return replace(scene, model=model, rig=replace(scene.rig, model=model))


def between(trajectory: FloatArray, step: float) -> FloatArray:
    """The waypoints (T, J), with as many poses between two of them as keep each joint's steps to `step`."""
    steps = np.abs(np.diff(trajectory, axis=0)).max(axis=1)
    counts = np.maximum(1, np.ceil(steps / step - 1e-9)).astype(int)
    parts = [
        start + (stop - start) * (np.arange(count) / count)[:, None]
        for start, stop, count in zip(trajectory[:-1], trajectory[1:], counts, strict=True)
    ]
    return np.concatenate([*parts, trajectory[-1:]])


def spread_first(poses: FloatArray) -> Iterator[FloatArray]:
    """All poses (M, J), coarsely over the whole way first: a contact lasts, so that it is soon met."""
    stride = 1 << max(0, int(len(poses) - 1).bit_length() - 1)
    yield poses[0]
    while stride:
        for place in range(stride, len(poses), 2 * stride):
            yield poses[place]
        stride //= 2
