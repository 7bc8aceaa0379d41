"""Motions of an arm as flat polygons, which a page draws frame by frame: no picture is rendered, nothing is fetched.

Each shape of the scene is seen from a fixed point as the outline of its corners, which is exact for the convex shapes
that MuJoCo has and the convex hull of a mesh. Far ones are drawn first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from pipeline.replay.geometry import body_poses, extract_geometry
from pipeline.replay.replay import replay

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pipeline.arrays import BoolArray, FloatArray
    from pipeline.replay.geometry import Shape
    from pipeline.replay.scene import Scene

WIDTH, HEIGHT = 480, 360
SECONDS = 4.0  # that a motion takes in the page, whatever it took
MOST_FRAMES = 60
_AROUND = 12  # corners of a round outline
_ENDLESS_M = 1.5
_DARKEST = 0.25
_NEAR = 0.1  # of the reach of the motion


def clips(scene: Scene, trajectories: Mapping[str, FloatArray]) -> dict[str, dict[str, object]]:
    """The drawings of some trajectories (T, J) of a task, all seen from the same point, by name."""
    geometry = extract_geometry(scene.model)
    solids = [_Solid(shape) for shape in geometry.shapes]
    thinned = {name: _thinned(waypoints) for name, waypoints in trajectories.items()}
    poses = {name: body_poses(scene, waypoints) for name, waypoints in thinned.items()}
    moves = _moving(list(poses.values()))
    moving = [index for index, solid in enumerate(solids) if moves[solid.body]]
    still = [index for index, solid in enumerate(solids) if not moves[solid.body]]
    view = _View(_seen(solids, moves, list(poses.values())), geometry.viewpoint)
    colours = [_shown(shape) for shape in geometry.shapes]

    def outlines(rows: list[int], positions: FloatArray, quaternions: FloatArray) -> list[object]:
        return view.outlines([(row, solids[row].at(positions, quaternions)) for row in rows])

    drawn: dict[str, dict[str, object]] = {}
    for name, (positions, quaternions) in poses.items():
        path = next(iter(replay(scene, thinned[name][None]))).end_effector[0]
        drawn[name] = {
            "width": WIDTH,
            "height": HEIGHT,
            "seconds": SECONDS,
            "colours": colours,
            "still": outlines(still, positions[0], quaternions[0]),
            "frames": [outlines(moving, *pose) for pose in zip(positions, quaternions, strict=True)],
            "path": _rounded(view.flat(path)[0]),
        }
    return drawn


def _moving(poses: list[tuple[FloatArray, FloatArray]]) -> BoolArray:
    """(B,) whether a body is somewhere else at some time in some motion."""
    positions, quaternions = (np.concatenate([pose[part] for pose in poses]) for part in (0, 1))
    found: BoolArray = (positions != positions[0]).any(axis=(0, 2)) | (quaternions != quaternions[0]).any(axis=(0, 2))
    return found


def _seen(solids: list[_Solid], moves: BoolArray, poses: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """(N, 3) points that the picture holds: all that moves, and what stands near it and is no larger.

    So an arm on a large table fills the picture, and the table may be cut off.
    """
    positions, quaternions = poses[0]
    still = [solid.at(positions[0], quaternions[0]) for solid in solids if not moves[solid.body]]
    rows = [
        solid.at(places[row], turns[row])
        for places, turns in poses
        for row in {0, len(places) // 4, len(places) // 2, 3 * len(places) // 4, len(places) - 1}
        for solid in solids
        if moves[solid.body]
    ]
    if not rows:
        return np.concatenate(still)
    moved = np.concatenate(rows)
    low, high = moved.min(axis=0), moved.max(axis=0)
    reach = (high - low).max()

    def belongs(points: FloatArray) -> bool:
        middle = (points.max(axis=0) + points.min(axis=0)) / 2
        near = (middle >= low - _NEAR * reach).all() and (middle <= high + _NEAR * reach).all()
        return bool(near and np.ptp(points, axis=0).max() <= reach)

    return np.concatenate([moved, *filter(belongs, still)])


class _View:
    """A camera that sees all of some points."""

    def __init__(self, points: FloatArray, viewpoint: FloatArray | None) -> None:
        centre = (points.max(axis=0) + points.min(axis=0)) / 2
        self.toward = (viewpoint - centre) if viewpoint is not None else np.array([1.2, -1.5, 1.0])
        self.toward = self.toward / np.linalg.norm(self.toward)
        right = np.cross([0.0, 0.0, 1.0], self.toward)
        right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
        self.axes = np.stack([right, -np.cross(self.toward, right)])
        flat = points @ self.axes.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        self.scale = min(0.92 * WIDTH / (high[0] - low[0]), 0.92 * HEIGHT / (high[1] - low[1]))
        self.middle = (low + high) / 2

    def flat(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) places on the page and (N,) nearness of points (N, 3)."""
        places = (points @ self.axes.T - self.middle) * self.scale + np.array([WIDTH, HEIGHT]) / 2
        return places, points @ self.toward

    def outlines(self, solids: list[tuple[int, FloatArray]]) -> list[object]:
        """Index and flat polygon of each solid, the far ones first."""
        found = []
        for index, points in solids:
            places, nearness = self.flat(points)
            try:
                polygon = places[ConvexHull(places).vertices]
            except QhullError:  # seen edge on
                continue
            found.append((float(nearness.mean()), index, _rounded(polygon)))
        return [[index, polygon] for _, index, polygon in sorted(found)]


