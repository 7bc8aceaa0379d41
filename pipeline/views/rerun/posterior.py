"""The posteriors of an inspection as a bar chart with a row per hypothesis and a column per model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.views.rerun.bar_chart import BarChart, full_scale, log_bars, log_frame, log_lines
from pipeline.views.rerun.records import TIMELINE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import rerun as rr

    from pipeline.arrays import FloatArray, IntArray
    from pipeline.views.rerun.records import Inspection

_MOST_ROWS = 20  # hypotheses with a row of their own


@dataclass(frozen=True)
class Page:
    """The rows of the chart and its layout.

    Attributes:
        order: (R,) the hypotheses that have a row, at most 20, from top to bottom.
        others: number of hypotheses without a row; they share one more.
        chart: columns and scale of the chart.
    """

    order: IntArray
    others: int
    chart: BarChart

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Horizontal and vertical extent of the page."""
        return self.chart.bounds(len(self.order) + (self.others > 0))

    def row_values(self, posterior: FloatArray) -> FloatArray:
        """(R,) probabilities of the rows; (R + 1,) with that of all other hypotheses, if there are any."""
        values = posterior[self.order]
        return np.append(values, max(0.0, 1.0 - values.sum())) if self.others else values


def page(inspection: Inspection) -> Page:
    """Lay out the chart. Hypotheses are sorted by the largest final probability that any model gives them."""
    highest = np.max([posterior[-1] for posterior in inspection.posteriors.values()], axis=0)
    order = np.argsort(-highest, kind="stable")[:_MOST_ROWS]
    longest = max(float(posterior.max()) for posterior in inspection.posteriors.values())
    chart = BarChart("posterior", tuple(inspection.posteriors), full_scale(longest))
    return Page(order, highest.size - order.size, chart)


def page_now(posteriors: Mapping[str, FloatArray]) -> Page:
    """Lay out a chart whose final posteriors are not known yet: the 20 most probable hypotheses in their order.

    Args:
        posteriors: for each model, (K,) probabilities.
    """
    highest = np.max(list(posteriors.values()), axis=0)
    order = np.sort(np.argsort(-highest, kind="stable")[:_MOST_ROWS])
    return Page(order, highest.size - order.size, BarChart("posterior", tuple(posteriors), 1.0))


def log_now(recording: rr.RecordingStream, labels: Sequence[str], posteriors: Mapping[str, FloatArray]) -> None:
    """Log the chart of these posteriors at the recording's present time; arguments as in `page_now`."""
    layout = page_now(posteriors)
    rows = [labels[k] for k in layout.order] + [f"the other {layout.others} together"] * (layout.others > 0)
    log_frame(recording, layout.chart, rows, static=False)
    for column, probabilities in enumerate(posteriors.values()):
        log_bars(recording, layout.chart, column, layout.row_values(probabilities), static=False)


def log_posteriors(recording: rr.RecordingStream, inspection: Inspection) -> None:
    """Log the chart under `/posterior`; the bars change as the demonstrations are played."""
    layout = page(inspection)
    times = np.concatenate([inspection.replay.time_s[:1], inspection.end_s])
    names = [inspection.theta_labels[k] for k in layout.order]
    log_frame(recording, layout.chart, names + [f"the other {layout.others} together"] * (layout.others > 0))
    for column, posterior in enumerate(inspection.posteriors.values()):
        log_lines(recording, layout.chart, column, layout.row_values(posterior[-1]), "final")
        for time_s, probabilities in zip(times, posterior, strict=True):
            recording.set_time(TIMELINE, duration=time_s)
            log_bars(recording, layout.chart, column, layout.row_values(probabilities), static=False)
    recording.reset_time()
