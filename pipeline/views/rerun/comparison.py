"""Posteriors of two versions of a task in one recording: they sharpen in step as demonstrations come in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import rerun.blueprint as rrb

from pipeline.views.hypothesis_rows import rows_that_matter
from pipeline.views.rerun.bar_chart import BarChart, full_scale, log_bars, log_frame, log_lines
from pipeline.views.rerun.layout import page_view
from pipeline.views.rerun.recording import written_recording
from pipeline.views.rerun.timelines import DEMONSTRATIONS
from pipeline.vocabulary import model_name

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from pipeline.arrays import FloatArray
    from pipeline.views.hypothesis_rows import HypothesisRows


@dataclass(frozen=True)
class Compared:
    """A task in two versions.

    Attributes:
        task: its name.
        labels: (K,) the hypotheses in words.
        versions: the two names.
        beliefs: for each model and each of the two versions, (n + 1, K) the posterior over theta before any
            demonstration and after each.
    """

    task: str
    labels: tuple[str, ...]
    versions: tuple[str, str]
    beliefs: Mapping[str, tuple[FloatArray, FloatArray]]


def write_comparison(path: Path, compared: Sequence[Compared]) -> None:
    """Write a recording with a page for each task and model, a column for each version, whole or not at all.

    The bars are the posterior after as many demonstrations as the timeline says. The white line in a column is the bar
    of the other version, so that both can be seen on one another.
    """
    charts = [(one, model, _chart(one, model)) for one in compared for model in one.beliefs]
    views = [
        page_view(
            chart.entity,
            f"{one.task}: {model_name(model)} (white line: the other)",
            chart.bounds(_rows(one.beliefs[model]).count),
        )
        for one, model, chart in charts
    ]
    name = "compare " + " ".join(one.task for one in compared)
    with written_recording(path, name, rrb.Blueprint(rrb.Tabs(*views), collapse_panels=True)) as recording:
        for one, model, chart in charts:
            pair = one.beliefs[model]
            rows = _rows(pair)
            log_frame(recording, chart, rows.names(one.labels))
            for step in range(max(map(len, pair))):
                recording.set_time(DEMONSTRATIONS, sequence=step)
                values = [rows.values(steps[min(step, len(steps) - 1)]) for steps in pair]
                for column in (0, 1):
                    log_bars(recording, chart, column, values[column], static=False, always=rows.shared)
                    log_lines(recording, chart, column, values[1 - column], "other", static=False)
            recording.reset_time()


def _chart(one: Compared, model: str) -> BarChart:
    pair = one.beliefs[model]
    longest = max(float(steps.max()) for steps in pair)
    return BarChart(f"{one.task}/{model}", one.versions, full_scale(longest))


def _rows(pair: tuple[FloatArray, FloatArray]) -> HypothesisRows:
    """The hypotheses that have a row, by the larger of their two final probabilities."""
    return rows_that_matter({version: steps[-1] for version, steps in zip("ab", pair, strict=True)})
