"""Commands that run a stage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.grouping import STAGES, Commands
from pipeline.cli.shared import Bind, IsLive, Port, Stay, TaskName, TaskOrStudies, tasks, this_project
from pipeline.vocabulary import STUDIES

commands = Commands()


@commands.command(rich_help_panel=STAGES)
def scene(task: TaskName) -> None:
    """Look at the task's scene and write scene.json: its files, its compiled model, its joints.

    Example: `lessbench scene table`.
    """
    from pipeline.stages.scene import run

    run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def simulate(task: TaskName) -> None:
    """Simulate the task's participants and write their recordings.

    Example: `lessbench simulate table`, with `simulate.participants` of params.yaml at 30 for thirty people.
    """
    from pipeline.stages.simulate import run

    run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def ingest(task: TaskName) -> None:
    """Read the task's recordings into demonstrations.parquet.

    Example: `lessbench ingest table`; what could not be used is in datasets/table/tables/rejected.parquet.
    """
    from pipeline.stages.ingest import run

    run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def sample(task: TaskName) -> None:
    """Draw the sets of alternatives into alternatives.parquet.

    Example: `lessbench sample table`.
    """
    from pipeline.stages.sample import run

    run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def featurize(task: TaskName) -> None:
    """Replay every waypoint in MuJoCo and write features.parquet.

    Example: `lessbench featurize table`.
    """
    from pipeline.stages.featurize import run

    run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def density(task: TaskName) -> None:
    """Select each set's bandwidth and write densities.parquet and scales.parquet.

    Example: `lessbench density table`.
    """
    from pipeline.stages.density import run

    run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def infer(task: TaskName, live: IsLive = False, port: Port = 9876, bind: Bind = "127.0.0.1", stay: Stay = None) -> None:
    """Compute the posterior over theta and beta under every model (posteriors.parquet).

    Then it says the answer of the task, if that rests on the same tables, and else how to get it.
    `lessbench infer table --live` then writes inspect.rrd as well and serves it to Rerun viewers.

    Example: `lessbench infer table`, then `lessbench sql "from best_hypothesis where task = 'table'"`.
    """
    from pipeline.commands.answer import after_inference
    from pipeline.formats.files.parent_process import BY_DVC
    from pipeline.stages.infer import run

    if not live:
        run(this_project(), task)
        return None if BY_DVC else after_inference(this_project(), task)
    from pipeline.commands.serve import Live, run_and_serve
    from pipeline.stages import inspect

    return run_and_serve(this_project(), task, Live(bind, port, stay), run, inspect.run)


@commands.command(rich_help_panel=STAGES)
def explore(task: TaskName) -> None:
    """Explore the choice space until independent explorations agree (explored_posteriors.parquet).

    Example: `lessbench explore table`, then `lessbench enough table`.
    """
    from pipeline.stages.explore import run

    run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def shift(task: TaskName) -> None:
    """Draw sets of alternatives from different samplers (shifted_alternatives.parquet).

    Example: `lessbench shift table`, then `lessbench study robustness table`.
    """
    from pipeline.stages.shift import run

    run(this_project(), task)


def _studies() -> list[str]:
    """For completion."""
    from pipeline.commands.study import STUDIES

    return list(STUDIES)


@commands.command(rich_help_panel=STAGES)
def study(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="human-choice, grid-world, robustness, redraws, regimes, section-5 or trips.",
            autocompletion=_studies,
        ),
    ],
    task: Annotated[
        str | None, typer.Argument(metavar="[TASK]", help="A task of params.yaml.", autocompletion=tasks)
    ] = None,
    choices: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="With human-choice: analyse the choices in FILE. No table is changed."),
    ] = None,
) -> None:
    """Run a study: `human-choice`, `grid-world`, `robustness TASK`, `redraws TASK`, `regimes TASK`,
    `section-5`, or `trips`.

    Examples: `lessbench study grid-world`, `lessbench study robustness table`,
    `lessbench study human-choice --choices choices.csv`.
    """
    if choices is not None:
        if name != "human-choice":
            raise typer.BadParameter("--choices is for human-choice alone")
        from pipeline.commands.choices import told
        from pipeline.terminal import say

        for line in told(choices):
            say(line)
        return
    from pipeline.commands.study import run

    run(this_project(), name, task)


@commands.command(rich_help_panel=STAGES)
def conclude(task: TaskName) -> None:
    """Compute what people wanted, whether to trust it, and what they would do next (answers.parquet and others).

    Example: `lessbench conclude table`, then `lessbench answer table`.
    """
    from pipeline.stages.answer import run

    run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def inspect(
    task: TaskOrStudies, live: IsLive = False, port: Port = 9876, bind: Bind = "127.0.0.1", stay: Stay = None
) -> None:
    """Write inspect.rrd, the recording that `lessbench view` opens.

    `lessbench inspect table --live` also serves it: connect with `rerun rerun+http://127.0.0.1:9876/proxy`.

    Example: `lessbench inspect table`, then `lessbench view table`.
    """
    from pipeline.stages import inspect, inspect_studies

    if live:
        from pipeline.commands.serve import Live, run_and_serve

        if task == STUDIES:
            return run_and_serve(
                this_project(), task, Live(bind, port, stay), lambda project, _: inspect_studies.run(project)
            )
        return run_and_serve(this_project(), task, Live(bind, port, stay), inspect.run)
    return inspect_studies.run(this_project()) if task == STUDIES else inspect.run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def figures(task: TaskOrStudies) -> None:
    """Draw the figures of a task or of the studies, as SVG, PNG and PDF, each with its caption.

    Example: `lessbench figures table`; they are in datasets/table/figures.
    """
    from pipeline.stages import figures, figures_studies

    return figures_studies.run(this_project()) if task == STUDIES else figures.run(this_project(), task)


@commands.command(rich_help_panel=STAGES)
def catalog() -> None:
    """Gather all tables in datasets/catalog.duckdb.

    Example: `lessbench catalog`, then `lessbench sql`.
    """
    from pipeline.stages.catalog import run

    run(this_project())


@commands.command(rich_help_panel=STAGES)
def report() -> None:
    """Write datasets/report.html: one file with the results, their figures and how they were made.

    Example: `lessbench report`; open datasets/report.html in a browser, or print it.
    """
    from pipeline.stages.report import run

    run(this_project())
