"""The posteriors of an inspection as one chart that can be read: a row per hypothesis, a column per model.

Rerun's own bar chart has no names on its axis, so bars, lines and names are drawn as 2-D shapes on a page.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from pipeline.stores import palette
from pipeline.stores.viewer import TIMELINE
from pipeline.stores.viewer_text import log_labels, part

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pipeline.stores.viewer import Inspection

    Floats = NDArray[np.float64]

MODEL_NAMES = {"boltzmann": "Boltzmann", "less": "LESS", "attribute-rule": "attribute rule"}

# a page unit is a screen point where the view has the size it was laid out for (half of a 1600-point window)
_ROW = 25.0
_BAR_RADIUS = 6.5
_NAMES_WIDTH = 250.0
_COLUMNS_WIDTH = 480.0
_VALUE_WIDTH = 60.0
# the viewer hangs a label below its point
_LABEL_DROP = 13.0
_MOST_ROWS = 20
_WORTH_A_NUMBER = 0.01
# shorter than this, a bar's end cannot be told from its beginning
_SHORTEST = 2.0


@dataclass(frozen=True)
class Page:
    """Which hypotheses have a row, and the common scale of the bars.

    Attributes:
        order: (R,) hypotheses from the most probable down, at most 20.
        full: the probability at a bar's full length.
        models: in the order of the columns.
        others: how many hypotheses have no row of their own.
    """

    order: NDArray[np.int64]
    full: float
    models: tuple[str, ...]
    others: int

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Horizontal and vertical extent."""
        rows = len(self.order) + (self.others > 0)
        return (0.0, _NAMES_WIDTH + _COLUMNS_WIDTH + 10.0), (-1.6 * _ROW, (rows + 0.9) * _ROW)

    @property
    def full_length(self) -> float:
        """Length of a bar of probability `full`."""
        return _COLUMNS_WIDTH / len(self.models) - _VALUE_WIDTH

    def left(self, column: int) -> float:
        """Where a column's bars begin."""
        return _NAMES_WIDTH + column * _COLUMNS_WIDTH / len(self.models)

    def row_values(self, posterior: Floats) -> Floats:
        """(R,) or, with hypotheses left over, (R + 1,): the last is what they have together."""
        own = posterior[self.order]
        return np.append(own, max(0.0, 1.0 - own.sum())) if self.others else own


def page(inspection: Inspection) -> Page:
    """Lay the chart out; hypotheses are ordered by the highest final probability that any model gives them."""
    highest = np.max([posterior[-1] for posterior in inspection.posteriors.values()], axis=0)
    order = np.argsort(-highest, kind="stable")[:_MOST_ROWS]
    longest = max(float(posterior.max()) for posterior in inspection.posteriors.values())
    full = next(step for step in (0.1, 0.2, 0.5, 1.0) if longest <= step + 1e-9)
    return Page(order, full, tuple(inspection.posteriors), highest.size - order.size)


def log_posteriors(recording: rr.RecordingStream, inspection: Inspection) -> None:
    """Log the chart under `/posterior`; the bars change as the demonstrations are played."""
    chart = page(inspection)
    times = np.concatenate([inspection.replay.time_s[:1], inspection.end_s])
    _log_frame(recording, chart, inspection)
    for column, model in enumerate(chart.models):
        posterior = inspection.posteriors[model]
        color = palette.model_color(model, chart.models)
        _log_final(recording, chart, column, posterior[-1])
        for time_s, probabilities in zip(times, posterior, strict=True):
            recording.set_time(TIMELINE, duration=time_s)
            _log_bars(recording, chart, column, chart.row_values(probabilities), color)
    recording.reset_time()


def _log_bars(recording: rr.RecordingStream, chart: Page, column: int, values: Floats, color: palette.RGB) -> None:
    lengths = values / chart.full * chart.full_length
    # a strip with round ends that fills the bar's rectangle: lying where the bar is long, standing where it is short, and
    # never without length, which would not be drawn
    radii = 0.98 * np.minimum(_BAR_RADIUS, lengths / 2)
    reach = np.stack([lengths / 2 - radii, _BAR_RADIUS - radii], axis=1)
    centres = np.stack([chart.left(column) + lengths / 2, np.arange(values.size) * _ROW], axis=1)
    strips = np.stack([centres - reach, centres + reach], axis=1)
    entity = f"posterior/{part(chart.models[column])}"
    recording.log(f"{entity}/bars", rr.LineStrips2D(list(strips), radii=radii, colors=color, draw_order=1.0))
    numbered = values >= _WORTH_A_NUMBER
    right = np.full(int(numbered.sum()), chart.left(column) + chart.full_length + 0.5 * _VALUE_WIDTH)
    at = np.stack([right, centres[numbered, 1] - _LABEL_DROP], axis=1)
    log_labels(recording, f"{entity}/values", at, [f"{value:.2f}" for value in values[numbered]], static=False)


def _log_final(recording: rr.RecordingStream, chart: Page, column: int, posterior: Floats) -> None:
    lengths = chart.row_values(posterior) / chart.full * chart.full_length
    seen = lengths >= _SHORTEST
    x, y = chart.left(column) + lengths[seen], np.flatnonzero(seen) * _ROW
    half = 0.36 * _ROW
    strips = np.stack([np.stack([x, y - half], axis=1), np.stack([x, y + half], axis=1)], axis=1)
    lines = rr.LineStrips2D(strips, radii=rr.Radius.ui_points(0.9), colors=palette.WHITE, draw_order=2.0)
    recording.log(f"posterior/{part(chart.models[column])}/final", lines, static=True)


def _log_frame(recording: rr.RecordingStream, chart: Page, inspection: Inspection) -> None:
    names = [inspection.theta_labels[k] for k in chart.order]
    if chart.others:
        names.append(f"the other {chart.others} together")
    at = [(0.5 * _NAMES_WIDTH, row * _ROW - _LABEL_DROP) for row in range(len(names))]
    bottom = (len(names) - 0.4) * _ROW
    rules = []
    colors = [palette.WHITE] * len(names)
    for column, model in enumerate(chart.models):
        left, right = chart.left(column), chart.left(column) + chart.full_length
        names += [MODEL_NAMES.get(model, model), "0", f"{chart.full:g}"]
        colors += [palette.model_color(model, chart.models), palette.WHITE, palette.WHITE]
        at += [((left + right) / 2, -1.3 * _ROW - 0.5 * _LABEL_DROP), (left, bottom), (right, bottom)]
        rules += [[(x, -0.6 * _ROW), (x, bottom)] for x in (left, right)]
    log_labels(recording, "posterior/names", np.array(at), names, colors=colors)
    thin = rr.Radius.ui_points(0.5)
    recording.log(
        "posterior/frame", rr.LineStrips2D(rules, radii=thin, colors=palette.GREY, draw_order=0.0), static=True
    )
