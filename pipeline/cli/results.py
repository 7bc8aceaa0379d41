"""Commands that look at results."""

from __future__ import annotations

import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.grouping import ASK, LOOK, TRUST, Commands
from pipeline.cli.shared import AsJson, Bind, IsLive, Port, TaskName, TaskOrStudies, tasks, this_project
from pipeline.commands.sql.answers import MOST_ROWS, ROWS_ELSEWHERE, ROWS_ON_TERMINAL, Format
from pipeline.terminal import say, say_json
from pipeline.vocabulary import LESS, STUDIES

commands = Commands()


@commands.command(rich_help_panel=ASK)
def sql(
    question: Annotated[
        str | None,
        typer.Argument(metavar="QUESTION", help="One query, in DuckDB's SQL. Without it: a prompt."),
    ] = None,
    form: Annotated[
        Format | None,
        typer.Option("--format", metavar="FORMAT", help="table, csv, json or parquet. All but table hold all rows."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write to FILE. Its ending says the format."),
    ] = None,
    rows: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_ROWS,
            metavar="NUMBER",
            help=f"Rows of a table (default: {ROWS_ON_TERMINAL}; {ROWS_ELSEWHERE:,} in a pipe or a file).",
        ),
    ] = None,
    formulas: Annotated[
        bool,
        typer.Option(
            "--formulas/--no-formulas",
            help="With CSV: keep texts that a spreadsheet would take for formulas as they are, or mark them as text.",
        ),
    ] = True,
) -> None:
    """Ask the catalog a question in SQL. It is opened read-only.

    Without a question it opens a prompt. In a pipe it lists what there is to ask about instead. A table shows the
    first rows and how many there are. The other formats hold all rows.

    Example: `lessbench sql "from best_hypothesis where participant = 'all' and set_id = 'working'"`
    """
    from pipeline.commands.sql.answers import Wanted, answer_once

    project = this_project()
    if question is None and form is None and output is None and sys.stdin.isatty() and sys.stdout.isatty():
        from pipeline.commands.sql.prompt import HISTORY, prompt

        prompt(project.catalog, project.root / HISTORY)
    else:
        answer_once(project.catalog, question, Wanted(form, output, rows, formulas))


