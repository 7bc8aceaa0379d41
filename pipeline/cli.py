"""`lessbench`: run a stage for a task, look at what came out, ask it questions."""

from __future__ import annotations

import sys
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.sql import Format
from pipeline.errors import WorkbenchError
from pipeline.vocabulary import STUDIES

if TYPE_CHECKING:
    from pipeline.workspace.project import Project

app = typer.Typer(
    name="lessbench",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="What did this person want, and how sure can we be? Inference from demonstrations under competing models of "
    "choice.\n\n`dvc repro` runs all stages that are out of date; the commands below run one stage, or look at results.\n\n"
    "Example: `lessbench sql`, for a prompt that answers questions; `lessbench infer --help` explains a command; "
    "`lessbench --install-completion` makes Tab complete commands and tasks.",
)
STAGES, LOOK, SETUP = "Stages (what `dvc repro` calls)", "Look at results", "Bring your own"
importer = typer.Typer(no_args_is_help=True, help="Turn published demonstrations into MCAP recordings.")
app.add_typer(importer, name="import", rich_help_panel=SETUP)


def _tasks() -> list[str]:
    """For completion: the tasks of the project that the shell is in, or none."""
    try:
        return list(_project().params.tasks)
    except WorkbenchError:
        return []


def _tasks_and_studies() -> list[str]:
    return [*_tasks(), STUDIES]


TaskName = Annotated[str, typer.Argument(metavar="TASK", help="A task of params.yaml.", autocompletion=_tasks)]
TaskOrStudies = Annotated[
    str, typer.Argument(metavar="TASK", help="A task of params.yaml, or `studies`.", autocompletion=_tasks_and_studies)
]
IsLive = Annotated[bool, typer.Option("--live", help="Also serve the recording to Rerun viewers on this machine.")]
Port = Annotated[int, typer.Option(help="Of --live; 0 for any that is free.")]
Bind = Annotated[str, typer.Option(metavar="ADDRESS", help="Of --live: another address lets other machines see it.")]
Stay = Annotated[
    bool | None,
    typer.Option("--stay/--no-stay", help="Serve until Ctrl-C, as on a terminal, or end when done, as in a pipe."),
]


_overlay: ContextVar[Path | None] = ContextVar("overlay", default=None)


@app.callback()
def options(
    overlay: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML with the parameters that are different from params.yaml.")
    ] = None,
) -> None:
    """Keep what is said before the command."""
    _overlay.set(overlay)


def main() -> None:
    """Run the command line; a user's mistake ends in one sentence and exit status 1."""
    try:
        app()
    except WorkbenchError as error:
        print(f"lessbench: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    except BrokenPipeError:
        sys.exit(1)
    except OSError as error:
        if error.filename is None:
            raise
        print(f"lessbench: {error.filename}: {(error.strerror or str(error)).lower()}", file=sys.stderr)  # noqa: T201
        sys.exit(1)


@app.command(rich_help_panel=STAGES)
def simulate(task: TaskName) -> None:
    """Simulate the task's participants and write their recordings.

    Example: `lessbench simulate table`, with `simulate.participants` of params.yaml at 30 for thirty people.
    """
    from pipeline.stages.simulate import run

    run(_project(), task)


@app.command(rich_help_panel=STAGES)
def ingest(task: TaskName) -> None:
    """Read the task's recordings into demonstrations.parquet.

    Example: `lessbench ingest table`; what could not be used is in datasets/table/rejected.parquet.
    """
    from pipeline.stages.ingest import run

    run(_project(), task)


@app.command(rich_help_panel=STAGES)
def sample(task: TaskName) -> None:
    """Draw the sets of alternatives into alternatives.parquet.

    Example: `lessbench sample table`.
    """
    from pipeline.stages.sample import run

    run(_project(), task)


@app.command(rich_help_panel=STAGES)
def featurize(task: TaskName) -> None:
    """Replay every waypoint in MuJoCo and write features.parquet.

    Example: `lessbench featurize table`.
    """
    from pipeline.stages.featurize import run

    run(_project(), task)


@app.command(rich_help_panel=STAGES)
def density(task: TaskName) -> None:
    """Select each set's bandwidth and write densities.parquet and scales.parquet.

    Example: `lessbench density table`.
    """
    from pipeline.stages.density import run

    run(_project(), task)


@app.command(rich_help_panel=STAGES)
def infer(task: TaskName, live: IsLive = False, port: Port = 9876, bind: Bind = "127.0.0.1", stay: Stay = None) -> None:
    """Compute the posterior over theta and beta under every model into posteriors.parquet.

    `lessbench infer table --live` then writes inspect.rrd as well and serves it to Rerun viewers.

    Example: `lessbench infer table`, then `lessbench sql "from best_hypothesis where task = 'table'"`.
    """
    from pipeline.stages.infer import run

    if not live:
        return run(_project(), task)
    from pipeline.commands.serve import Live, run_and_serve
    from pipeline.stages import inspect

    return run_and_serve(_project(), task, Live(bind, port, stay), run, inspect.run)


@app.command(rich_help_panel=STAGES)
def shift(task: TaskName) -> None:
    """Draw sets of alternatives from different samplers into shifted_alternatives.parquet.

    Example: `lessbench shift table`, then `lessbench study robustness table`.
    """
    from pipeline.stages.shift import run

    run(_project(), task)


@app.command(rich_help_panel=STAGES)
def study(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="human-choice, grid-world or robustness.",
            autocompletion=lambda: ["human-choice", "grid-world", "robustness"],
        ),
    ],
    task: Annotated[
        str | None, typer.Argument(metavar="[TASK]", help="A task of params.yaml.", autocompletion=_tasks)
    ] = None,
) -> None:
    """Run one of the paper's experiments: `human-choice`, `grid-world`, or `robustness TASK`.

    Example: `lessbench study grid-world`, or `lessbench study robustness table`.
    """
    from pipeline.commands.study import run

    run(_project(), name, task)


