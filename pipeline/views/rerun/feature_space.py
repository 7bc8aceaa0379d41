"""Alternatives, coloured by their LESS weight, and demonstrations as points in a cube of three features."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from pipeline.views import palette
from pipeline.views.rerun.density import ticks
from pipeline.views.rerun.labels import drawable, part
from pipeline.vocabulary import model_name

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray
    from pipeline.views.rerun.records import FeatureSpace

_POINT, _DEMONSTRATION, _EDGE = (rr.Radius.ui_points(points) for points in (1.8, 5.0, 0.6))
_SHAFT = rr.Radius.ui_points(3.0)
_ARROW = 0.4  # length of an arrow, as a share of the cube's edge
TRUTH = "the truth"  # name of the arrow of what people truly want
# Distance of the numbers from the cube, as a share of its edge; that of an axis's name from them, in such distances;
# and where along the three axes their names are, so that they stay clear of the numbers at the corner in front.
_BESIDE, _OUTSIDE, _ALONG = 0.08, 6.5, (0.3, 0.7, 1.16)


def log_space(recording: rr.RecordingStream, space: FeatureSpace) -> None:
    """Log the points under `/space`. Each feature runs from 0 to 1 along an edge of the cube, beside its numbers.

    Arrows begin at the mean of the demonstrations and show where people want to go: by each model, and in truth.
    """
    values = np.concatenate([space.alternatives, space.demonstrations])
    low, high = values.min(axis=0), values.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    recording.log("space", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    weights = space.log_weights
    colors = palette.path_colors(weights, float(weights.min()), float(weights.max()))
    points = rr.Points3D((space.alternatives - low) / span, radii=_POINT, colors=colors)
    recording.log("space/alternatives", points, static=True)
    demonstrations = (space.demonstrations - low) / span
    points = rr.Points3D(demonstrations, radii=_DEMONSTRATION, colors=palette.DEMONSTRATION)
    recording.log("space/demonstrations", points, static=True)
    models = tuple(space.wanted)
    arrows = {model_name(model): (wanted, palette.model_color(model, models)) for model, wanted in space.wanted.items()}
    if space.truth is not None:
        arrows[TRUTH] = (space.truth, palette.WHITE)
    for name, (wanted, color) in arrows.items():
        vector = wanted * span
        vector = _ARROW * vector / max(float(np.linalg.norm(vector)), 1e-12)
        arrow = rr.Arrows3D(
            origins=[demonstrations.mean(axis=0)], vectors=[vector], radii=_SHAFT, colors=color,
        )  # fmt: skip
        recording.log(f"space/wanted/{part(name)}", arrow, static=True)
    edges_only = rr.components.FillMode.MajorWireframe
    half = (0.5, 0.5, 0.5)
    box = rr.Boxes3D(centers=[half], half_sizes=[half], radii=_EDGE, colors=palette.GREY, fill_mode=edges_only)
    recording.log("space/cube", box, static=True)
    # for each feature, the edge that is in front of the layout's camera
    edges = np.array([[0.0, -_BESIDE, 0.0], [1.0 + _BESIDE, 0.0, 0.0], [-_BESIDE, -_BESIDE, 0.0]])
    for axis, label in enumerate(space.labels):
        marks = _few(ticks(low[axis], low[axis] + span[axis]))
        positions = np.repeat(edges[axis][None], marks.size + 1, axis=0)
        positions[:, axis] = [*((marks - low[axis]) / span[axis]), _ALONG[axis]]
        if axis < 2:
            positions[-1] += _OUTSIDE * (edges[axis] - np.clip(edges[axis], 0.0, 1.0))
        texts = [drawable(text) for text in (*(f"{mark:g}" for mark in marks), label)]
        labels = rr.Points3D(positions, radii=0.0, colors=palette.WHITE, labels=texts, show_labels=True)
        recording.log(f"space/axes/{axis}", labels, static=True)


def _few(marks: FloatArray) -> FloatArray:
    """At most three of the numbers of an axis: more cover one another where the axis is seen from aside."""
    return marks[:: -(-marks.size // 3)]
