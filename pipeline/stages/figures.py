"""Stage: the figures of a task, or of the studies, as SVG and PNG, and its headline numbers, from the tables alone."""

from __future__ import annotations

from collections.abc import Mapping

import polars as pl

from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.files.json_metrics import write_metrics
from pipeline.formats.parquet.tables import read_table
from pipeline.studies.robustness.samplings import COMPARED
from pipeline.views.figures.grid_world import density_figure, overall_figure, sets_figure, true_posterior_figure
from pipeline.views.figures.held_out import held_out_figure
from pipeline.views.figures.human_choice import choices_figure
from pipeline.views.figures.robustness import (
    accuracy_figure,
    duplicates_figure,
    importance_figure,
    kl_figure,
    sensitivity_figure,
    two_posteriors_figure,
)
from pipeline.views.figures.style import Figure, write_figure
from pipeline.views.figures.task import densities_figure, map_figure, posterior_figure
from pipeline.views.headline import Numbers, studies_headline, task_headline
from pipeline.views.intervals import compare_models, differences, with_mean_intervals, with_share_intervals
from pipeline.views.robustness import accuracy, entropies, example, middle_size
from pipeline.views.task_view import task_view
from pipeline.vocabulary import KNOWN_DENSITY, STUDIES, WORKING
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project, recorded_run

ROBUSTNESS = (
    "robustness", "robustness_summary", "robustness_sets", "robustness_posteriors", "sensitivity", "sensitivity_summary",
    "duplicates_summary",
)  # fmt: skip


def run(project: Project, name: str) -> None:
    """Write the figures and metrics.json of the task `name`."""
    project.params.task(name)
    with recorded_run(project, "figures", name) as record:
        view = task_view(project, name)
        final = {model: steps[-1].marginal_theta for model, steps in view.beliefs.items()}
        figures = {
            "densities": densities_figure(view.curves),
            "density_map": map_figure(view.map),
            "posterior": posterior_figure(final, view.labels, view.meaning),
        }
        held_out = read_table(project.table(name, "held_out"), "held_out").filter(set_id=WORKING)
        if held_out.height:
            figures["held_out"] = held_out_figure(held_out, compare_models(held_out), differences(held_out))
        tables: dict[str, pl.DataFrame] = {}
        if project.table(name, ROBUSTNESS[0]).exists():
            tables = {table: read_table(project.table(name, table), table) for table in ROBUSTNESS}
            figures |= _robustness(tables, view.labels, view.meaning)
        else:
            record.notes.append(f"no robustness study yet, so none of its figures: lessbench study robustness {name}")
        recordings = view.demonstrations.height, read_table(project.table(name, "rejected"), "rejected").height
        beliefs = {model: steps[-1] for model, steps in view.beliefs.items()}
        numbers = task_headline(beliefs, view.labels, held_out, tables.get("robustness_summary"), recordings)
        record.produced = _write(project, name, figures, numbers)


def run_studies(project: Project) -> None:
    """Write the figures and metrics.json of the human choice study and of the grid world."""
    grid = project.params.studies.grid_world
    with recorded_run(project, "figures", STUDIES) as record:
        tables = {
            name: read_table(project.table(STUDIES, f"grid_world_{name}"), f"grid_world_{name}")
            for name in ("summary", "paths", "posteriors", "density_1d", "density_2d")
        }
        predictions = read_table(project.table(STUDIES, "human_choice_predictions"), "human_choice_predictions")
        summary = with_mean_intervals(tables["summary"])
        figures = {
            "human_choice": choices_figure(with_share_intervals(predictions)),
            "grid_world_true_posterior": true_posterior_figure(summary),
            "grid_world_overall": overall_figure(summary),
            "grid_world_sets": sets_figure(tables["paths"], tables["posteriors"], grid.objects, grid.size),
            "grid_world_density": density_figure(tables["paths"], tables["density_1d"], tables["density_2d"]),
        }
        tests = read_table(project.table(STUDIES, "human_choice_tests"), "human_choice_tests")
        record.produced = _write(project, STUDIES, figures, studies_headline(tests, tables["summary"]))


def _robustness(tables: Mapping[str, pl.DataFrame], labels: tuple[str, ...], meaning: str) -> dict[str, Figure]:
    truth = accuracy(tables["robustness"])
    shown = example(tables["robustness_posteriors"])
    size = middle_size(tables["sensitivity"])
    summary, sets = tables["robustness_summary"], tables["robustness_sets"]
    figures = {
        "robustness": kl_figure(summary),
        "two_posteriors": two_posteriors_figure(shown.posteriors, shown.set_ids, labels, meaning),
        "duplicates": duplicates_figure(tables["duplicates_summary"]),
        "sensitivity": sensitivity_figure(
            tables["sensitivity_summary"].filter(set_size=size), entropies(tables["sensitivity"].filter(set_size=size))
        ),
    }
    if KNOWN_DENSITY in summary["regime"]:
        alike = pl.col("model").is_in(COMPARED)
        figures["importance"] = importance_figure(summary.filter(alike), truth.filter(alike), sets)
    if truth.height:
        figures["accuracy"] = accuracy_figure(truth, len(labels))
    return figures


def _write(project: Project, name: str, figures: Mapping[str, Figure], numbers: Numbers) -> str:
    with folder_written_whole(project.figures(name)) as partial:
        for title, figure in tracked(list(figures.items()), f"figures {name}"):
            write_figure(partial, title, figure)
    write_metrics(project.metrics(name), numbers)
    return f"{len(figures)} figures"