@app.command(rich_help_panel=STAGES)
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
                _project(), task, Live(bind, port, stay), lambda project, _: inspect_studies.run(project)
            )
        return run_and_serve(_project(), task, Live(bind, port, stay), inspect.run)
    return inspect_studies.run(_project()) if task == STUDIES else inspect.run(_project(), task)


@app.command(rich_help_panel=STAGES)
def figures(task: TaskOrStudies) -> None:
    """Draw the figures of a task or of the studies, as SVG and PNG.

    Example: `lessbench figures table`; they are in datasets/table/figures.
    """
    from pipeline.stages.figures import run, run_studies

    return run_studies(_project()) if task == STUDIES else run(_project(), task)


@app.command(rich_help_panel=STAGES)
def catalog() -> None:
    """Gather all tables in datasets/catalog.duckdb.

    Example: `lessbench catalog`, then `lessbench sql`.
    """
    from pipeline.stages.catalog import run

    run(_project())


@app.command(rich_help_panel=STAGES)
def report() -> None:
    """Write datasets/report.html: one file with the results, their figures and how they were made.

    Example: `lessbench report`; open datasets/report.html in a browser, or print it.
    """
    from pipeline.stages.report import run

    run(_project())


@app.command(rich_help_panel=LOOK)
def sql(
    question: Annotated[
        str | None,
        typer.Argument(metavar="QUESTION", help="One SQL query (DuckDB's dialect); without it: a prompt."),
    ] = None,
    form: Annotated[
        Format, typer.Option("--format", help="How the answer is given; all but table go to other programs.")
    ] = (Format.table),
) -> None:
    """Ask the catalog a question; it is opened read-only, from any folder of the project.

    Without a question it opens a prompt on a terminal, and elsewhere says what there is to ask about.

    Example: `lessbench sql "from best_hypothesis where participant = 'all' and set_id = 'working'"`
    """
    from pipeline.commands.sql import HISTORY, answer_once, prompt

    project = _project()
    if question is None and form is Format.table and sys.stdin.isatty() and sys.stdout.isatty():
        prompt(project.catalog, project.root / HISTORY)
    else:
        answer_once(project.catalog, question, form)


@app.command(rich_help_panel=LOOK)
def view(task: TaskOrStudies) -> None:
    """Open the recording of a task or of the studies in the Rerun viewer.

    Example: `lessbench view table`, or `lessbench view studies`.
    """
    from pipeline.views.rerun.recording import open_viewer

    project = _project()
    if task != STUDIES:
        project.params.task(task)
    open_viewer(project.datasets / task / "inspect.rrd")


@app.command(rich_help_panel=LOOK)
def verify(
    task: Annotated[
        str | None, typer.Argument(metavar="[TASK]", help="A task of params.yaml, or `studies`; without it: all.")
    ] = None,
    sample: Annotated[int, typer.Option(min=0, help="How many trajectories and posteriors to compute again.")] = 20,
) -> None:
    """Ask whether the tables are what they say: recompute hashes, replay a sample. Exit status 1 if any is not.

    Example: `lessbench verify table --sample 100`
    """
    from pipeline.commands.verify import verify

    project = _project()
    sound = True
    for name in [task] if task else [*project.params.tasks, STUDIES]:
        found = verify(project, name, sample)
        print("\n".join(found.lines(name)))  # noqa: T201
        sound &= not found.drift
    if not sound:
        raise typer.Exit(1)


