"""The posteriors of an inspection as one chart: a row per hypothesis, a column per model."""

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

_MOST_ROWS = 20


@dataclass(frozen=True)
class Page:
    """Which hypotheses have a row, and the chart they are in.

    Attributes:
        order: (R,) hypotheses from the most probable down, at most 20.
        others: how many hypotheses have no row of their own.
        chart: its columns and scale.
    """

    order: IntArray
    others: int
    chart: BarChart

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Horizontal and vertical extent."""
        return self.chart.bounds(len(self.order) + (self.others > 0))

    def row_values(self, posterior: FloatArray) -> FloatArray:
        """(R,) or, with hypotheses left over, (R + 1,): the last is what they have together."""
        own = posterior[self.order]
        return np.append(own, max(0.0, 1.0 - own.sum())) if self.others else own


def page(inspection: Inspection) -> Page:
    """Lay the chart out; hypotheses are ordered by the highest final probability that any model gives them."""
    highest = np.max([posterior[-1] for posterior in inspection.posteriors.values()], axis=0)
    order = np.argsort(-highest, kind="stable")[:_MOST_ROWS]
    longest = max(float(posterior.max()) for posterior in inspection.posteriors.values())
    chart = BarChart("posterior", tuple(inspection.posteriors), full_scale(longest))
    return Page(order, highest.size - order.size, chart)


def page_now(posteriors: Mapping[str, FloatArray]) -> Page:
    """Lay out a chart whose end is not known: all hypotheses in their order, or of many the most probable now.

    Args:
        posteriors: (K,) by model.
    """
    highest = np.max(list(posteriors.values()), axis=0)
    order = np.sort(np.argsort(-highest, kind="stable")[:_MOST_ROWS])
    return Page(order, highest.size - order.size, BarChart("posterior", tuple(posteriors), 1.0))


def log_now(recording: rr.RecordingStream, labels: Sequence[str], posteriors: Mapping[str, FloatArray]) -> None:
    """Log the chart of the posteriors as they are at the recording's time; arguments as in `page_now`."""
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
