"""Whether what an arm moves stays above a surface: its links, the end effector, and all that it carries."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.errors import SceneError
from pipeline.replay.geometry import colour
from pipeline.replay.mechanism.chain import Carried, weighted
from pipeline.replay.outline import Solid, dotted
from pipeline.replay.replay import Motion, replay
from pipeline.replay.scene import Scene

_UNMOVED = np.eye(3, 4)

Sunk = tuple[IndexArray, FloatArray]
"""Rows of configurations, and how far under the surface part of each is, m."""


@dataclass(frozen=True, eq=False)
class _Load:
    """Solids that one joint's frame carries, in that frame.

    Attributes:
        frame: of the joint.
        solids: S of them.
        centres, reaches: (S, 3) and (S,) m of a ball around each.
        ball: centre (3,) and reach m of a ball around them all.
    """

    frame: Carried
    solids: tuple[Solid, ...]
    centres: FloatArray
    reaches: FloatArray
    ball: tuple[FloatArray, float]

    @classmethod
    def of(cls, joint: int, solids: list[Solid]) -> _Load:
        """The load of a joint of the chain."""
        around = [_ball(solid.points, solid.radii) for solid in solids]
        centres, reaches = np.array([centre for centre, _ in around]), np.array([reach for _, reach in around])
        return cls(Carried(joint, _UNMOVED), tuple(solids), centres, reaches, _ball(centres, reaches))


class Surface:
    """The top of a site of type box, which nothing that the joints move may go under, within its extent.

    Its top is its face towards its own +z, its extent that of the box in x and y, with the scene at rest. Of the arm's
    links the origins count. Of the end effector's body and all that it carries, bodies below it and welded to it, the
    solids count too, and the sites by their origins.

    Args:
        scene: from `load_scene`.
        name: of the site.
        yields_m: how far under the top is still allowed.

    Raises:
        SceneError: the scene has no such site, it is not a box, or the joints move it.
    """

    def __init__(self, scene: Scene, name: str, yields_m: float = 0.0) -> None:
        site = scene.site_id(name)
        if scene.model.site_type[site] != mujoco.mjtGeom.mjGEOM_BOX:
            raise SceneError(f"site {name!r} of {scene.path} is not a box; its size must give the surface's extent.")
        if scene.chain.sites[site].joint >= 0:
            raise SceneError(f"site {name!r} of {scene.path} is moved by the joints; a surface must stay where it is.")
        data = scene.at_home()
        self._centre, self._axes = np.array(data.site_xpos[site]), np.array(data.site_xmat[site]).reshape(3, 3)
        self._size = np.array(scene.model.site_size[site])
        self._top = self._centre @ self._axes[:, 2] + self._size[2]
        self._yields, (self._links, self._loads) = yields_m, _links_and_loads(scene)

    def cleared_by(self, motion: Motion) -> BoolArray:
        """(n,) whether nothing is ever under the top within the extent."""
        length, clear = motion.waypoints.shape[1], np.ones(len(motion.waypoints), dtype=bool)
        for rows, depths in self._under(motion, lambda rows: rows[clear[rows // length]]):
            clear[rows[depths > self._yields] // length] = False
        return clear

    def depth(self, motion: Motion) -> FloatArray:
        """(n,) how far under the top, within the extent, anything gets, m; 0 where nothing does."""
        length, found = motion.waypoints.shape[1], np.zeros(len(motion.waypoints))
        for rows, depths in self._under(motion, lambda rows: rows):
            np.maximum.at(found, rows // length, depths)
        return found

    def _under(self, motion: Motion, wanted: Callable[[IndexArray], IndexArray]) -> Iterator[Sunk]:
        """What is under the top within the extent, part by part; those carried furthest out, which dip most, first."""
        for load in self._loads:
            yield from self._load_under(motion, load, wanted)
        for link in self._links:
            heights = motion.posed.coordinate(link, self._axes[:, 2])
            rows = wanted(np.flatnonzero(heights < self._top))
            if rows.size:
                offset = motion.posed.origin(link, rows) - self._centre[:, None]
                within = self._within(np.stack([weighted(offset, axis) for axis in self._axes[:, :2].T]))
                yield rows[within], self._top - heights[rows[within]]

    def _load_under(self, motion: Motion, load: _Load, wanted: Callable[[IndexArray], IndexArray]) -> Iterator[Sunk]:
        shape, normal = (3, motion.waypoints.shape[0] * motion.waypoints.shape[1]), self._axes[:, 2]
        posed = (*motion.posed.axes(load.frame), motion.posed.origin(load.frame))
        frame = [np.broadcast_to(vector, shape) for vector in posed]
        up, height = np.stack([weighted(vector, normal) for vector in frame[:3]]), weighted(frame[3], normal)
        centre, reach = load.ball
        rows = wanted(np.flatnonzero(weighted(up, centre, height) < self._top + reach))
        if not rows.size:
            return
        low = dotted(load.centres, up[:, rows]) + height[rows] < self._top + load.reaches[:, None]
        for number in np.flatnonzero(low.any(axis=1)).tolist():
            solid, some = load.solids[number], wanted(rows[low[number]])
            some = some[height[some] - solid.reach(-up[:, some]) < self._top]
            if some.size:
                yield self._sunk(solid, [vector[:, some] for vector in frame], up[:, some], height[some], some)

    def _sunk(
        self, solid: Solid, frame: list[FloatArray], up: FloatArray, height: FloatArray, rows: IndexArray
    ) -> Sunk:
        """Of configurations that have part of a solid under the top, those that have it there within the extent."""
        depths = self._top - height + solid.radii[:, None] - dotted(solid.points, up)
        offset = frame[3] - self._centre[:, None]
        places = [
            dotted(solid.points, np.stack([weighted(vector, axis) for vector in frame[:3]])) + weighted(offset, axis)
            for axis in self._axes[:, :2].T
        ]
        deepest = np.where(self._within(np.stack(places)), depths, 0.0).max(axis=0)
        return rows[deepest > 0], deepest[deepest > 0]

    def _within(self, places: FloatArray) -> BoolArray:
        """Whether places (2, ...) in the surface's frame are within its extent."""
        return np.asarray((np.abs(places[0]) <= self._size[0]) & (np.abs(places[1]) <= self._size[1]))


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


