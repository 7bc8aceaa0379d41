"""The posteriors of an inspection as a bar chart with a row per hypothesis and a column per model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.views.hypothesis_rows import MOST_ROWS, HypothesisRows, rows_that_matter
from pipeline.views.rerun.bar_chart import BarChart, full_scale, log_bars, log_frame, log_lines
from pipeline.views.rerun.timelines import at

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import rerun as rr

    from pipeline.arrays import FloatArray
    from pipeline.views.rerun.records import Inspection


@dataclass(frozen=True)
class Page:
    """The rows of the chart and its layout.

    Attributes:
        rows: the hypotheses that have a row.
        chart: columns and scale of the chart.
    """

    rows: HypothesisRows
    chart: BarChart

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Horizontal and vertical extent of the page."""
        return self.chart.bounds(self.rows.count)


def page(inspection: Inspection) -> Page:
    """Lay out the chart by what is believed after all demonstrations."""
    longest = max(float(posterior.max()) for posterior in inspection.posteriors.values())
    return Page(inspection.rows, _chart(inspection.posteriors, full_scale(longest)))


def page_now(posteriors: Mapping[str, FloatArray], truth: int | None = None) -> Page:
    """Lay out a chart whose final posteriors are not known yet, by what is believed now.

    Args:
        posteriors: for each model, (K,) probabilities.
        truth: the hypothesis nearest to the truth, if that is known.
    """
    return Page(rows_that_matter(posteriors, truth), _chart(posteriors, 1.0))


def bounds_of_any(models: Sequence[str], hypotheses: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Horizontal and vertical extent of a page that has room for as many rows as a chart may ever have."""
    return _chart(models, 1.0).bounds(min(MOST_ROWS + 1, hypotheses))


def log_now(
    recording: rr.RecordingStream,
    labels: Sequence[str],
    posteriors: Mapping[str, FloatArray],
    truth: int | None = None,
) -> None:
    """Log the chart of these posteriors at the recording's present time; arguments as in `page_now`."""
    layout = page_now(posteriors, truth)
    log_frame(recording, layout.chart, layout.rows.names(list(labels), truth), static=False)
    for column, probabilities in enumerate(posteriors.values()):
        values = layout.rows.values(probabilities)
        log_bars(recording, layout.chart, column, values, static=False, always=layout.rows.shared)


def log_posteriors(recording: rr.RecordingStream, inspection: Inspection) -> None:
    """Log the chart under `/posterior`; the bars change as the demonstrations are played."""
    layout = page(inspection)
    times = np.concatenate([inspection.replay.time_s[:1], inspection.end_s])
    log_frame(recording, layout.chart, layout.rows.names(inspection.theta_labels, inspection.nearest_truth))
    for column, posterior in enumerate(inspection.posteriors.values()):
        log_lines(recording, layout.chart, column, layout.rows.values(posterior[-1]), "final")
        for step, (time_s, probabilities) in enumerate(zip(times, posterior, strict=True)):
            at(recording, float(time_s), step)
            values = layout.rows.values(probabilities)
            log_bars(recording, layout.chart, column, values, static=False, always=layout.rows.shared)
    recording.reset_time()


def _chart(models: Iterable[str], full: float) -> BarChart:
    """Names and numbers stay readable where the view is half as wide as the page."""
    return BarChart("posterior", tuple(models), full, names_width=390.0, columns_width=400.0, row=34.0)
