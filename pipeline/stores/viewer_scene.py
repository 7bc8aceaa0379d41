"""The scene of an inspection in Rerun's terms: shapes once, bodies over time, paths."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr

from pipeline.stores import palette
from pipeline.stores.viewer_data import TIMELINE
from pipeline.stores.viewer_text import drawable, part

if TYPE_CHECKING:
    from pipeline.replay.geometry import Shape
    from pipeline.stores.viewer_data import Inspection, Replay

_ENDLESS_M = 2.0
_PLANE_HALF_THICKNESS_M = 0.0005
_THIN, _MEDIUM, _THICK, _DOT = (rr.Radius.ui_points(points) for points in (0.6, 1.8, 2.6, 4.0))


def log_scene(recording: rr.RecordingStream, inspection: Inspection) -> None:
    """Log the scene under `/scene`."""
    recording.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    bodies = body_entities(inspection.replay.geometry.body_names)
    for shape in inspection.replay.geometry.shapes:
        recording.log(f"{bodies[shape.body]}/{part(shape.name)}", solid(shape), static=True)
    drawn = {shape.body for shape in inspection.replay.geometry.shapes}
    for body in sorted(drawn):
        _log_body(recording, bodies[body], inspection.replay, body)
    _log_paths(recording, inspection)


def body_entities(names: tuple[str, ...]) -> list[str]:
    """Where each body is logged."""
    return [f"scene/bodies/{part(name)}" for name in names]


def solid(shape: Shape) -> Any:
    """A shape as the Rerun archetype of its kind, in the frame of its body."""
    rotation = rr.Quaternion(xyzw=np.roll(shape.quaternion, -1))
    color = np.rint(255 * shape.rgba).astype(np.uint8)
    at: dict[str, Any] = {"quaternions": [rotation], "colors": [color]}
    filled: dict[str, Any] = {"fill_mode": rr.components.FillMode.Solid}
    size = shape.size
    if shape.kind == "mesh":
        return _mesh(shape, color)
    if shape.kind == "capsule":
        # MuJoCo centres a capsule, Rerun starts it at the lower cap's centre
        foot = shape.position + _rotate(shape.quaternion, np.array([0.0, 0.0, -size[1]]))
        return rr.Capsules3D(lengths=[2 * size[1]], radii=[size[0]], translations=[foot], **at, **filled)
    if shape.kind == "cylinder":
        return rr.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], centers=[shape.position], **at, **filled)
    if shape.kind in ("sphere", "ellipsoid"):
        half = np.full(3, size[0]) if shape.kind == "sphere" else size
        return rr.Ellipsoids3D(half_sizes=[half], centers=[shape.position], **at, **filled)
    half = size
    if shape.kind == "plane":
        at["colors"] = [palette.GROUND]  # thin bright paths would be lost in front of a bright floor
        half = np.append(np.where(size[:2] > 0, size[:2], _ENDLESS_M), _PLANE_HALF_THICKNESS_M)
    return rr.Boxes3D(half_sizes=[half], centers=[shape.position], **at, **filled)


def _mesh(shape: Shape, color: Any) -> rr.Mesh3D:
    vertices = _rotate(shape.quaternion, shape.vertices) + shape.position
    corners = vertices[shape.faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, shape.faces[:, corner], facing)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return rr.Mesh3D(
        vertex_positions=vertices, triangle_indices=shape.faces, vertex_normals=normals, albedo_factor=color
    )


def _rotate(quaternion: Any, points: Any) -> Any:
    w, axis = quaternion[0], quaternion[1:]
    twice = 2.0 * np.cross(axis, points)
    return points + w * twice + np.cross(axis, twice)


def _log_body(recording: rr.RecordingStream, entity: str, replay: Replay, body: int) -> None:
    positions, wxyz = replay.body_positions[:, body], replay.body_quaternions[:, body]
    xyzw = np.roll(wxyz, -1, axis=1)
    if (positions == positions[0]).all() and (wxyz == wxyz[0]).all():
        still = rr.Transform3D(translation=positions[0], quaternion=rr.Quaternion(xyzw=xyzw[0]))
        recording.log(entity, still, static=True)
        return
    recording.send_columns(
        entity,
        indexes=[rr.TimeColumn(TIMELINE, duration=replay.time_s)],
        columns=rr.Transform3D.columns(translation=positions, quaternion=xyzw),
    )


def _log_paths(recording: rr.RecordingStream, inspection: Inspection) -> None:
    weights = inspection.alternative_log_weights
    if weights.size:
        # dense first: the rare ones, which LESS counts most, are drawn last and stay visible
        order = np.argsort(weights, kind="stable")
        colors = palette.path_colors(weights[order], float(weights.min()), float(weights.max()))
        strips = rr.LineStrips3D(list(inspection.alternative_paths[order]), radii=_THIN, colors=colors)
        recording.log("scene/alternatives", strips, static=True)
    demonstrations = inspection.demonstration_paths
    recording.log(
        "scene/demonstrations",
        rr.LineStrips3D(list(demonstrations), radii=_MEDIUM, colors=palette.DEMONSTRATION),
        static=True,
    )
    for start_s, name, path in zip(inspection.start_s, inspection.demonstration_ids, demonstrations, strict=True):
        recording.set_time(TIMELINE, duration=start_s)
        recording.log("scene/playing", rr.LineStrips3D([path], radii=_THICK, colors=palette.WHITE))
        named = rr.Points3D(path[-1:], radii=_DOT, colors=palette.WHITE, labels=[drawable(name)], show_labels=True)
        recording.log("scene/playing/end", named)
    recording.reset_time()