@app.command(rich_help_panel=LOOK)
def watch(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="Where recordings appear (default: those of the task).")
    ] = None,
    task: Annotated[
        str | None, typer.Option(help="A task of params.yaml; needed if there are several and FOLDER is of none.")
    ] = None,
    until: Annotated[int | None, typer.Option(min=1, help="End once so many demonstrations are in use.")] = None,
    idle_s: Annotated[
        float | None, typer.Option("--idle-s", min=0, help="End once nothing has come for so many seconds.")
    ] = None,
    live: IsLive = False,
    port: Port = 9876,
    bind: Bind = "127.0.0.1",
) -> None:
    """Take recordings in as they appear and say after each what is most probable; Ctrl-C ends.

    A recording counts once it is closed; one that cannot be used is named with its reason. What was found is kept in
    datasets/TASK/watch, and no other file is changed.

    Examples: `lessbench watch datasets/table/recordings --live`, `lessbench watch --task table --until 12`
    """
    from pipeline.commands.serve import Live
    from pipeline.commands.watch import Until, run

    run(_project(), folder, task, Until(until, idle_s), Live(bind, port) if live else None)


@app.command(rich_help_panel=LOOK)
def summary() -> None:
    """Say what each stage took and produced when it last ran.

    Example: `lessbench summary`.
    """
    from rich.console import Console
    from rich.table import Table

    from pipeline.workspace.project import recorded_runs

    table = Table("stage", "task", "took", "produced", title="Last run of each stage", title_justify="left")
    for run in recorded_runs(_project()):
        table.add_row(str(run["stage"]), str(run["task"]), f"{run['seconds']:.1f} s", str(run["produced"]))
    Console().print(table)


@app.command(rich_help_panel=SETUP)
def check(
    files: Annotated[list[Path], typer.Argument(metavar="RECORDING...", help="MCAP files.")],
    task: Annotated[str | None, typer.Option(help="Also ask whether the task's joints are in it.")] = None,
) -> None:
    """Say what each recording holds, whether it can be used, and if not why. Exit status 1 if any cannot.

    Example: `lessbench check my_recordings/*.mcap --task table`.
    """
    from pipeline.commands.check import report

    usable = True
    for path in files:
        lines, good = report(path, _project() if task else None, task)
        print("\n".join(lines))  # noqa: T201
        usable &= good
    if not usable:
        raise typer.Exit(1)


@app.command("new-task", rich_help_panel=SETUP)
def new_task(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the task: letters, digits, underscores.")],
    scene: Annotated[Path, typer.Option(help="MJCF file with a keyframe `start` (and `goal`).")],
    recordings: Annotated[Path, typer.Option(help="Folder of MCAP recordings.")],
    end_effector: Annotated[
        str | None, typer.Option(help="Body or site whose path matters; else the last body.")
    ] = None,
) -> None:
    """Write a task skeleton into params.yaml and say what to do next.

    Example: `lessbench new-task pour --scene my_scene.xml --recordings my_recordings`, then `dvc repro inspect@pour`.
    """
    from pipeline.commands.new_task import add_task

    print(add_task(_project(), name, scene, recordings, end_effector))  # noqa: T201


@app.command(rich_help_panel=SETUP)
def run(task: TaskName) -> None:
    """Run every stage of one task, from its recordings to its figures, whether or not it is out of date.

    Meant for parameters in a file of their own, which `dvc repro` does not see.

    Example: `lessbench --overlay mine.yaml run pour`.
    """
    from pipeline.commands.run import run_task

    run_task(_project(), task)


@app.command(rich_help_panel=SETUP)
def recover() -> None:
    """After DVC itself was killed: mend its own files, which it writes in place. `make repro` does this first.

    Example: `lessbench recover`, then `dvc repro`.
    """
    from pipeline.commands.recover import recover

    print("\n".join(recover(_project()) or ["nothing to mend"]))  # noqa: T201


@importer.command("ferl")
def import_ferl(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A pickle of the FERL or jaco_learning repository.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder that the recordings go into.")],
    joints: Annotated[
        str,
        typer.Option(help="What the columns are called, separated by commas: j2s7s300_joint_1,j2s7s300_joint_2,..."),
    ],
    topic: Annotated[str, typer.Option(help="Topic of the recordings.")] = "/joint_states",
    rate_hz: Annotated[float, typer.Option("--rate-hz", help="Nominal rate where the file has no times.")] = 10.0,
) -> None:
    """Turn Python 2 pickles of joint arrays into recordings, one per demonstration. Nothing in FILE is executed.

    Example for the JACO 2: `lessbench import ferl FERL_demos.p mine --topic /j2s7s300_driver/out/joint_state
    --joints j2s7s300_joint_1,j2s7s300_joint_2,j2s7s300_joint_3,j2s7s300_joint_4,j2s7s300_joint_5,j2s7s300_joint_6,j2s7s300_joint_7`
    """
    from pipeline.formats.ferl.importer import import_ferl

    written = import_ferl(file, out, [name.strip() for name in joints.split(",")], topic, rate_hz)
    print("\n".join(str(path) for path in written))  # noqa: T201


def _project() -> Project:
    from pipeline.workspace.project import find_project

    overlay = _overlay.get()
    return find_project(Path.cwd(), overlay.resolve() if overlay else None)
