"""Stage: the study of real trips, run by command where trips were imported."""

from __future__ import annotations

from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table, write_table
from pipeline.stages.registry import parameters, stage
from pipeline.studies.trips.roads import Roads
from pipeline.studies.trips.study import run_trips
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance


def run(project: Project) -> None:
    """Write the tables of the study.

    Raises:
        StageError: no trips were imported.
        ArgumentError: a model cannot be estimated.
    """
    inputs = [project.table(STUDIES, name) for name in stage("trips").reads]
    if missing := next((path for path in inputs if not path.is_file()), None):
        raise StageError(f"{missing}: there is no such table; import trips with `lessbench import trips FOLDER`")
    with recorded_run(project, "trips", STUDIES) as record:
        network, observed = (read_table(path, path.stem) for path in inputs)
        study = run_trips(Roads.of(network, observed), project.params.seed)
        stated = provenance(project, parameters("trips"), inputs)
        for name, table in vars(study).items():
            write_table(project.table(STUDIES, f"trips_{name}"), f"trips_{name}", table, stated)
        record.produced = f"{study.estimates.height} estimates, {study.held_out.height:,} held-out scores"
