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
    recordings: Annotated[Path, typer.Option(help="Folder of recordings.")],
    scene: Annotated[
        Path | None, typer.Option(help="MJCF or URDF file, with keyframes `start` and `goal` if there are any.")
    ] = None,
    end_effector: Annotated[
        str | None, typer.Option(help="Body or site whose path matters; else the hand of the arm.")
    ] = None,
    joint: Annotated[
        list[str] | None, typer.Option(help="A joint of the arm, in order, once for each; else they are proposed.")
    ] = None,
    joint_name: Annotated[
        list[str] | None,
        typer.Option(metavar="RECORDED=SCENE", help="What the scene calls a joint of the recordings; once for each."),
    ] = None,
) -> None:
    """Propose a task from a scene and recordings, write it into params.yaml, and say what was chosen and what is odd.

    Nothing else in params.yaml changes. The joints are those of the arm that scene and recordings share; fingers,
    drawers and free bodies are left out.

    Example: `lessbench new-task pour --scene my_scene.xml --recordings my_recordings`, then `dvc repro inspect@pour`.
    """
    from pipeline.commands.new_task import Wishes, add_task
    from pipeline.errors import ParameterError

    wrong = [pair for pair in joint_name or () if not all(pair.partition("="))]
    if wrong:
        raise ParameterError(f"--joint-name is {wrong[0]!r}; write RECORDED=SCENE, such as fr3_joint1=panda_joint1")
    names = {pair.partition("=")[0]: pair.partition("=")[2] for pair in joint_name or ()}
    if scene is None:
        raise ParameterError("--scene is missing; name an MJCF or URDF file")
    wishes = Wishes(name, scene, recordings, end_effector, tuple(joint or ()), names)
    for line in add_task(this_project(), wishes):
        say(plain(line, LONGEST_MESSAGE))


@commands.command("remove-task", rich_help_panel=SETUP)
def remove_task(task: TaskName) -> None:
    """Take a task out of the project, with all that its stages made. Your recordings and your scene stay.

    Example: `lessbench remove-task pour`.
    """
    from pipeline.commands.remove_task import remove_task

    for line in remove_task(this_project(), task):
        say(plain(line, LONGEST_MESSAGE))


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
def recover() -> None:
    """After DVC itself was killed: mend its own files, which it writes in place. Also lets DVC work without git.

    `make repro` does this first.

    Example: `lessbench recover`, then `dvc repro`.
    """
    from pipeline.commands.recover import recover

    for line in recover(this_project()) or ["nothing to mend"]:
        say(line)
