"""Stage: the recording of the studies for the Rerun viewer, made from the tables alone."""

from __future__ import annotations

import polars as pl

from pipeline.formats.parquet.tables import read_table
from pipeline.views.findings import findings
from pipeline.views.rerun.studies import StudyTables, write_studies
from pipeline.vocabulary import LESS, LESS_HIDDEN_OWN_BANDWIDTH, STUDIES
from pipeline.workspace.project import Project, recorded_run


def run(project: Project) -> None:
    """Write inspect.rrd of the studies."""
    with recorded_run(project, "inspect", STUDIES, (project.datasets / STUDIES / "inspect.rrd",)) as record:
        path = project.datasets / STUDIES / "inspect.rrd"
        write_studies(path, study_tables(project))
        record.produced = f"{path.stat().st_size / 1e6:.1f} MB"


def study_tables(project: Project) -> StudyTables:
    """What the recording of the studies shows, from their tables.

    Raises:
        TableError: a table is missing or not what it should be.
    """
    grid = project.params.studies.grid_world
    return StudyTables(
        predictions=_table(project, "human_choice_predictions"),
        summary=_table(project, "grid_world_summary"),
        paths=_table(project, "grid_world_paths"),
        posteriors=_table(project, "grid_world_posteriors"),
        density_1d=_table(project, "grid_world_density_1d"),
        density_2d=_table(project, "grid_world_density_2d"),
        objects=grid.objects,
        size=grid.size,
        text=_text(project),
    )


def _table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table(STUDIES, name), name)


def _text(project: Project) -> str:
    found = findings(_table(project, "human_choice_tests"), _table(project, "grid_world_hypotheses"))
    bandwidths = dict(_table(project, "grid_world_bandwidths").iter_rows())
    grid = project.params.studies.grid_world
    lines = ["# Studies of the paper", ""]
    for row in found.iter_rows(named=True):
        lines += [f"**{row['hypothesis']}** {row['claim']}: **{row['outcome']}**. {row['numbers']}.", ""]
    lines += [
        f"Grid of {grid.size} x {grid.size} cells, beta {grid.beta:g}, {grid.demonstrations} paths per set, "
        f"{grid.seeds} sets per theta; bandwidth {bandwidths[LESS]:.4f} of the features' range, "
        f"{bandwidths[LESS_HIDDEN_OWN_BANDWIDTH]:.4f} selected anew.",
        "",
        "Tables: `datasets/studies/tables`; all numbers beside the paper's: `docs/results.md`.",
    ]
    return "\n".join(lines)
