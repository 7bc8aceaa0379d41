"""The paper's studies as a recording for the Rerun viewer: human choices, and inference in the grid world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import rerun as rr
import rerun.blueprint as rrb

from pipeline.studies.grid_world.trials import THETAS
from pipeline.views import palette
from pipeline.views.intervals import near_or_far, path_shifts
from pipeline.views.rerun.bar_chart import BarChart, log_bars, log_frame, log_lines
from pipeline.views.rerun.density import curve_bounds, curve_entity, log_curve, log_map, map_bounds
from pipeline.views.rerun.labels import drawable, log_labels
from pipeline.views.rerun.layout import page_view, text_view
from pipeline.views.rerun.recording import written_recording
from pipeline.views.task_summary import DensityCurve, DensityMap
from pipeline.vocabulary import BOLTZMANN, LESS, LESS_HIDDEN, LESS_HIDDEN_OWN_BANDWIDTH, STUDIES, model_name

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray

SET_NAMES = {"Xi_L": "Ξ_L", "Xi_B": "Ξ_B"}
PEOPLE = {
    LESS: f"TruePosterior: {model_name(LESS)} people",
    BOLTZMANN: f"{model_name(BOLTZMANN)} people",
    LESS_HIDDEN: model_name(LESS_HIDDEN),
    LESS_HIDDEN_OWN_BANDWIDTH: model_name(LESS_HIDDEN_OWN_BANDWIDTH),
}
_APART = 0.22  # largest distance between neighbouring paths, in cells
_GRID, _PATH = rr.Radius.ui_points(0.4), rr.Radius.ui_points(1.2)


@dataclass(frozen=True, eq=False)
class StudyTables:
    """The tables that the recording shows.

    Attributes:
        predictions: the table `human_choice_predictions`.
        summary: the table `grid_world_summary`.
        paths: the table `grid_world_paths`.
        posteriors: the table `grid_world_posteriors`.
        density_1d: the table `grid_world_density_1d`.
        density_2d: the table `grid_world_density_2d`.
        objects: cells of the grid world's objects.
        size: number of cells per side.
        text: the hypotheses and their numbers, in Markdown.
    """

    predictions: pl.DataFrame
    summary: pl.DataFrame
    paths: pl.DataFrame
    posteriors: pl.DataFrame
    density_1d: pl.DataFrame
    density_2d: pl.DataFrame
    objects: Sequence[tuple[int, int]]
    size: int
    text: str


def write_studies(path: Path, tables: StudyTables) -> None:
    """Write the recording with its layout, whole or not at all."""
    with written_recording(path, STUDIES, studies_layout(tables)) as recording:
        log_studies(recording, tables)


def log_studies(recording: rr.RecordingStream, tables: StudyTables) -> None:
    """Log all of the studies except their layout."""
    _log_choices(recording, tables.predictions)
    for people in PEOPLE:
        _log_true_posterior(recording, tables.summary, people)
    for name in SET_NAMES:
        _log_grid(recording, tables, name)
        _log_set_posterior(recording, tables.posteriors, name)
    for feature, curve in enumerate(_curves(tables), 1):
        log_curve(recording, curve, _of_sets(tables.paths, f"phi_{feature}"))
    log_map(recording, _map(tables), _of_sets(tables.paths, "phi_1", "phi_2"))
    text = rr.TextDocument(drawable(tables.text), media_type=rr.MediaType.MARKDOWN)
    recording.log("summary", text, static=True)


def _curves(tables: StudyTables) -> list[DensityCurve]:
    return [_curve(tables, feature) for feature in (1, 2)]


def studies_layout(tables: StudyTables) -> rrb.Blueprint:
    """The views of the studies."""
    curves, density = _curves(tables), _map(tables)
    inference = [
        page_view(f"true_posterior/{people}", name, _posterior_chart(tables.summary, people).bounds(len(THETAS) + 1))
        for people, name in PEOPLE.items()
    ]
    choice_chart, choice_names = _choice_chart(tables.predictions)
    choices = page_view(
        "human_choice", "Human choice: bar predicted, line observed", choice_chart.bounds(len(choice_names))
    )
    above = rrb.Horizontal(
        choices,
        rrb.Tabs(*inference, active_tab=0),
        text_view(),
        column_shares=[10, 15, 11],
    )
    sets = []
    for name, symbol in SET_NAMES.items():
        edge = (-1.2, tables.size + 0.2)
        sets.append(page_view(f"sets/{name}/grid", f"{symbol} on the grid", (edge, edge)))
        sets.append(
            page_view(
                f"sets/{name}/posterior",
                f"Inferred from {symbol}",
                _set_chart(tables.posteriors, name).bounds(len(THETAS)),
            )
        )
    densities = rrb.Tabs(
        page_view("map", "Density: φ1 across, φ2 up", map_bounds(density)),
        *(page_view(curve_entity(curve.feature), curve.feature, curve_bounds(curve)) for curve in curves),
        active_tab=0,
    )
    below = rrb.Horizontal(*sets, densities, column_shares=[6, 8, 6, 8, 8])
    return rrb.Blueprint(
        rrb.Vertical(above, below, row_shares=[50, 50]),
        rrb.TimePanel(state="hidden"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _choice_chart(predictions: pl.DataFrame) -> tuple[BarChart, list[str]]:
    models = tuple(predictions["model"].unique(maintain_order=True))
    rows = predictions.filter(pl.col("comparison") != "options", model=models[0])
    names = [
        row["group"] if row["comparison"] == "groups" else f"{row['option']} among {row['group']}"
        for row in rows.iter_rows(named=True)
    ]
    return BarChart("human_choice", models, 1.0, names_width=130.0, columns_width=330.0), names


def _log_choices(recording: rr.RecordingStream, predictions: pl.DataFrame) -> None:
    chart, names = _choice_chart(predictions)
    log_frame(recording, chart, names)
    for column, model in enumerate(chart.models):
        rows = predictions.filter(pl.col("comparison") != "options", model=model)
        log_bars(recording, chart, column, rows["predicted"].to_numpy(), static=True)
        log_lines(recording, chart, column, rows["observed"].fill_null(0.0).to_numpy(), "observed")


def _posterior_chart(summary: pl.DataFrame, people: str) -> BarChart:
    models = tuple(summary.filter(sampling_model=people)["inference_model"].unique(maintain_order=True))
    return BarChart(f"true_posterior/{people}", models, 1.0, names_width=130.0, columns_width=540.0)


def _log_true_posterior(recording: rr.RecordingStream, summary: pl.DataFrame, people: str) -> None:
    chart = _posterior_chart(summary, people)
    log_frame(recording, chart, [*_wishes(), "all"])
    for column, model in enumerate(chart.models):
        rows = summary.filter(sampling_model=people, inference_model=model).sort("theta_id", nulls_last=True)
        log_bars(recording, chart, column, rows["true_posterior"].to_numpy(), static=True)


def _set_chart(posteriors: pl.DataFrame, name: str) -> BarChart:
    models = tuple(posteriors.filter(set=name)["inference_model"].unique(maintain_order=True))
    return BarChart(f"sets/{name}/posterior", models, 1.0, names_width=140.0, columns_width=240.0)


def _log_set_posterior(recording: rr.RecordingStream, posteriors: pl.DataFrame, name: str) -> None:
    chart = _set_chart(posteriors, name)
    of_set = posteriors.filter(set=name)
    true = of_set.filter(inference_model=chart.models[0])["is_true"]
    log_frame(
        recording, chart, [f"true: {wish}" if is_true else wish for wish, is_true in zip(_wishes(), true, strict=True)]
    )
    for column, model in enumerate(chart.models):
        log_bars(recording, chart, column, of_set.filter(inference_model=model)["posterior"].to_numpy(), static=True)


def _wishes() -> list[str]:
    return [", ".join(words).replace("far from", "far") for words in near_or_far(THETAS)]


def _log_grid(recording: rr.RecordingStream, tables: StudyTables, name: str) -> None:
    """Log the grid of a set with its paths. Rows of a page run downwards, so y is counted from the bottom."""
    entity, size = f"sets/{name}/grid", tables.size
    paths = tables.paths.filter(set=name)
    edges = np.arange(size + 1) - 0.5
    rules = [[(edge, -0.5), (edge, size - 0.5)] for edge in edges] + [
        [(-0.5, edge), (size - 0.5, edge)] for edge in edges
    ]
    recording.log(
        f"{entity}/lines", rr.LineStrips2D(rules, radii=_GRID, colors=palette.GROUND, draw_order=0.0), static=True
    )
    strips = [
        np.stack([x.to_numpy() + shift, size - 1 - y.to_numpy() + shift], axis=1)
        for shift, x, y in zip(path_shifts(paths.height, _APART), paths["x"], paths["y"], strict=True)
    ]
    lines = rr.LineStrips2D(strips, radii=_PATH, colors=palette.SETS[name], draw_order=1.0)
    recording.log(f"{entity}/demonstrations", lines, static=True)
    marks = [(x, size - 1 - y) for x, y in tables.objects] + [(0, size - 1), (size - 1, 0)]
    colors = [palette.GREY, palette.GREY, palette.WHITE, palette.WHITE]
    boxes = rr.Boxes2D(centers=marks, half_sizes=[(0.3, 0.3)] * 4, colors=colors, draw_order=2.0)
    recording.log(f"{entity}/objects", boxes, static=True)
    log_labels(recording, f"{entity}/names", np.array(marks) + np.array([0.0, 0.3]), ["A", "B", "start", "goal"])


def _of_sets(paths: pl.DataFrame, *columns: str) -> dict[str, tuple[FloatArray, palette.RGB]]:
    """The values of each set with its colour: (n,) for one column, (n, 2) for two."""
    marks = {}
    for name, symbol in SET_NAMES.items():
        values = paths.filter(set=name).select(columns).to_numpy()
        marks[symbol] = (values if len(columns) > 1 else values[:, 0], palette.SETS[name])
    return marks


def _curve(tables: StudyTables, feature: int) -> DensityCurve:
    rows = tables.density_1d.filter(feature=feature)
    return DensityCurve(
        feature=f"φ{feature}, mean distance to {'AB'[feature - 1]}",
        unit="range",
        grid=_centres(rows["low"], rows["high"]),
        raw=rows["raw"].to_numpy(),
        adjusted=rows["adjusted"].to_numpy(),
        demonstrations=np.empty(0),
    )


def _map(tables: StudyTables) -> DensityMap:
    rows = tables.density_2d.sort("phi_1_low", "phi_2_low")
    x, y = (
        _centres(edges["phi_low"], edges["phi_high"])
        for edges in (
            rows.select(phi_low=f"phi_{f}_low", phi_high=f"phi_{f}_high").unique().sort("phi_low") for f in (1, 2)
        )
    )
    values = rows["raw"].to_numpy().reshape(x.size, y.size).T
    return DensityMap(("φ1", "φ2"), ("range", "range"), x, y, values, np.empty((0, 2)))


def _centres(low: pl.Series, high: pl.Series) -> FloatArray:
    centres: FloatArray = (low.to_numpy() + high.to_numpy()) / 2
    return centres
