"""Three features as a cube of points: where the alternatives are, how LESS weighs them, where the demonstrations fall."""

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
_BESIDE = 0.08


def log_space(recording: rr.RecordingStream, space: FeatureSpace) -> None:
    """Log the points under `/space`, each feature from 0 to 1 along an edge of the cube, with its numbers beside it."""
    both = np.concatenate([space.alternatives, space.demonstrations])
    low, high = both.min(axis=0), both.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    recording.log("space", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    weights = space.log_weights
    colors = palette.path_colors(weights, float(weights.min()), float(weights.max()))
    points = rr.Points3D((space.alternatives - low) / span, radii=_POINT, colors=colors)
    recording.log("space/alternatives", points, static=True)
    mine = rr.Points3D((space.demonstrations - low) / span, radii=_DEMONSTRATION, colors=palette.DEMONSTRATION)
    recording.log("space/demonstrations", mine, static=True)
    edges_only = rr.components.FillMode.MajorWireframe
    half = (0.5, 0.5, 0.5)
    box = rr.Boxes3D(centers=[half], half_sizes=[half], radii=_EDGE, colors=palette.GREY, fill_mode=edges_only)
    recording.log("space/cube", box, static=True)
    # of each feature the edge that the camera of the layout has in front of it
    edges = np.array([[0.0, 1.0 + _BESIDE, 0.0], [1.0 + _BESIDE, 0.0, 0.0], [1.0 + _BESIDE, -_BESIDE, 0.0]])
    for axis, (feature, unit) in enumerate(zip(space.features, space.units, strict=True)):
        values = ticks(low[axis], low[axis] + span[axis])
        at = np.repeat(edges[axis][None], values.size + 1, axis=0)
        at[:, axis] = [*((values - low[axis]) / span[axis]), 0.5]
        at[-1] += 3.6 * (edges[axis] - np.clip(edges[axis], 0.0, 1.0))
        texts = [*(f"{value:g}" for value in values), f"{feature} ({unit})"]
        named = [drawable(text) for text in texts]
        labels = rr.Points3D(at, radii=0.0, colors=palette.WHITE, labels=named, show_labels=True)
        recording.log(f"space/axes/{axis}", labels, static=True)
