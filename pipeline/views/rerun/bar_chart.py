"""A chart of bars that can be read in the viewer: a named row per thing, a column per model.

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

_ROW = 25.0
_BAR_RADIUS = 6.5
_VALUE_WIDTH = 60.0
# the viewer hangs a label below its point
_LABEL_DROP = 13.0
_WORTH_A_NUMBER = 0.01
# shorter than this, a bar's end cannot be told from its beginning
_SHORTEST = 2.0


@dataclass(frozen=True)
class BarChart:
    """Where things are on the page; a page unit is a screen point where the view has the size it was laid out for.

    Attributes:
        entity: where it is logged.
        models: in the order of the columns.
        full: the probability at a bar's full length.
        names_width: of the column of names, in page units.
        columns_width: of all models' columns together.
    """

    entity: str
    models: tuple[str, ...]
    full: float
    names_width: float = 250.0
    columns_width: float = 480.0

    def bounds(self, rows: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """Horizontal and vertical extent of a chart of so many rows."""
        return (0.0, self.names_width + self.columns_width + 10.0), (-1.6 * _ROW, (rows + 0.9) * _ROW)

    @property
    def full_length(self) -> float:
        """Length of a bar of probability `full`."""
        return self.columns_width / len(self.models) - _VALUE_WIDTH

    def left(self, column: int) -> float:
        """Where a column's bars begin."""
        return self.names_width + column * self.columns_width / len(self.models)

    def color(self, column: int) -> palette.RGB:
        """Of a column's bars."""
        return palette.model_color(self.models[column], self.models)


def full_scale(longest: float) -> float:
    """The round probability that a full bar stands for."""
    return next(step for step in (0.1, 0.2, 0.5, 1.0) if longest <= step + 1e-9)


def log_bars(recording: rr.RecordingStream, chart: BarChart, column: int, values: FloatArray, *, static: bool) -> None:
    """Log one model's bars, and each one's number at the end of its column."""
    lengths = values / chart.full * chart.full_length
    # a strip with round ends that fills the bar's rectangle: lying where the bar is long, standing where it is short, and
    # never without length, which would not be drawn
    radii = 0.98 * np.minimum(_BAR_RADIUS, lengths / 2)
    reach = np.stack([lengths / 2 - radii, _BAR_RADIUS - radii], axis=1)
    centres = np.stack([chart.left(column) + lengths / 2, np.arange(values.size) * _ROW], axis=1)
    strips = np.stack([centres - reach, centres + reach], axis=1)
    entity = f"{chart.entity}/{part(chart.models[column])}"
    bars = rr.LineStrips2D(list(strips), radii=radii, colors=chart.color(column), draw_order=1.0)
    recording.log(f"{entity}/bars", bars, static=static)
    numbered = values >= _WORTH_A_NUMBER
    right = np.full(int(numbered.sum()), chart.left(column) + chart.full_length + 0.5 * _VALUE_WIDTH)
    at = np.stack([right, centres[numbered, 1] - _LABEL_DROP], axis=1)
    log_labels(recording, f"{entity}/values", at, [f"{value:.2f}" for value in values[numbered]], static=static)


def log_lines(recording: rr.RecordingStream, chart: BarChart, column: int, values: FloatArray, name: str) -> None:
    """Log a white line across each row of a column, at its value; those next to zero are left out."""
    lengths = values / chart.full * chart.full_length
    seen = lengths >= _SHORTEST
    x, y = chart.left(column) + lengths[seen], np.flatnonzero(seen) * _ROW
    half = 0.36 * _ROW
    strips = np.stack([np.stack([x, y - half], axis=1), np.stack([x, y + half], axis=1)], axis=1)
    lines = rr.LineStrips2D(strips, radii=rr.Radius.ui_points(0.9), colors=palette.WHITE, draw_order=2.0)
    recording.log(f"{chart.entity}/{part(chart.models[column])}/{name}", lines, static=True)


def log_frame(recording: rr.RecordingStream, chart: BarChart, rows: Sequence[str], *, static: bool = True) -> None:
    """Log the rows' names, and above and below each column its model and its scale."""
    names, colors = list(rows), [palette.WHITE] * len(rows)
    at = [(0.5 * chart.names_width, row * _ROW - _LABEL_DROP) for row in range(len(names))]
    bottom = (len(names) - 0.4) * _ROW
    rules = []
    for column, model in enumerate(chart.models):
        left, right = chart.left(column), chart.left(column) + chart.full_length
        names += [model_name(model), "0", f"{chart.full:g}"]
        colors += [chart.color(column), palette.WHITE, palette.WHITE]
        at += [((left + right) / 2, -1.3 * _ROW - 0.5 * _LABEL_DROP), (left, bottom), (right, bottom)]
        rules += [[(x, -0.6 * _ROW), (x, bottom)] for x in (left, right)]
    log_labels(recording, f"{chart.entity}/names", np.array(at), names, static=static, colors=colors)
    thin = rr.Radius.ui_points(0.5)
    strips = rr.LineStrips2D(rules, radii=thin, colors=palette.GREY, draw_order=0.0)
    recording.log(f"{chart.entity}/frame", strips, static=static)
