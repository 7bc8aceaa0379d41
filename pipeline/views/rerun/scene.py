"""Logs the scene of an inspection to Rerun: the shapes, the bodies over time, and the paths."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr

from pipeline.views import palette
from pipeline.views.rerun.labels import drawable, part
from pipeline.views.rerun.timelines import TIMELINE, at, columns

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray, IntArray
    from pipeline.replay.geometry import Geometry, Shape
    from pipeline.views.rerun.records import AlternativeSet, Inspection, Predicted, Replay

_ENDLESS_M = 2.0  # half size with which an infinite plane is drawn
_DARKEST = 0.3  # least value of each colour channel: a black arm would look like a hole in a dark room
_PLANE_HALF_THICKNESS_M = 0.0005
_HAIR, _THIN, DEMONSTRATED, _THICK, _DOT = (rr.Radius.ui_points(points) for points in (0.3, 0.4, 1.2, 2.6, 4.0))
_LABEL_LIFT = 0.22  # of the diagonal of all paths
_BOX_EVERY = 4  # waypoints
PREDICTED = "scene/predicted"  # entity under which predictions are logged


def log_scene(recording: rr.RecordingStream, inspection: Inspection) -> None:
    """Log the scene under `/scene`."""
    replay = inspection.replay
    log_shapes(recording, replay.geometry)
    steps = replay.demonstration + 1
    steps[0] = 0  # where the arm is before any demonstration
    log_bodies(recording, replay, moving_bodies(replay), steps)
    for alternatives in inspection.alternatives:
        log_alternatives(recording, alternatives)
    for model, predicted in inspection.predicted.items():
        log_predicted(recording, model, predicted)
    paths = inspection.demonstration_paths
    shown = rr.LineStrips3D(list(paths), radii=DEMONSTRATED, colors=palette.DEMONSTRATION)
    recording.log("scene/demonstrations", shown, static=True)
    for row, (start_s, end_s, name, path) in enumerate(
        zip(inspection.start_s, inspection.end_s, inspection.demonstration_ids, paths, strict=True)
    ):
        log_playing(recording, name, path, np.linspace(start_s, end_s, len(path)), row + 1, label_lift(paths))


def log_shapes(recording: rr.RecordingStream, geometry: Geometry) -> None:
    """Log every shape once, in the frame of its body."""
    recording.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    bodies = body_entities(geometry.body_names)
    for shape in geometry.shapes:
        recording.log(f"{bodies[shape.body]}/{part(shape.name)}", solid(shape), static=True)


def moving_bodies(replay: Replay) -> frozenset[int]:
    """Indices of the bodies that move during the replay."""
    positions, quaternions = replay.body_positions, replay.body_quaternions
    moved = (positions != positions[0]).any(axis=(0, 2)) | (quaternions != quaternions[0]).any(axis=(0, 2))
    return frozenset(np.flatnonzero(moved).tolist())


def log_bodies(
    recording: rr.RecordingStream, replay: Replay, moving: frozenset[int], steps: IntArray | int | None = None
) -> None:
    """Log the pose of each body that has a shape: over time if it moves, else once.

    Args:
        recording: the recording that is logged to.
        replay: the poses.
        moving: indices of the bodies that move.
        steps: (M,) how many demonstrations have come in, or one number for all; by default the clock alone is used.
    """
    clock = rr.TimeColumn(TIMELINE, duration=replay.time_s)
    times = [clock] if steps is None else columns(replay.time_s, steps)
    bodies = body_entities(replay.geometry.body_names)
    for body in sorted({shape.body for shape in replay.geometry.shapes}):
        positions, xyzw = replay.body_positions[:, body], np.roll(replay.body_quaternions[:, body], -1, axis=1)
        if body in moving:
            recording.send_columns(
                bodies[body],
                indexes=times,
                columns=rr.Transform3D.columns(translation=positions, quaternion=xyzw),
            )
        else:
            still = rr.Transform3D(translation=positions[0], quaternion=rr.Quaternion(xyzw=xyzw[0]))
            recording.log(bodies[body], still, static=True)


def log_alternatives(recording: rr.RecordingStream, alternatives: AlternativeSet) -> None:
    """Log the paths of a set, with an entity per sampler, coloured by their LESS weight in the set."""
    weights = alternatives.log_weights
    if not weights.size:
        return
    samplers = np.array(alternatives.samplers)
    colors = palette.path_colors(weights, float(weights.min()), float(weights.max()))
    for sampler in dict.fromkeys(alternatives.samplers):
        rows = np.flatnonzero(samplers == sampler)
        # by ascending weight, so that paths with large weights are drawn last and stay visible
        rows = rows[np.argsort(weights[rows], kind="stable")]
        strips = rr.LineStrips3D(list(alternatives.paths[rows]), radii=_THIN, colors=colors[rows])
        recording.log(f"{alternatives_entity(alternatives.name)}/{part(sampler)}", strips, static=True)


def log_predicted(recording: rr.RecordingStream, model: str, predicted: Predicted) -> None:
    """Log the median path of someone new, boxes of probability 0.9 for each axis along it, and likely paths."""
    color, entity = palette.MODELS.get(model, palette.GREEN), f"{PREDICTED}/{part(model)}"
    median = rr.LineStrips3D([predicted.median], radii=_THICK, colors=color)
    recording.log(f"{entity}/median", median, static=True)
    likely = rr.LineStrips3D(list(predicted.likely), radii=_THIN, colors=color)
    recording.log(f"{entity}/likely", likely, static=True)
    some = slice(None, None, _BOX_EVERY)
    sizes, centres = (predicted.high - predicted.low)[some] / 2, (predicted.high + predicted.low)[some] / 2
    frame = rr.components.FillMode.MajorWireframe
    boxes = rr.Boxes3D(half_sizes=sizes, centers=centres, colors=color, radii=_HAIR, fill_mode=frame)
    recording.log(f"{entity}/interval", boxes, static=True)


def alternatives_entity(name: tuple[str, ...]) -> str:
    """The entity under which a set of alternatives, or a branch of sets, is logged."""
    return "/".join(["scene/alternatives", *(part(branch) for branch in name)])


def label_lift(paths: FloatArray) -> float:
    """Height above the hand at which its label is drawn (m), for paths (..., 3): so far that what it holds is seen."""
    points = paths.reshape(-1, 3)
    return _LABEL_LIFT * float(np.linalg.norm(np.ptp(points, axis=0)))


def log_playing(
    recording: rr.RecordingStream, name: str, path: FloatArray, time_s: FloatArray, step: int, lift_m: float
) -> None:
    """Log the path of a demonstration, growing over time, with its name at the end effector.

    Args:
        recording: the recording that is logged to.
        name: name of the demonstration.
        path: (T, 3) m, path of the end effector.
        time_s: (T,) s, time at each point.
        step: its number, from 1.
        lift_m: height of the name above the hand.
    """
    at(recording, float(time_s[0]), step)
    recording.log("scene/playing", rr.LineStrips3D.from_fields(radii=_THICK, colors=palette.WHITE))
    recording.log("scene/playing/hand", rr.Points3D.from_fields(radii=_DOT, colors=palette.WHITE))
    named = rr.Points3D.from_fields(radii=0.0, colors=palette.WHITE, labels=[drawable(name)], show_labels=True)
    recording.log("scene/playing/name", named)
    recording.reset_time()
    drawn = [path[[0, 0]], *(path[: count + 1] for count in range(1, len(path)))]
    times = columns(time_s, step)
    recording.send_columns("scene/playing", indexes=times, columns=rr.LineStrips3D.columns(strips=drawn))
    recording.send_columns("scene/playing/hand", indexes=times, columns=rr.Points3D.columns(positions=path))
    above = path + np.array([0.0, 0.0, lift_m])
    recording.send_columns("scene/playing/name", indexes=times, columns=rr.Points3D.columns(positions=above))


def body_entities(names: tuple[str, ...]) -> list[str]:
    """The entities under which the bodies are logged."""
    return [f"scene/bodies/{part(name)}" for name in names]


def solid(shape: Shape) -> Any:
    """A shape as the Rerun archetype of its kind, in the frame of its body."""
    rotation = rr.Quaternion(xyzw=np.roll(shape.quaternion, -1))
    color = np.rint(255 * np.maximum(shape.rgba, _DARKEST)).astype(np.uint8)
    common: dict[str, Any] = {
        "quaternions": [rotation], "colors": [color], "fill_mode": rr.components.FillMode.Solid,
    }  # fmt: skip
    size = shape.size
    if shape.kind == "mesh":
        return _mesh(shape, color)
    if shape.kind == "capsule":
        # MuJoCo places a capsule by its centre, Rerun by the centre of its lower cap
        foot = shape.position + _rotate(shape.quaternion, np.array([0.0, 0.0, -size[1]]))
        return rr.Capsules3D(lengths=[2 * size[1]], radii=[size[0]], translations=[foot], **common)
    if shape.kind == "cylinder":
        return rr.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], centers=[shape.position], **common)
    if shape.kind in ("sphere", "ellipsoid"):
        half = np.full(3, size[0]) if shape.kind == "sphere" else size
        return rr.Ellipsoids3D(half_sizes=[half], centers=[shape.position], **common)
    half = size
    if shape.kind == "plane":
        common["colors"] = [palette.GROUND]  # thin bright paths would be hard to see in front of a bright floor
        half = np.append(np.where(size[:2] > 0, size[:2], _ENDLESS_M), _PLANE_HALF_THICKNESS_M)
    return rr.Boxes3D(half_sizes=[half], centers=[shape.position], **common)


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
