"""Alternatives, coloured by their LESS weight, and demonstrations as points in a cube of three features."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from pipeline.views import palette
from pipeline.views.rerun.density import ticks
from pipeline.views.rerun.labels import drawable

if TYPE_CHECKING:
    from pipeline.views.rerun.records import FeatureSpace

_POINT, _DEMONSTRATION, _EDGE = (rr.Radius.ui_points(points) for points in (1.8, 5.0, 0.6))
_BESIDE = 0.08  # distance of the numbers from the cube, as a share of its edge


def log_space(recording: rr.RecordingStream, space: FeatureSpace) -> None:
    """Log the points under `/space`. Each feature runs from 0 to 1 along an edge of the cube, beside its numbers."""
    values = np.concatenate([space.alternatives, space.demonstrations])
    low, high = values.min(axis=0), values.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    recording.log("space", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    weights = space.log_weights
    colors = palette.path_colors(weights, float(weights.min()), float(weights.max()))
    points = rr.Points3D((space.alternatives - low) / span, radii=_POINT, colors=colors)
    recording.log("space/alternatives", points, static=True)
    points = rr.Points3D((space.demonstrations - low) / span, radii=_DEMONSTRATION, colors=palette.DEMONSTRATION)
    recording.log("space/demonstrations", points, static=True)
    edges_only = rr.components.FillMode.MajorWireframe
    half = (0.5, 0.5, 0.5)
    box = rr.Boxes3D(centers=[half], half_sizes=[half], radii=_EDGE, colors=palette.GREY, fill_mode=edges_only)
    recording.log("space/cube", box, static=True)
    # for each feature, the edge that is in front of the layout's camera
    edges = np.array([[0.0, 1.0 + _BESIDE, 0.0], [1.0 + _BESIDE, 0.0, 0.0], [1.0 + _BESIDE, -_BESIDE, 0.0]])
    for axis, (feature, unit) in enumerate(zip(space.features, space.units, strict=True)):
        marks = ticks(low[axis], low[axis] + span[axis])
        positions = np.repeat(edges[axis][None], marks.size + 1, axis=0)
        positions[:, axis] = [*((marks - low[axis]) / span[axis]), 0.5]
        positions[-1] += 3.6 * (edges[axis] - np.clip(edges[axis], 0.0, 1.0))
        texts = [drawable(text) for text in (*(f"{mark:g}" for mark in marks), f"{feature} ({unit})")]
        labels = rr.Points3D(positions, radii=0.0, colors=palette.WHITE, labels=texts, show_labels=True)
        recording.log(f"space/axes/{axis}", labels, static=True)
