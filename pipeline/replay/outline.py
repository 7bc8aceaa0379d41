"""Points that stand for solids: whatever is above a plane with all of them is above it as a whole.

A solid becomes points with a radius each, in its body's frame, that no part of it reaches beyond by more than rounding;
they reach beyond it by at most some 3 % of its size.
"""

from __future__ import annotations

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

Outline = tuple[FloatArray, FloatArray]
"""Points (P, 3) m and radii (P,) m."""


def outline(model: Any, geom: int) -> Outline:
    """Points that stand for a geom, in the frame of its body."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    types = mujoco.mjtGeom
    if kind == types.mjGEOM_SPHERE:
        points, radius = np.zeros((1, 3)), size[0]
    elif kind == types.mjGEOM_CAPSULE:
        points, radius = _along(size[1])[:, None] * [0.0, 0.0, 1.0], size[0]
    elif kind == types.mjGEOM_CYLINDER:
        points, radius = _cylinder(size[0], size[1]), 0.0
    elif kind == types.mjGEOM_ELLIPSOID:
        points, radius = _directions(_ROUND) * size / cos(_ROUND_ANGLE), 0.0
    elif kind == types.mjGEOM_MESH:
        points, radius = _mesh(model, int(model.geom_dataid[geom]))
    else:  # a box, or what is drawn and collides as something else within one
        half = size if kind == types.mjGEOM_BOX else model.geom_aabb[geom, 3:]
        centre = 0.0 if kind == types.mjGEOM_BOX else model.geom_aabb[geom, :3]
        points, radius = _box(half) + centre, 0.0
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
    return points @ turned.reshape(3, 3).T + model.geom_pos[geom], np.full(len(points), radius)


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
