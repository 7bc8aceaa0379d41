"""Stage: the figures of a task, as SVG and PNG, and its headline numbers, from the tables alone."""

from __future__ import annotations

import polars as pl

from pipeline.formats.mcap.rejection_reasons import SET_ASIDE
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.studies.robustness.samplings import COMPARED
from pipeline.views.figures.folder import write_figures
from pipeline.views.figures.held_out import held_out_figure
from pipeline.views.figures.robustness import (
    accuracy_figure,
    duplicates_figure,
    importance_figure,
    kl_figure,
    sensitivity_figure,
    two_posteriors_figure,
)
from pipeline.views.figures.style import Figure
from pipeline.views.figures.task import densities_figure, map_figure, posterior_figure
from pipeline.views.headline import task_headline
from pipeline.views.intervals import compare_models, differences
from pipeline.views.robustness import Example, accuracy, entropies, example, middle_size
from pipeline.views.task_view import INPUTS, task_view
from pipeline.vocabulary import ALL, KNOWN_DENSITY, WORKING
from pipeline.workspace.project import Project, recorded_run

ROBUSTNESS = (
    "robustness", "robustness_summary", "robustness_sets", "robustness_posteriors", "sensitivity",
    "sensitivity_summary",
    "duplicates_summary",
)  # fmt: skip


def run(project: Project, name: str) -> None:
    """Write the figures and metrics.json of the task `name`."""
    project.params.task(name)
    with (
        recorded_run(project, "figures", name, (project.figures(name), project.metrics(name))) as record,
        TaskTables(project.tables(name, INPUTS)) as inputs,
        TaskTables(project.tables(name, ("held_out", "rejected", *ROBUSTNESS))) as results,
    ):
        view = task_view(inputs, project.table(name, "explored_posteriors"))
        final = {model: steps[-1].marginal_theta for model, steps in view.beliefs.items()}
        figures = {
            "densities": densities_figure(view.curves),
            "density_map": map_figure(view.map),
            "posterior": posterior_figure(final, view.labels, view.meaning, view.over),
        }
        held_out = results["held_out"].read(where=pl.col("set_id") == WORKING)
        if held_out.height:
            figures["held_out"] = held_out_figure(held_out, compare_models(held_out), differences(held_out))
        summary = None
        if project.table(name, ROBUSTNESS[0]).exists():
            figures |= _robustness(results, view.labels, view.meaning)
            summary = results["robustness_summary"].read()
        else:
            record.notes.append(f"no robustness study yet, so none of its figures: lessbench study robustness {name}")
        rejected = results["rejected"].read(where=~pl.col("reason").is_in(sorted(SET_ASIDE))).height
        recordings = view.demonstrations.height, rejected
        beliefs = {model: steps[-1] for model, steps in view.beliefs.items()}
        numbers = task_headline(beliefs, view.labels, held_out, summary, recordings, view.fits, view.resting_on)
        write_figures(project, name, figures, numbers)
        record.produced = f"{len(figures)} figures"


def _robustness(tables: TaskTables, labels: tuple[str, ...], meaning: str) -> dict[str, Figure]:
    truth = accuracy(tables["robustness"].read())
    shown = _example(tables["robustness_posteriors"])
    sensitivity = tables["sensitivity"].read()
    size = middle_size(sensitivity)
    summary, sets = tables["robustness_summary"].read(), tables["robustness_sets"].read()
    figures = {
        "robustness": kl_figure(summary),
        "two_posteriors": two_posteriors_figure(shown.posteriors, shown.set_ids, labels, meaning),
        "duplicates": duplicates_figure(tables["duplicates_summary"].read()),
        "sensitivity": sensitivity_figure(
            tables["sensitivity_summary"].read(where=pl.col("set_size") == size),
            entropies(sensitivity.filter(set_size=size)),
        ),
    }
    if KNOWN_DENSITY in summary["regime"]:
        alike = pl.col("model").is_in(COMPARED)
        figures["importance"] = importance_figure(summary.filter(alike), truth.filter(alike), sets)
    if truth.height:
        figures["accuracy"] = accuracy_figure(truth, len(labels))
    return figures


def _example(posteriors: OpenTable) -> Example:
    """The example of a table that may be large: only the rows that it shows are read in full."""
    size = middle_size(posteriors.read(["set_size"]))
    first = posteriors.part(0, ["demonstration_id"]).filter(pl.col("demonstration_id") != ALL).item(0, 0)
    return example(posteriors.read(where=(pl.col("set_size") == size) & (pl.col("demonstration_id") == first)))
