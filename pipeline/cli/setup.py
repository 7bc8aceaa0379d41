"""Commands for a project of one's own."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.grouping import BRING, COMPUTE, TRUST, Commands
from pipeline.cli.shared import AsJson, TaskName, tasks, this_project
from pipeline.terminal import LONGEST_MESSAGE, plain, say, say_json

commands = Commands()
FURTHEST_M = 100.0  # that an object may be away


@commands.command(rich_help_panel=BRING)
def check(
    files: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="Files, folders of recordings, and datasets.")
    ],
    task: Annotated[
        str | None, typer.Option(help="Also check it against the joints and the scene of this task.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say what each recording holds, and whether it can be used. Exit status 1 if any cannot.

    Example: `lessbench check my_recordings --task table`, or `lessbench check demo.hdf5 --json`. What is read is in
    docs/recordings.md.
    """
    from pipeline.commands.check import checked

    found = []
    usable = True
    for path in files:
        for one in checked(path, this_project() if task else None, task):
            usable &= one.usable
            if as_json:
                found.append(one.as_json())
                continue
            for line in one.text():
                say(line)
    if as_json:
        say_json(found)
    if not usable:
        raise typer.Exit(1)


@commands.command(rich_help_panel=BRING)
def init(folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new or empty folder.")]) -> None:
    """Begin a project of your own where there is no copy of the repository: parameters, an arm, scenes.

    DVC does not run in it, as it has no code of its own: `lessbench run TASK` computes a task.

    Example: `lessbench init my_project`, then in that folder `lessbench new-task`.
    """
    from pipeline.commands.init import init

    for line in init(folder):
        say(line)


@commands.command("new-task", rich_help_panel=BRING)
def new_task(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the task: letters, digits, underscores.")],
    recordings: Annotated[Path, typer.Option(help="Folder of recordings.")],
    scene: Annotated[
        Path | None, typer.Option(help="MJCF, URDF or YAML file, with keyframes `start` and `goal` if there are any.")
    ] = None,
    arm: Annotated[
        Path | None, typer.Option(help="MJCF or URDF file around which a scene is written, in place of --scene.")
    ] = None,
    table: Annotated[
        bool, typer.Option("--table", help="With --arm: add a table, its top at the height of the arm's base.")
    ] = False,
    object_: Annotated[
        list[str] | None,
        typer.Option(
            "--object", metavar="NAME:X,Y,Z", help="With --arm: add an object at this position, in m. May be repeated."
        ),
    ] = None,
    end_effector: Annotated[
        str | None, typer.Option(help="Body or site whose path matters. Default: the hand of the arm.")
    ] = None,
    joint: Annotated[
        list[str] | None, typer.Option(help="A joint of the arm. Repeat it for each, in order. Default: proposed.")
    ] = None,
    joint_name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="RECORDED=SCENE", help="A joint's name in the recordings, and in the scene. May be repeated."
        ),
    ] = None,
    reading: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE", help="What columns of tables mean, such as time=t or unit=deg. May be repeated."
        ),
    ] = None,
    own_file: Annotated[
        bool, typer.Option("--own-file", help="Write it into tasks/NAME.yaml, which no update of the program touches.")
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Then show the recordings in the scene, in the viewer.")] = False,
) -> None:
    """Propose a task from a scene and recordings, and add it to params.yaml. Says what it chose, and why.

    Nothing else in params.yaml changes. The joints are those of the arm that scene and recordings share; fingers,
    drawers and free bodies are left out.

    Example: `lessbench new-task pour --scene my_scene.xml --recordings my_recordings`, then `dvc repro inspect@pour`.
    """
    from pipeline.commands.built_scene import Surroundings, built_scene
    from pipeline.commands.new_task import Wishes, add_task
    from pipeline.errors import ParameterError

    if (scene is None) == (arm is None) or (arm is None and (table or object_)):
        raise ParameterError("name either --scene, or --arm, which --table and --object go with")
    project, names = this_project(), _joint_names(joint_name or ())
    wishes = Wishes(
        name, scene or Path(), recordings, end_effector, tuple(joint or ()), names, reading=_reading(reading or ()),
        own_file=own_file,
    )  # fmt: skip
    if arm is None:
        lines = add_task(project, wishes)
    else:
        wanted = Surroundings(arm, table, _objects(object_ or ()))
        with built_scene(project, wishes, wanted) as (wishes, built):
            lines = [*built, *add_task(project, wishes)]
    for line in lines:
        say(plain(line, LONGEST_MESSAGE))
    if view:
        from pipeline.commands.scene_view import view_scene

        view_scene(this_project(), name)