@commands.command(rich_help_panel=LOOK)
def answer(
    task: Annotated[
        str | None,
        typer.Argument(metavar="[TASK]", help="A task of params.yaml; without it: all.", autocompletion=tasks),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say in ten lines what people wanted, how sure that is, and whether to trust it.

    Example: `lessbench answer table`; docs/answers.md has the rules.
    """
    from pipeline.commands.answer import run

    run(this_project(), task, as_json)


@commands.command(rich_help_panel=LOOK)
def plan(
    task: TaskName,
    person: Annotated[
        str | None, typer.Option("--for", metavar="PERSON", help="Plan for this participant. Default: for someone new.")
    ] = None,
    model: Annotated[str, typer.Option(help="Use the weights of this model: less or boltzmann.")] = LESS,
    contacts: Annotated[
        bool,
        typer.Option(
            "--contacts/--no-contacts",
            help="With --contacts, plan a motion that touches nothing; else ignore contacts.",
        ),
    ] = True,
) -> None:
    """Plan the motion that people would like best, and write it for a controller into datasets/TASK/plan.

    plan.mcap has it as JointTrajectory and JointState, plan.csv as a table, plan.rrd for the viewer.

    Example: `lessbench plan table`, or `lessbench plan table --for participant-03`.
    """
    from pipeline.commands.plan import Wanted, run

    run(this_project(), task, Wanted(person, model, contacts))


@commands.command(rich_help_panel=TRUST)
def calibrate(
    task: TaskName,
    demonstrations: Annotated[
        int | None,
        typer.Option(min=1, help="How many demonstrations a simulated person gives. Default: as many as the task has."),
    ] = None,
    repetitions: Annotated[int, typer.Option(min=1, max=10_000, help="For each model.")] = 100,
) -> None:
    """Simulate people with known weights, and say what this number of demonstrations can tell.

    Could they tell LESS from Boltzmann, and one set of weights from another? A hundred repetitions take half a minute.
    Rank histograms, which say whether the inference is calibrated, go into datasets/TASK/calibration. They need 50
    repetitions.

    Example: `lessbench calibrate table --demonstrations 30`
    """
    from pipeline.commands.calibrate import Wanted, run

    run(this_project(), task, Wanted(demonstrations, repetitions))


@commands.command(rich_help_panel=LOOK)
def export(
    task: TaskName,
    to: Annotated[str, typer.Option("--to", metavar="FORM", help="mcap, parquet, csv, lerobot or arviz.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder to write. Default: datasets/TASK/FORM."),
    ] = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Write the plan of `lessbench plan` instead of demonstrations.")
    ] = False,
    rate_hz: Annotated[
        int | None,
        typer.Option(
            "--hz", min=1, max=1000, metavar="NUMBER", help="Poses per second. Default: the waypoints as they are."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace FOLDER with all that is in it.")] = False,
) -> None:
    """Write a task's demonstrations, its plan or the draws of its weights for other programs.

    mcap: a recording of each motion, JointState in CDR. parquet, csv: a table with a column for each joint. lerobot: a
    dataset of format v3.0 at 30 Hz. arviz: the draws of the weights, for `arviz.from_json`.

    Example: `lessbench export table --to lerobot`, or `lessbench export table --to csv --plan -o plan_for_us`.
    """
    from pipeline.commands.export import Wanted, export

    export(this_project(), task, Wanted(to, output, plan, rate_hz, force))


@commands.command(rich_help_panel=LOOK)
def compare(
    first: Annotated[
        str,
        typer.Argument(metavar="A", help="A folder, a file of parameters (overlay), a git revision or an experiment."),
    ],
    second: Annotated[str, typer.Argument(metavar="B", help="Likewise; `.` is this project as it is now.")],
    task: Annotated[str | None, typer.Option(metavar="TASK", help="Only this task.", autocompletion=tasks)] = None,
    recording: Annotated[
        bool, typer.Option("--recording/--no-recording", help="Whether the posteriors go into .lessbench/compare.rrd.")
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Put two versions of the results side by side: parameters that differ, answers, posteriors in one recording.

    Example: `lessbench compare HEAD~1 .`, or `lessbench compare before narrow --task table`; see docs/compare.md.
    """
    from pipeline.commands.compare import Wanted, run

    run(this_project(), Wanted(first, second, task, recording, as_json))


@commands.command(rich_help_panel=LOOK)
def view(task: TaskOrStudies) -> None:
    """Open the recording of a task or of the studies in the Rerun viewer.

    Example: `lessbench view table`, or `lessbench view studies`.
    """
    from pipeline.views.rerun.recording import open_viewer

    project = this_project()
    if task != STUDIES:
        project.params.task(task)
    open_viewer(project.datasets / task / "inspect.rrd")


@commands.command(rich_help_panel=TRUST)
def verify(
    task: Annotated[
        str | None, typer.Argument(metavar="[TASK]", help="A task of params.yaml, or `studies`; without it: all.")
    ] = None,
    sample: Annotated[int, typer.Option(min=0, help="How many trajectories and posteriors to compute again.")] = 20,
    as_json: AsJson = False,
) -> None:
    """Check that no table has changed since it was computed. Exit status 1 if one has.

    It compares hashes, reads recordings again, and computes a sample of the values again.

    Example: `lessbench verify table --sample 100`
    """
    from pipeline.commands.verify import verify, verify_project

    project = this_project()
    names = [task] if task else [*project.params.tasks, STUDIES]
    looked = [(name, partial(verify, project, name, sample)) for name in names]
    if task is None:
        looked.append(("catalog and report", partial(verify_project, project)))
    everything = {}
    for name, look in looked:
        everything[name] = found = look()
        if not as_json:
            for line in found.lines(name):
                say(line)
    if as_json:
        say_json({name: asdict(found) for name, found in everything.items()})
    if any(found.drift for found in everything.values()):
        raise typer.Exit(1)


@commands.command(rich_help_panel=TRUST)
def enough(
    task: TaskName,
    tolerance: Annotated[
        float | None,
        typer.Option(min=1e-6, help="Divergence (nats per pair) that counts as agreement. Default: explore.tolerance."),
    ] = None,
    degrees: Annotated[
        float,
        typer.Option(
            min=0.1, max=90.0, help="How wide the posterior of all demonstrations together may be, in degrees."
        ),
    ] = 20.0,
    as_json: AsJson = False,
) -> None:
    """Say whether more evaluations, alternatives or demonstrations would change a task's answer, and how many.

    Example: `lessbench enough table`, or `lessbench enough table --tolerance 0.05 --json`
    """
    from pipeline.commands import enough

    found = enough.enough(this_project(), task, tolerance, degrees)
    if as_json:
        say_json(enough.as_json(found))
    else:
        enough.report(found)


@commands.command(rich_help_panel=LOOK)
def watch(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="Where recordings appear (default: those of the task).")
    ] = None,
    task: Annotated[
        str | None, typer.Option(help="A task of params.yaml. Needed if FOLDER belongs to no task.")
    ] = None,
    until: Annotated[int | None, typer.Option(min=1, help="End when this many demonstrations are in use.")] = None,
    idle_s: Annotated[
        float | None, typer.Option("--idle-s", min=0, help="End after this many seconds without a new recording.")
    ] = None,
    live: IsLive = False,
    port: Port = 9876,
    bind: Bind = "127.0.0.1",
    as_json: AsJson = False,
) -> None:
    """Read recordings as they appear, and say after each one what is most probable. Ctrl-C ends.

    A recording counts once it is closed. One that cannot be used is named, with the reason. Results go into
    datasets/TASK/watch; no other file is changed.

    Examples: `lessbench watch datasets/table/recordings --live`, `lessbench watch --task table --until 12`
    """
    from pipeline.commands.serve import Live
    from pipeline.commands.watch.session import Until, run

    run(this_project(), folder, task, Until(until, idle_s), Live(bind, port) if live else None, as_json)


@commands.command(rich_help_panel=LOOK)
def summary(as_json: AsJson = False) -> None:
    """Say how long each stage took when it last ran, and what it produced.

    Example: `lessbench summary`.
    """
    from rich.table import Table

    from pipeline.terminal import cell, show
    from pipeline.workspace.project import recorded_runs

    runs = recorded_runs(this_project())
    if as_json:
        say_json(runs)
        return
    if not runs:
        say("no stage has run yet; `dvc repro` runs all of them")
        return
    table = Table("stage", "task", "took", "produced", title="Last run of each stage", title_justify="left")
    for run in runs:
        words = (str(run["stage"]), str(run["task"]), f"{run['seconds']:.1f} s", str(run["produced"]))
        table.add_row(*map(cell, words))
    show(table)
