"""KLAggregate against the size of the sets on logarithmic axes, with a panel per regime and a line per model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import rerun as rr

from pipeline.views import palette
from pipeline.views.rerun.labels import log_labels, part
from pipeline.vocabulary import REGIMES, model_name

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray

    Bounds = tuple[tuple[float, float], tuple[float, float]]

_WIDTH, _HEIGHT, _GAP, _LEFT = 100.0, 130.0, 16.0, 30.0  # of a panel, between panels, left of the first; page units
_LINE, _HAIR, _DOT = (rr.Radius.ui_points(points) for points in (1.4, 0.4, 3.5))
_LABEL_DROP = 7.0  # distance at which the viewer draws a label below its point


_MOST_DECADES = 3.5  # that have two numbers each


def spread_bounds(robustness: pl.DataFrame) -> Bounds:
    """Horizontal and vertical extent of the chart's view."""
    panels = robustness["regime"].n_unique()
    return (-_LEFT, panels * (_WIDTH + _GAP)), (-38.0, _HEIGHT + 26.0)


def log_spread(recording: rr.RecordingStream, robustness: pl.DataFrame) -> None:
    """Log the chart under `/robustness`.

    Args:
        recording: the recording that is logged to.
        robustness: rows of the table `robustness_summary` for one kind of demonstrations.
    """
    with_interval = robustness.drop_nulls(["low", "high"]).filter(pl.col("low") > 0)
    values = pl.concat([robustness["value"], with_interval["low"], with_interval["high"]])
    marks = decades(float(values.min()), float(values.max()))  # type: ignore[arg-type]
    low, high = np.log10(marks[0]), np.log10(marks[-1])
    sizes = robustness["set_size"].unique().sort().to_numpy()
    first, span = np.log10(sizes[0]), max(1e-9, np.log10(sizes[-1] / sizes[0]))

    def up(values: FloatArray) -> FloatArray:
        return np.asarray(_HEIGHT * (1 - (np.log10(values) - low) / (high - low)))

    def across(values: FloatArray, panel: int) -> FloatArray:
        return np.asarray(panel * (_WIDTH + _GAP) + _WIDTH * (0.06 + 0.88 * (np.log10(values) - first) / span))

    models = tuple(robustness["model"].unique(maintain_order=True))
    for panel, (regime,) in enumerate(robustness.select("regime").unique(maintain_order=True).iter_rows()):
        left = panel * (_WIDTH + _GAP)
        entity = f"robustness/{part(REGIMES.get(regime, regime))}"
        for model in models:
            rows = robustness.filter(regime=regime, model=model).sort("set_size")
            x, y = across(rows["set_size"].to_numpy(), panel), up(rows["value"].to_numpy())
            color = palette.model_color(model, models)
            line = rr.LineStrips2D([np.stack([x, y], axis=1)], radii=_LINE, colors=color, draw_order=2.0)
            recording.log(f"{entity}/{part(model)}", line, static=True)
            dots = rr.Points2D(np.stack([x, y], axis=1), radii=_DOT, colors=color, draw_order=3.0)
            recording.log(f"{entity}/{part(model)}/points", dots, static=True)
            intervals = with_interval.filter(regime=regime, model=model)
            x = across(intervals["set_size"].to_numpy(), panel)
            y_ends = np.stack([up(intervals["low"].to_numpy()), up(intervals["high"].to_numpy())], axis=1)
            bars = np.stack([np.repeat(x[:, None], 2, axis=1), y_ends], axis=2)
            strips = rr.LineStrips2D(list(bars), radii=_LINE, colors=color, draw_order=2.0)
            recording.log(f"{entity}/{part(model)}/intervals", strips, static=True)
        rules = [[(left, y), (left + _WIDTH, y)] for y in up(marks)]
        recording.log(f"{entity}/lines", rr.LineStrips2D(rules, radii=_HAIR, colors=palette.GREY), static=True)
        numbers = np.stack([across(sizes, panel), np.full(sizes.size, _HEIGHT)], axis=1)
        log_labels(recording, f"{entity}/sizes", numbers, [f"{size:g}" for size in sizes])
        title = [(left + _WIDTH / 2, -_LABEL_DROP - 11.0)]
        log_labels(recording, f"{entity}/title", title, [REGIMES.get(regime, regime)])
    positions = np.stack([np.full(marks.size, -0.5 * _LEFT), up(marks) - 0.5 * _LABEL_DROP], axis=1)
    log_labels(recording, "robustness/numbers", positions, [f"{mark:g}" for mark in marks])
    legend = [(0.25 * _WIDTH + 0.9 * _WIDTH * column, -_LABEL_DROP - 29.0) for column in range(len(models))]
    colors = [palette.model_color(model, models) for model in models]
    log_labels(recording, "robustness/legend", legend, [model_name(m) for m in models], colors=colors)


def decades(low: float, high: float) -> FloatArray:
    """Round numbers from the last one <= `low` to the first one >= `high`; both are positive.

    They are 1, 3, 10, 30 and so on, or powers of ten where there would be too many of them.
    """
    steps = np.array([1.0, 3.0] if np.log10(high / low) < _MOST_DECADES else [1.0])
    powers = np.arange(np.floor(np.log10(low)) - 1, np.ceil(np.log10(high)) + 1)
    marks = np.sort(np.outer(10.0**powers, steps).ravel())
    below, above = marks[marks <= low * (1 + 1e-9)].max(), marks[marks >= high * (1 - 1e-9)]
    above_or_next = above.min() if above.size and above.min() > below else marks[marks > below].min()
    return np.asarray(marks[(marks >= below) & (marks <= above_or_next)])