def _joint_names(pairs: Iterable[str]) -> dict[str, str]:
    from pipeline.errors import ParameterError

    found = {}
    for pair in pairs:
        recorded, equals, ours = pair.partition("=")
        if not (recorded and equals and ours):
            raise ParameterError(f"--joint-name is {pair!r}; write RECORDED=SCENE, such as fr3_joint1=panda_joint1")
        found[recorded] = ours
    return found


def _reading(pairs: Iterable[str]) -> dict[str, object]:
    from pipeline.errors import ParameterError

    found: dict[str, object] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals and value):
            raise ParameterError(f"--reading is {pair!r}; write KEY=VALUE, such as time=t, unit=deg or joints=q1,q2")
        found[key] = value.split(",") if key == "joints" else value
        if key == "rate_hz" and re.fullmatch(r"\d{1,9}(\.\d{1,9})?", value):
            found[key] = float(value)
    return found


def _objects(texts: Iterable[str]) -> dict[str, tuple[float, float, float]]:
    from pipeline.errors import ParameterError

    found = {}
    for text in texts:
        name, _, place = text.partition(":")
        try:
            x, y, z = (float(number) for number in place.split(","))
        except ValueError:
            raise ParameterError(f"--object is {text!r}; write NAME:X,Y,Z in metres, such as cup:0.5,0,0.1") from None
        if not re.fullmatch(r"[A-Za-z]\w*", name) or not all(abs(number) < FURTHEST_M for number in (x, y, z)):
            raise ParameterError(
                f"--object is {text!r}; its name has letters, digits and underscores, and it stands less than "
                f"{FURTHEST_M:g} m away"
            )
        found[name] = (x, y, z)
    return found


@commands.command("remove-task", rich_help_panel=BRING)
def remove_task(task: TaskName) -> None:
    """Remove a task from the project, with all that its stages made. Your recordings and your scene stay.

    Example: `lessbench remove-task pour`.
    """
    from pipeline.commands.remove_task import remove_task

    for line in remove_task(this_project(), task):
        say(plain(line, LONGEST_MESSAGE))


@commands.command(rich_help_panel=COMPUTE)
def run(
    task: Annotated[
        str | None, typer.Argument(metavar="[TASK]", help="A task of params.yaml.", autocompletion=tasks)
    ] = None,
) -> None:
    """Run every stage of a task, from its recordings to its figures, even those that are up to date.

    Use it with parameters in a file of their own (--overlay), which `dvc repro` does not see. Without a task, all tasks
    of the overlay are run, the study `redraws` with each, and the catalog and datasets/section_5.html are written.

    Examples: `lessbench --overlay mine.yaml run pour`, `lessbench --overlay docs/overlays/jaco_twelve.yaml run`.
    """
    from pipeline.commands.run import run_all, run_task
    from pipeline.params import overlay_tasks

    project = this_project()
    if task is not None:
        run_task(project, task)
    elif project.overlay is not None:
        run_all(project, overlay_tasks(project.overlay))
    else:
        raise typer.BadParameter("name a task, or give an overlay (--overlay FILE) whose tasks are to be run")


@commands.command("inspect-project", rich_help_panel=TRUST)
def inspect_project(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A project that came from elsewhere.")],
) -> None:
    """List what would run in a project from elsewhere, what leads out of it, and what is unusual. Runs nothing of it.

    Exit status 1 if there is any of that; 0 if only the stages of this program would run.

    Example: `lessbench inspect-project received/`.
    """
    from pipeline.commands.inspect_project import inspect_project

    found = inspect_project(folder)
    for line in found.lines():
        say(plain(line, LONGEST_MESSAGE))
    if found.findings:
        raise typer.Exit(1)


@commands.command(rich_help_panel=TRUST)
def trust(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A project whose feature files you have read.")],
) -> None:
    """Allow the feature files of a project to run, as they are now. This does not run them.

    The permission is kept outside of the project, and is for this folder. It ends for a file that changes.

    Example: `lessbench trust .`, after `lessbench inspect-project .`.
    """
    from pipeline.errors import ParameterError
    from pipeline.params import FILE
    from pipeline.workspace.project import Project
    from pipeline.workspace.trust import trust

    if not (folder / FILE).is_file():
        raise ParameterError(f"{folder}: is not a project, as it has no {FILE}; name the folder of one")
    for line in trust(Project(folder.resolve())):
        say(plain(line, LONGEST_MESSAGE))


@commands.command(rich_help_panel=COMPUTE)
def recover() -> None:
    """Repair DVC's own files after it was killed, and let it work without git.

    `make repro` does this first.

    Example: `lessbench recover`, then `dvc repro`.
    """
    from pipeline.commands.recover import recover

    for line in recover(this_project()) or ["nothing to repair"]:
        say(line)
