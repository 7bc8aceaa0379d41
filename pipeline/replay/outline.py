"""Points that stand for solids: whatever is above a plane with all of them is above it as a whole.

A solid becomes points with a radius each, in its body's frame, that no part of it reaches beyond by more than rounding;
they reach beyond it by at most some 3 % of its size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from math import ceil, cos, pi, sqrt
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import FloatArray

_SPACING_M = 0.05  # along edges: a long solid may lie across the edge of a table
_AROUND = 16  # points on a rim
_ROUND = 100  # points on an ellipsoid
_ROUND_ANGLE = 0.23  # rad, from any direction to the nearest of them
_MESH_DIRECTIONS = 400  # in which a mesh keeps its outermost vertex


def dotted(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """(S, 3) times (3, m). Not by BLAS, whose threads cost more than such small products, many at once, can gain."""
    return np.asarray(np.einsum("sk,km->sm", rows, columns))


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid in the frame of what carries it.

    Attributes:
        points, radii: (P, 3) and (P,) m: points with a radius each, which no part of it reaches beyond.
        centre, axes: (3,) m and (3, 3), the columns its own x, y and z.
        kind, size: MuJoCo's type of the geom and its size (3,) m; None where the points are all there is.
    """

    points: FloatArray
    radii: FloatArray
    centre: FloatArray
    axes: FloatArray
    kind: int | None
    size: FloatArray

    @classmethod
    def point(cls, place: FloatArray) -> Solid:
        """A solid without extent."""
        return cls(place[None], np.zeros(1), place, np.eye(3), None, np.zeros(3))

    @classmethod
    def of(cls, model: Any, geom: int) -> Solid:
        """A geom, in the frame of its body."""
        points, radius = _outline(model, geom)
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
        axes, centre = turned.reshape(3, 3), np.array(model.geom_pos[geom])
        kind = int(model.geom_type[geom])
        return cls(
            points @ axes.T + centre, np.full(len(points), radius), centre, axes,
            kind if kind in _REACHES else None, np.array(model.geom_size[geom]),
        )  # fmt: skip

    def seen_from(self, place: FloatArray) -> Solid:
        """The same in an outer frame, in which `place` (3, 4) has the present one's axes and origin."""
        turn, shift = place[:, :3], place[:, 3]
        return replace(
            self, points=self.points @ turn.T + shift, centre=turn @ self.centre + shift, axes=turn @ self.axes
        )

    def reach(self, directions: FloatArray) -> FloatArray:
        """(m,) m, how far it reaches from the frame's origin along unit vectors (3, m); exact except for meshes."""
        if self.kind is None:
            return np.asarray((dotted(self.points, directions) + self.radii[:, None]).max(axis=0))
        return np.asarray(
            dotted(self.centre[None], directions)[0] + _REACHES[self.kind](dotted(self.axes.T, directions), self.size)
        )


_TYPES = mujoco.mjtGeom
_REACHES: dict[int, Callable[[FloatArray, FloatArray], FloatArray]] = {
    int(_TYPES.mjGEOM_SPHERE): lambda along, size: size[0],
    int(_TYPES.mjGEOM_CAPSULE): lambda along, size: size[0] + size[1] * np.abs(along[2]),
    int(_TYPES.mjGEOM_CYLINDER): lambda along, size: (
        size[0] * np.hypot(along[0], along[1]) + size[1] * np.abs(along[2])
    ),
    int(_TYPES.mjGEOM_BOX): lambda along, size: dotted(size[None], np.abs(along))[0],
    int(_TYPES.mjGEOM_ELLIPSOID): lambda along, size: np.sqrt(dotted(size[None] ** 2, along**2)[0]),
}  # fmt: skip


def _outline(model: Any, geom: int) -> tuple[FloatArray, float]:
    """Points (P, 3) in a geom's own frame and the radius of each, which no part of it reaches beyond."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == _TYPES.mjGEOM_SPHERE:
        return np.zeros((1, 3)), float(size[0])
    if kind == _TYPES.mjGEOM_CAPSULE:
        return _along(size[1])[:, None] * [0.0, 0.0, 1.0], float(size[0])
    if kind == _TYPES.mjGEOM_CYLINDER:
        return _cylinder(size[0], size[1]), 0.0
    if kind == _TYPES.mjGEOM_ELLIPSOID:
        return _directions(_ROUND) * size / cos(_ROUND_ANGLE), 0.0
    if kind == _TYPES.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom]))
    if kind == _TYPES.mjGEOM_BOX:
        return _box(size), 0.0
    return _box(model.geom_aabb[geom, 3:]) + model.geom_aabb[geom, :3], 0.0  # the box around anything else


def _along(half: float) -> FloatArray:
    return np.linspace(-half, half, max(2, ceil(2 * half / _SPACING_M) + 1))


def _cylinder(radius: float, half: float) -> FloatArray:
    angles = 2 * pi * np.arange(_AROUND) / _AROUND
    rim = radius / cos(pi / _AROUND) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.array([[x, y, z] for z in _along(half) for x, y in rim])


def _box(half: FloatArray) -> FloatArray:
    """The twelve edges."""
    places = [_along(length) for length in half]
    corners = [(-length, length) for length in half]
    edges = [product(*(places[k] if k == axis else corners[k] for k in range(3))) for axis in range(3)]
    return np.unique([point for edge in edges for point in edge], axis=0)


def _directions(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread evenly, by the golden angle."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = pi * (3 - sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _mesh(model: Any, mesh: int) -> tuple[FloatArray, float]:
    """The outermost vertices, and how far the others may be beyond what they span."""
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
    kept = vertices[np.unique((vertices @ _directions(_MESH_DIRECTIONS).T).argmax(axis=0))]
    between = _directions(4 * _MESH_DIRECTIONS).T
    return kept, float(((vertices @ between).max(axis=0) - (kept @ between).max(axis=0)).max())
