"""A picture of a scene, by MuJoCo's rays: no display, no OpenGL, and the same pixels wherever the numbers are the same.

MuJoCo's own renderer needs a driver, and each driver draws otherwise. Here a ray goes through every point of the
picture, and what it meets first is seen there, lit from where the picture is taken and from above.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from pipeline.errors import ArgumentError
from pipeline.replay.geometry import VISIBLE_GROUPS, colour

if TYPE_CHECKING:
    from pipeline.arrays import ByteArray, FloatArray, IntArray
    from pipeline.replay.scene import Scene

_FINER = 2  # rays along each side of a pixel
_ROWS = 64  # of rays at a time
_FROM = (0.5, 1.0, 0.55)  # where a picture is taken from if the scene has no camera that stands still
_ANGLE_DEG = 40.0  # from the lowest to the highest line of such a picture
_FARTHEST_M = 1e6
_MARGIN = 1.08
_WIDEST_RAD = 2.0
_LEAST_LIGHT, _FROM_CAMERA, _FROM_ABOVE = 0.45, 0.3, 0.25
_DARKEST = 0.12  # least of each channel, so that a black arm keeps its shape


@dataclass(frozen=True, eq=False)
class Camera:
    """Where a picture is taken from.

    Attributes:
        position: (3,) m.
        axes: (3, 3) rows to the right, up, and towards the onlooker.
        angle_rad: from the lowest to the highest line of the picture.
    """

    position: FloatArray
    axes: FloatArray
    angle_rad: float


@dataclass(frozen=True, eq=False)
class Picture:
    """What is seen.

    Attributes:
        camera: from where.
        colours: (H, W, 3) red, green and blue; white where there is nothing.
        distances: (H, W) m from the camera to what is seen; infinite where there is nothing.
        bodies: (H, W) index of the body that is seen; -1 where there is nothing.
    """

    camera: Camera
    colours: ByteArray
    distances: FloatArray
    bodies: IntArray

    def places(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where points are in the picture.

        Args:
            points: (..., 3) m.

        Returns:
            (..., 2) pixels to the right and down from the upper left corner, not a number for what is behind the
            camera; and (...,) m of distance.
        """
        height = self.distances.shape[0]
        away = np.asarray(points, dtype=np.float64) - self.camera.position
        right, up, back = np.moveaxis(away @ self.camera.axes.T, -1, 0)
        focal = height / 2 / np.tan(self.camera.angle_rad / 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            across, down = (np.where(back < 0, value / -back, np.nan) for value in (right, -up))
        middle = np.array([self.distances.shape[1], height]) / 2
        return np.stack([across, down], axis=-1) * focal + middle, np.linalg.norm(away, axis=-1)


def named_things(scene: Scene) -> dict[int, str]:
    """Names of what stands in the scene by itself, by index of the body: what the world holds and no joint moves."""
    model = scene.model
    moved = set(scene.moving_bodies().tolist())
    found = {}
    for body in range(1, model.nbody):
        name = model.body(body).name
        if model.body_parentid[body] == 0 and name and not moved & set(np.flatnonzero(scene.bodies_under(name))):
            found[body] = name
    return found


def take_picture(scene: Scene, configuration: FloatArray, seen: FloatArray, width: int, height: int) -> Picture:
    """The scene with its arm in one configuration.

    It is taken from the first camera of the file that stands still, with as wide a view as some points need that are
    in front of it; else from where they are seen.

    Args:
        scene: what is drawn.
        configuration: (J,) rad or m.
        seen: (N, 3) m, points that the picture shows.
        width, height: pixels.

    Raises:
        ArgumentError: the picture has no pixel.
    """
    if width < 1 or height < 1:
        raise ArgumentError(f"a picture needs pixels; got width {width} and height {height}.")
    data = scene.rig.data()
    scene.rig.pose(data, np.asarray(configuration, dtype=np.float64))
    points = np.asarray(seen, dtype=np.float64)
    own = _own_camera(scene.model, data)
    camera = _camera_that_sees(points, width / height) if own is None else _wide_enough(own, points, width / height)
    fine_width, fine_height = _FINER * width, _FINER * height
    colours = np.empty((height, width, 3))
    distances, bodies = np.empty((height, width)), np.empty((height, width), dtype=np.int64)
    for first in range(0, height, _ROWS):
        rows = slice(first, min(first + _ROWS, height))
        fine = np.arange(rows.start * _FINER, rows.stop * _FINER)
        shades, far, body = _look(scene.model, data, camera, fine, fine_width, fine_height)
        blocks = shades.reshape(len(fine) // _FINER, _FINER, width, _FINER, 3)
        colours[rows] = blocks.mean(axis=(1, 3))
        distances[rows], bodies[rows] = far[::_FINER, ::_FINER], body[::_FINER, ::_FINER]
    return Picture(camera, np.rint(255 * colours).astype(np.uint8), distances, bodies)


def _look(
    model: Any, data: Any, camera: Camera, rows: IntArray, width: int, height: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Colours (R, W, 3), distances (R, W) and bodies (R, W) along some lines of a picture."""
    focal = height / 2 / np.tan(camera.angle_rad / 2)
    across = (np.arange(width) + 0.5 - width / 2) / focal
    up = (height / 2 - rows - 0.5) / focal
    rays = np.stack(np.broadcast_arrays(across, up[:, None], -1.0), axis=-1) @ camera.axes
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    count = rays.shape[0] * width
    geoms, far, normals = np.empty(count, dtype=np.int32), np.empty(count), np.empty(3 * count)
    groups = np.array([group < VISIBLE_GROUPS for group in range(mujoco.mjNGROUP)], dtype=np.uint8)
    mujoco.mj_multiRay(
        model, data, camera.position, np.ascontiguousarray(rays).ravel(), groups, True, -1, geoms, far, normals, count,
        _FARTHEST_M,
    )  # fmt: skip
    met = geoms >= 0
    facing = np.where(met[:, None], normals.reshape(-1, 3), 0.0)
    toward = np.abs((facing * rays.reshape(-1, 3)).sum(axis=1))
    light = _LEAST_LIGHT + _FROM_CAMERA * toward + _FROM_ABOVE * np.clip(facing[:, 2], 0.0, 1.0)
    own = np.array([colour(model, geom)[:3] for geom in range(model.ngeom)], dtype=np.float64).reshape(-1, 3)
    shades = np.where(met[:, None], (_DARKEST + (1 - _DARKEST) * own[geoms]) * light[:, None], 1.0)
    shape = rays.shape[:2]
    seen = np.where(met, model.geom_bodyid[geoms], -1).astype(np.int64)
    return shades.reshape(*shape, 3), np.where(met, far, np.inf).reshape(shape), seen.reshape(shape)


def _own_camera(model: Any, data: Any) -> Camera | None:
    for index in range(model.ncam):
        if model.cam_bodyid[index] == 0:
            mujoco.mj_camlight(model, data)
            axes = np.array(data.cam_xmat[index]).reshape(3, 3).T
            return Camera(np.array(data.cam_xpos[index]), axes, float(np.radians(model.cam_fovy[index])))
    return None


def _wide_enough(camera: Camera, points: FloatArray, ratio: float) -> Camera:
    """The camera with so wide a view that points (N, 3) in front of it are in its picture."""
    right, up, back = ((points - camera.position) @ camera.axes.T).T
    front = back < 0
    slopes = np.maximum(np.abs(right[front]) / ratio, np.abs(up[front])) / -back[front]
    needed = 2 * np.arctan(_MARGIN * slopes.max(initial=0.0))
    return replace(camera, angle_rad=max(camera.angle_rad, min(float(needed), _WIDEST_RAD)))


def _camera_that_sees(points: FloatArray, ratio: float) -> Camera:
    """A camera in whose picture, so many times as wide as high, all points (N, 3) are, with a margin."""
    back = np.array(_FROM) / np.linalg.norm(_FROM)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back])
    placed = points @ axes.T
    middle = (placed.max(axis=0) + placed.min(axis=0)) / 2
    slope = np.tan(np.radians(_ANGLE_DEG) / 2)
    away = np.abs(placed[:, :2] - middle[:2]) / (slope * np.array([ratio, 1.0]))
    distance = _MARGIN * float((away.max(axis=1) + placed[:, 2] - middle[2]).max()) + 0.05
    return Camera(middle @ axes + distance * back, axes, float(np.radians(_ANGLE_DEG)))
