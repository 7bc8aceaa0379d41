"""Stage: the grid-world studies of section 4."""

from __future__ import annotations

from pipeline.formats.parquet.tables import write_table
from pipeline.stages.registry import parameters
from pipeline.studies.grid_world.study import run_grid_world
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance


def run(project: Project) -> None:
    """Write grid_world.parquet and the grid_world tables that sum it up."""
    settings = project.params.studies.grid_world
    with recorded_run(project, "grid-world", STUDIES) as record:
        study = run_grid_world(settings, project.params.seed)
        tables = {
            "grid_world": study.trials,
            "grid_world_bandwidths": study.bandwidths,
            **{f"grid_world_{name}": table for name, table in vars(study.analysis).items()},
            **{f"grid_world_{name}": table for name, table in vars(study.examples).items()},
        }
        stated = provenance(project, parameters("grid-world"), [])
        for name, table in tables.items():
            write_table(project.table(STUDIES, name), name, table, stated)
        record.produced = f"{study.trials.height:,} posteriors of the true theta"