def _rounded(places: FloatArray) -> list[float]:
    return [round(float(value), 1) for value in places.ravel()]


def _thinned(waypoints: FloatArray) -> FloatArray:
    if len(waypoints) <= MOST_FRAMES:
        return waypoints
    kept: FloatArray = waypoints[np.linspace(0, len(waypoints) - 1, MOST_FRAMES).round().astype(int)]
    return kept


class _Solid:
    """A shape as points whose hull is what is seen of it."""

    def __init__(self, shape: Shape) -> None:
        self.kind, self.body = shape.kind, shape.body
        self.corners: FloatArray = _corners(shape) @ _rotation(shape.quaternion).T + shape.position

    def at(self, positions: FloatArray, quaternions: FloatArray) -> FloatArray:
        """(N, 3) in the world's frame, where bodies are at positions (B, 3) and quaternions (B, 4)."""
        placed: FloatArray = self.corners @ _rotation(quaternions[self.body]).T + positions[self.body]
        return placed


def _rotation(quaternion: FloatArray) -> FloatArray:
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _corners(shape: Shape) -> FloatArray:
    """Points of a shape, in its frame, whose hull is what is seen of it."""
    size, ball = shape.size, _ball()
    along = np.array([0.0, 0.0, size[1]])
    angles = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1) * size[0]
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    endless = np.where(size > 0, size, _ENDLESS_M) * np.array([1.0, 1.0, 0.0])
    forms: dict[str, FloatArray] = {
        "box": signs * size,
        "plane": signs[::2] * endless,
        "sphere": ball * size[0],
        "ellipsoid": ball * size,
        "capsule": np.concatenate([ball * size[0] + along, ball * size[0] - along]),
        "cylinder": np.concatenate([circle + along, circle - along]),
    }
    return _hull(shape.vertices) if shape.kind == "mesh" else forms[shape.kind]


def _hull(points: FloatArray) -> FloatArray:
    try:
        corners: FloatArray = points[ConvexHull(points).vertices]
    except QhullError:  # a flat mesh
        return points
    return corners


def _ball() -> FloatArray:
    around = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    up = np.linspace(-np.pi / 2, np.pi / 2, _AROUND // 2 + 1)
    return np.array([[np.cos(a) * np.cos(u), np.sin(a) * np.cos(u), np.sin(u)] for a in around for u in up])


def _shown(shape: Shape) -> str:
    red, green, blue = (int(255 * (_DARKEST + (1 - _DARKEST) * float(part))) for part in shape.rgba[:3])
    return f"rgba({red},{green},{blue},{float(shape.rgba[3]):.2f})"
