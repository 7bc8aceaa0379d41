"""The weights of the features with their intervals, one row per feature, and the truth where it is known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from pipeline.views import palette
from pipeline.views.rerun.labels import log_labels, part
from pipeline.vocabulary import model_name

if TYPE_CHECKING:
    import polars as pl

    from pipeline.arrays import FloatArray
    from pipeline.views.rerun.records import Weights

    Bounds = tuple[tuple[float, float], tuple[float, float]]

# Lengths are in page units.
_NAMES, _WIDTH, _ROW, _DROP = 130.0, 420.0, 46.0, 13.0
_LINE, _DOT, _HAIR, _TRUTH = (rr.Radius.ui_points(points) for points in (1.6, 4.0, 0.5, 1.2))
_MARKS = (-1.0, -0.5, 0.0, 0.5, 1.0)


def weights_bounds(features: int) -> Bounds:
    """Horizontal and vertical extent of the page for so many features."""
    return (0.0, _NAMES + _WIDTH + 20.0), (-2.2 * _ROW, (features + 0.6) * _ROW)


def log_weights(recording: rr.RecordingStream, weights: Weights, *, static: bool = True) -> None:
    """Log the chart under `/weights`: the median and the interval of each weight by model, and the truth as a line.

    A weight is the direction's part along a scaled feature, from -1 to 1: to the right more of the feature is wanted,
    to the left less.

    Args:
        recording: where to.
        weights: what is shown.
        static: for the whole recording, or from its present time on.
    """
    models = tuple(weights.summary["model"].unique(maintain_order=True))
    bottom = (len(weights.features) - 0.35) * _ROW
    rules = [[(x, -0.6 * _ROW), (x, bottom)] for x in _across(np.array(_MARKS))]
    recording.log(
        "weights/frame", rr.LineStrips2D(rules, radii=_HAIR, colors=palette.GREY, draw_order=0.0), static=static
    )
    for place, model in enumerate(models):
        offset = (place - (len(models) - 1) / 2) * 0.3 * _ROW
        color, rows = palette.model_color(model, models), _rows(weights.summary, model, weights.features)
        y = np.arange(len(weights.features)) * _ROW + offset
        low, median, high = (_across(np.clip(rows[:, i], -1.0, 1.0)) for i in range(3))
        strips = np.stack([np.stack([low, y], axis=1), np.stack([high, y], axis=1)], axis=1)
        entity = f"weights/{part(model)}"
        lines = rr.LineStrips2D(strips, radii=_LINE, colors=color, draw_order=1.0)
        recording.log(f"{entity}/interval", lines, static=static)
        dots = rr.Points2D(np.stack([median, y], axis=1), radii=_DOT, colors=color, draw_order=2.0)
        recording.log(f"{entity}/median", dots, static=static)
    names = [*weights.features, "less is wanted", "more is wanted", *(f"{mark:g}" for mark in _MARKS)]
    positions = [(0.5 * _NAMES, row * _ROW - _DROP) for row in range(len(weights.features))]
    positions += [(float(x), -1.05 * _ROW) for x in _across(np.array([-0.5, 0.5]))]
    positions += [(float(x), bottom) for x in _across(np.array(_MARKS))]
    colors = [palette.WHITE] * len(names)
    legend = [*((model_name(m), palette.model_color(m, models)) for m in models)]
    if weights.truth is not None:
        x, y = _across(weights.truth), np.arange(len(weights.features)) * _ROW
        half = 0.4 * _ROW
        strips = np.stack([np.stack([x, y - half], axis=1), np.stack([x, y + half], axis=1)], axis=1)
        lines = rr.LineStrips2D(strips, radii=_TRUTH, colors=palette.WHITE, draw_order=3.0)
        recording.log("weights/truth", lines, static=static)
        legend.append(("white line: the truth", palette.WHITE))
    elif not static:
        recording.log("weights/truth", rr.Clear(recursive=False))
    step = (_NAMES + _WIDTH) / len(legend)
    names += [name for name, _ in legend]
    positions += [((place + 0.5) * step, -1.85 * _ROW) for place in range(len(legend))]
    colors += [color for _, color in legend]
    log_labels(recording, "weights/names", np.array(positions), names, colors=colors, static=static)


def _across(values: FloatArray) -> FloatArray:
    return np.asarray(_NAMES + (np.asarray(values) + 1) / 2 * _WIDTH)


def _rows(summary: pl.DataFrame, model: str, features: tuple[str, ...]) -> FloatArray:
    """(F, 3) low, median and high."""
    rows = {row["feature"]: row for row in summary.filter(model=model).iter_rows(named=True)}
    return np.array([[rows[one][column] for column in ("low", "median", "high")] for one in features])
