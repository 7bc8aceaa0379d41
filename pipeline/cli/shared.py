"""What the commands share: the project they stand in, and the arguments that several take."""

from __future__ import annotations

from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.errors import WorkbenchError
from pipeline.vocabulary import STUDIES

if TYPE_CHECKING:
    from pipeline.workspace.project import Project

overlay: ContextVar[Path | None] = ContextVar("overlay", default=None)


def this_project() -> Project:
    """The project that the working directory is in, whose code is the one that runs.

    Raises:
        ParameterError: there is none.
        StageError: it has other code of its own, and DVC has not started this command.
    """
    from pipeline.cli.own_code import require_own_code

    found = _found()
    require_own_code(found.root)
    return found


def tasks() -> list[str]:
    """For completion: the tasks of the project that the shell is in, or none."""
    try:
        return list(_found().params.tasks)
    except WorkbenchError:
        return []


def _found() -> Project:
    from pipeline.workspace.project import find_project

    given = overlay.get()
    return find_project(Path.cwd(), given.resolve() if given else None)


def _tasks_and_studies() -> list[str]:
    return [*tasks(), STUDIES]


TaskName = Annotated[str, typer.Argument(metavar="TASK", help="A task of params.yaml.", autocompletion=tasks)]
TaskOrStudies = Annotated[
    str, typer.Argument(metavar="TASK", help="A task of params.yaml, or `studies`.", autocompletion=_tasks_and_studies)
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")]
IsLive = Annotated[bool, typer.Option("--live", help="Also serve the recording to Rerun viewers on this machine.")]
Port = Annotated[int, typer.Option(help="Of --live; 0 for any that is free.")]
Bind = Annotated[str, typer.Option(metavar="ADDRESS", help="Of --live: another address lets other machines see it.")]
Stay = Annotated[
    bool | None,
    typer.Option("--stay/--no-stay", help="Serve until Ctrl-C, as on a terminal, or end when done, as in a pipe."),
]
