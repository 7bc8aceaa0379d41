"""Stage: the page on section 5 of the paper, for the tasks whose sets were drawn again and again."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import polars as pl

from pipeline.errors import StageError
from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.parquet.tables import read_table
from pipeline.studies.robustness.redraws import INFERRED
from pipeline.views.figures.redraws import held_out_leads_figure, ratios_figure, standing_figure
from pipeline.views.figures.style import printed, write_figure
from pipeline.views.report.html import write_report
from pipeline.views.report.section_5 import TaskResults, section_5, standing
from pipeline.vocabulary import ALL, BATCH, EXPLORED, MIXTURE, SINGLE
from pipeline.workspace.project import Project, recorded_run

PAGE, FIGURES = "datasets/section_5.html", "datasets/studies/section_5_figures"
NEEDED = "redraws_leads"
EFFORT = "efficiency"  # the kind of feature


def run(project: Project) -> None:
    """Write datasets/section_5.html and its figures.

    Raises:
        StageError: no task has the tables of redrawn sets.
    """
    tasks = [name for name in project.params.tasks if project.table(name, NEEDED).is_file()]
    if not tasks:
        raise StageError(
            "no task of the parameters has redrawn sets; make them with `lessbench study redraws TASK`, and name the "
            "overlay if the tasks stand in one"
        )
    page, figures = project.path(PAGE), project.path(FIGURES)
    with recorded_run(project, "section-5", ALL, (page, figures)) as record:
        results = {name: _results(project, name) for name in tasks}
        with printed(project.params.figures), folder_written_whole(figures) as folder:
            _draw(folder, results)
        pictures = {path.stem: path.read_bytes() for path in sorted(figures.glob("*.svg"))}
        made_by = f"lessbench {version('lessbench')}, MuJoCo {version('mujoco')}, seed {project.params.seed}"
        size = write_report(page, section_5(results, pictures, made_by))
        record.produced = f"{len(tasks)} tasks, {size / 1e6:.1f} MB"


def _draw(folder: Path, results: dict[str, TaskResults]) -> None:
    if (points := standing(results)).height:
        write_figure(folder, "standing", standing_figure(points))
    for name, one in results.items():
        write_figure(folder, f"{name}_ratios", ratios_figure(one.leads.filter(demonstrations=SINGLE)))
        write_figure(folder, f"{name}_batch", ratios_figure(one.leads.filter(demonstrations=BATCH)))
        held_out = one.held_out_leads.filter(beta=INFERRED).filter(pl.col("sampler") != EXPLORED)
        if held_out.height:
            write_figure(folder, f"{name}_held_out", held_out_leads_figure(held_out))


def _results(project: Project, name: str) -> TaskResults:
    def table(which: str, *, needed: bool = False) -> pl.DataFrame:
        path = project.table(name, which)
        return read_table(path, which) if needed or path.is_file() else pl.DataFrame()

    leads = table(NEEDED, needed=True)
    samplers = leads["sampler"].unique(maintain_order=True).to_list()
    kinds = project.params.task(name).features.items()
    people = read_table(project.table(name, "demonstrations"), "demonstrations")
    return TaskResults(
        real=people["true_theta"].null_count() == people.height,
        anova=table("robustness_anova"),
        post_hoc=table("robustness_post_hoc"),
        leads=leads,
        held_out_leads=table("redraws_held_out_leads", needed=True),
        positions=table("redraws_positions", needed=True),
        draws_anova=table("redraws_anova"),
        default_sampler=MIXTURE if MIXTURE in samplers else samplers[0],
        effort=next((feature for feature, spec in kinds if spec["kind"] == EFFORT), None),
    )
