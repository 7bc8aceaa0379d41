"""Stage: the study of real trips, run by command where trips were imported."""

from __future__ import annotations

from concurrent.futures.process import BrokenProcessPool
from importlib.metadata import version

from pipeline.errors import StageError
from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.parquet.tables import read_table, write_table
from pipeline.stages.registry import parameters, stage
from pipeline.studies.trips.roads import Roads
from pipeline.studies.trips.study import run_trips
from pipeline.studies.trips.town_map import town_map
from pipeline.views.figures.style import printed, write_figure
from pipeline.views.figures.trips import routes_figure, samplers_figure, scores_figure
from pipeline.views.report.html import write_report
from pipeline.views.report.trips import trips_report
from pipeline.vocabulary import STUDIES
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance


def run(project: Project) -> None:
    """Write the tables of the study, its figures and its page, datasets/trips.html.

    Raises:
        StageError: no trips were imported, or a process that draws paths was ended from outside.
        ArgumentError: a model cannot be estimated.
    """
    inputs = [project.table(STUDIES, name) for name in stage("trips").reads]
    if missing := next((path for path in inputs if not path.is_file()), None):
        raise StageError(f"{missing}: there is no such table; import trips with `lessbench import trips FOLDER`")
    figures, page = (project.path(output) for output in stage("trips").outputs)
    with recorded_run(project, "trips", STUDIES, (figures, page)) as record:
        network, observed = (read_table(path, path.stem) for path in inputs)
        try:
            study = run_trips(
                Roads.of(network, observed), project.params.seed, tracked=lambda numbers: tracked(numbers, "samplings")
            )
        except BrokenProcessPool:
            raise StageError(
                "a process that draws paths was ended from outside, most often for lack of memory; close other "
                "programs and run it again"
            ) from None
        stated = provenance(project, parameters("trips"), inputs)
        town = town_map(network)
        for name, table in (vars(study) | {"map": town}).items():
            write_table(project.table(STUDIES, f"trips_{name}"), f"trips_{name}", table, stated)
        with printed(project.params.figures), folder_written_whole(figures) as folder:
            write_figure(folder, "scores", scores_figure(study.scores))
            write_figure(folder, "samplers", samplers_figure(study.angles))
            write_figure(folder, "routes", routes_figure(town, study.routes, study.route_links))
        pictures = {path.stem: path.read_bytes() for path in sorted(figures.glob("*.svg"))}
        made_by = f"lessbench {version('lessbench')}, seed {project.params.seed}"
        write_report(page, trips_report(vars(study), pictures, made_by))
        record.produced = f"{study.estimates.height} estimates, {study.held_out.height:,} held-out scores"
