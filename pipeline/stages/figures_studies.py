"""Stage: the figures of the studies, as SVG and PNG, and their headline numbers, from the tables alone."""

from __future__ import annotations

import polars as pl

from pipeline.formats.parquet.tables import read_table
from pipeline.views.figures.folder import write_figures
from pipeline.views.figures.grid_world import density_figure, overall_figure, sets_figure, true_posterior_figure
from pipeline.views.figures.human_choice import choices_figure
from pipeline.views.figures.style import printed
from pipeline.views.headline import studies_headline
from pipeline.views.intervals import with_mean_intervals, with_share_intervals
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project, recorded_run


def run(project: Project) -> None:
    """Write the figures and metrics.json of the human choice study and of the grid world."""
    grid = project.params.studies.grid_world
    with (
        recorded_run(project, "figures", STUDIES, (project.figures(STUDIES), project.metrics(STUDIES))) as record,
        printed(project.params.figures),
    ):
        summary = _table(project, "grid_world_summary")
        means = with_mean_intervals(summary)
        paths, posteriors = _table(project, "grid_world_paths"), _table(project, "grid_world_posteriors")
        of_one, of_two = _table(project, "grid_world_density_1d"), _table(project, "grid_world_density_2d")
        figures = {
            "human_choice": choices_figure(with_share_intervals(_table(project, "human_choice_predictions"))),
            "grid_world_true_posterior": true_posterior_figure(means),
            "grid_world_overall": overall_figure(means),
            "grid_world_sets": sets_figure(paths, posteriors, grid.objects, grid.size),
            "grid_world_density": density_figure(paths, of_one, of_two),
        }
        numbers = studies_headline(_table(project, "human_choice_tests"), summary)
        write_figures(project, STUDIES, figures, numbers)
        record.produced = f"{len(figures)} figures"


def _table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table(STUDIES, name), name)
