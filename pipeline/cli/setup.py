"""Commands for a project of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.shared import SETUP, TaskName, this_project
from pipeline.terminal import LONGEST_MESSAGE, plain, say

commands = typer.Typer()


@commands.command(rich_help_panel=SETUP)
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
        lines, good = report(path, this_project() if task else None, task)
        for line in lines:
            say(line)
        usable &= good
    if not usable:
        raise typer.Exit(1)


@commands.command("new-task", rich_help_panel=SETUP)
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

    for line in add_task(this_project(), name, scene, recordings, end_effector):
        say(line)


@commands.command(rich_help_panel=SETUP)
def run(task: TaskName) -> None:
    """Run every stage of one task, from its recordings to its figures, whether or not it is out of date.

    Meant for parameters in a file of their own, which `dvc repro` does not see.

    Example: `lessbench --overlay mine.yaml run pour`.
    """
    from pipeline.commands.run import run_task

    run_task(this_project(), task)


@commands.command("inspect-project", rich_help_panel=SETUP)
def inspect_project(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A project that came from elsewhere.")],
) -> None:
    """Look at a received project without running anything of it: what would run, what leads out of it, what is odd.

    Exit status 1 if there is any of that, 0 if nothing runs but the stages of this program.

    Example: `lessbench inspect-project received/`.
    """
    from pipeline.commands.inspect_project import inspect_project

    found = inspect_project(folder)
    for line in found.lines():
        say(plain(line, LONGEST_MESSAGE))
    if found.findings:
        raise typer.Exit(1)


@commands.command(rich_help_panel=SETUP)
def trust(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A project whose feature files you have read.")],
) -> None:
    """Let the feature files of a project run, as they are now; nothing of them is run by this.

    It is remembered outside of the project, for this folder, and ends for a file that changes.

    Example: `lessbench trust .`, after `lessbench inspect-project .`.
    """
    from pipeline.errors import ParameterError
    from pipeline.params import FILE
    from pipeline.workspace.project import Project
    from pipeline.workspace.trust import trust

    if not (folder / FILE).is_file():
        raise ParameterError(f"{folder}: is no project, as it has no {FILE}; name the folder of one")
    for line in trust(Project(folder.resolve())):
        say(plain(line, LONGEST_MESSAGE))


@commands.command(rich_help_panel=SETUP)
def recover() -> None:
    """After DVC itself was killed: mend its own files, which it writes in place. Also lets DVC work without git.

    `make repro` does this first.

    Example: `lessbench recover`, then `dvc repro`.
    """
    from pipeline.commands.recover import recover

    for line in recover(this_project()) or ["nothing to mend"]:
        say(line)
