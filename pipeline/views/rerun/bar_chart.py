"""A bar chart for the viewer, with a named row for each item and a column for each model.

Rerun's own bar chart has no names on its axis, so bars, lines and names are drawn as 2-D shapes on a page.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from pipeline.views import palette
from pipeline.views.rerun.labels import log_labels, part
from pipeline.vocabulary import model_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pipeline.arrays import FloatArray

# Lengths are in page units.
_BAR_RADIUS = 6.5  # half the height of a bar
_VALUE_WIDTH = 60.0  # width that is left for a number behind a bar
_LABEL_DROP = 13.0  # distance at which the viewer draws a label below its point
_SHORTEST = 2.0  # a shorter bar's end cannot be told from its beginning
_WORTH_A_NUMBER = 0.01  # smaller probabilities have no number


@dataclass(frozen=True)
class BarChart:
    """The layout of a chart. A page unit is a screen point if the view has the size that it was laid out for.

    Attributes:
        entity: the path under which the chart is logged.
        models: names of the models, in the order of their columns.
        full: the probability that a bar of full length stands for.
        names_width: width of the column of names, in page units.
        columns_width: width of all models' columns together, in page units.
        row: height of a row, in page units.
    """

    entity: str
    models: tuple[str, ...]
    full: float
    names_width: float = 250.0
    columns_width: float = 480.0
    row: float = 25.0

    def bounds(self, rows: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """Horizontal and vertical extent of a chart with this number of rows."""
        return (0.0, self.names_width + self.columns_width + 10.0), (-1.6 * self.row, (rows + 0.9) * self.row)

    @property
    def full_length(self) -> float:
        """Length of a bar of probability `full`."""
        return self.columns_width / len(self.models) - _VALUE_WIDTH

    def left(self, column: int) -> float:
        """The horizontal position at which the bars of a column begin."""
        return self.names_width + column * self.columns_width / len(self.models)

    def color(self, column: int) -> palette.RGB:
        """The colour of a column's bars."""
        return palette.model_color(self.models[column], self.models)


def full_scale(longest: float) -> float:
    """The smallest round probability that is not below `longest`, for a bar of full length."""
    return next(step for step in (0.1, 0.2, 0.5, 1.0) if longest <= step + 1e-9)


def log_bars(
    recording: rr.RecordingStream,
    chart: BarChart,
    column: int,
    values: FloatArray,
    *,
    static: bool,
    always: int | None = None,
) -> None:
    """Log the bars of one model, with their numbers at the end of its column.

    Small probabilities have no number, but for that of the row `always`.
    """
    lengths = values / chart.full * chart.full_length
    # A bar is a strip with round ends that fills the bar's rectangle. It lies if the bar is long and stands if it is
    # short, so that it never has length zero, which would not be drawn.
    radii = 0.98 * np.minimum(_BAR_RADIUS, lengths / 2)
    reach = np.stack([lengths / 2 - radii, _BAR_RADIUS - radii], axis=1)
    centres = np.stack([chart.left(column) + lengths / 2, np.arange(values.size) * chart.row], axis=1)
    strips = np.stack([centres - reach, centres + reach], axis=1)
    entity = f"{chart.entity}/{part(chart.models[column])}"
    bars = rr.LineStrips2D(list(strips), radii=radii, colors=chart.color(column), draw_order=1.0)
    recording.log(f"{entity}/bars", bars, static=static)
    numbered = values >= _WORTH_A_NUMBER
    if always is not None:
        numbered[always] = True
    right = np.full(int(numbered.sum()), chart.left(column) + chart.full_length + 0.5 * _VALUE_WIDTH)
    positions = np.stack([right, centres[numbered, 1] - _LABEL_DROP], axis=1)
    log_labels(recording, f"{entity}/values", positions, [_number(value) for value in values[numbered]], static=static)


def _number(value: float) -> str:
    return f"{value:.2f}" if value >= _WORTH_A_NUMBER else f"<{_WORTH_A_NUMBER:g}"


def log_lines(
    recording: rr.RecordingStream, chart: BarChart, column: int, values: FloatArray, name: str, *, static: bool = True
) -> None:
    """Log a white line at the value of each row of a column; lines next to zero are left out."""
    lengths = values / chart.full * chart.full_length
    visible = lengths >= _SHORTEST
    x, y = chart.left(column) + lengths[visible], np.flatnonzero(visible) * chart.row
    half = 0.36 * chart.row
    strips = np.stack([np.stack([x, y - half], axis=1), np.stack([x, y + half], axis=1)], axis=1)
    lines = rr.LineStrips2D(strips, radii=rr.Radius.ui_points(0.9), colors=palette.WHITE, draw_order=2.0)
    recording.log(f"{chart.entity}/{part(chart.models[column])}/{name}", lines, static=static)


def log_frame(recording: rr.RecordingStream, chart: BarChart, rows: Sequence[str], *, static: bool = True) -> None:
    """Log the names of the rows, and the model above and the scale below each column."""
    names, colors = list(rows), [palette.WHITE] * len(rows)
    positions = [(0.5 * chart.names_width, row * chart.row - _LABEL_DROP) for row in range(len(names))]
    bottom = (len(names) - 0.4) * chart.row
    rules = []
    for column, model in enumerate(chart.models):
        left, right = chart.left(column), chart.left(column) + chart.full_length
        names += [model_name(model), "0", f"{chart.full:g}"]
        colors += [chart.color(column), palette.WHITE, palette.WHITE]
        positions += [((left + right) / 2, -1.3 * chart.row - 0.5 * _LABEL_DROP), (left, bottom), (right, bottom)]
        rules += [[(x, -0.6 * chart.row), (x, bottom)] for x in (left, right)]
    log_labels(recording, f"{chart.entity}/names", np.array(positions), names, static=static, colors=colors)
    thin = rr.Radius.ui_points(0.5)
    strips = rr.LineStrips2D(rules, radii=thin, colors=palette.GREY, draw_order=0.0)
    recording.log(f"{chart.entity}/frame", strips, static=static)