def carried_bodies(scene: Scene) -> list[int]:
    """Indices of the end effector's body and of all that it carries: bodies below it, and what is welded to them."""
    model = scene.model
    kind, index = scene.place(scene.end_effector)
    found = {index if kind == "body" else int(model.site_bodyid[index])}
    for _ in range(1 + len(scene.rig.attached)):
        welded = {one.root for one in scene.rig.attached if one.carrier in found}
        for body in range(1, model.nbody):  # parents come first
            if int(model.body_parentid[body]) in found or int(model.body_rootid[body]) in welded:
                found.add(body)
    return sorted(found)


@lru_cache(maxsize=8)
def _links_and_loads(scene: Scene) -> tuple[tuple[Carried, ...], tuple[_Load, ...]]:
    """The bodies whose origins count, and the solids of what is carried, by the joint that carries it."""
    carried, links = set(carried_bodies(scene)), []
    solids: dict[int, list[Solid]] = {}
    for body in reversed(scene.moving_bodies().tolist()):
        place = scene.chain.bodies[body]
        if body not in carried:
            links.append(place)
            continue
        for solid in _solids(scene.model, body):
            solids.setdefault(place.joint, []).append(solid.seen_from(place.placement))
    return tuple(links), tuple(_Load.of(joint, solids[joint]) for joint in sorted(solids, reverse=True))


def _ball(points: FloatArray, radii: FloatArray) -> tuple[FloatArray, float]:
    """Centre and reach of a ball around points with radii."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float((np.linalg.norm(points - centre, axis=1) + radii).max())


def _solids(model: Any, body: int) -> list[Solid]:
    """A body's origin, its sites by theirs, and its geoms, but for those that can neither be seen nor touched."""
    origins = [np.zeros(3), *model.site_pos[model.site_bodyid == body]]
    geoms = [
        geom
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist()
        if model.geom_contype[geom] or model.geom_conaffinity[geom] or colour(model, geom)[3] > 0
    ]
    return [*map(Solid.point, origins), *(Solid.of(model, geom) for geom in geoms)]
