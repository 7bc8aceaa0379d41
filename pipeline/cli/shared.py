"""What the commands share: the project they stand in, and the arguments that several take."""

from __future__ import annotations

import os
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.errors import StageError, WorkbenchError
from pipeline.vocabulary import STUDIES

if TYPE_CHECKING:
    from pipeline.workspace.project import Project

# of address space, most of it never used: with 2 cores stages begin from 3.0 GB on
LEAST_ADDRESS_SPACE_BYTES, PER_CORE_BYTES = 3 << 30, 128 << 20
overlay: ContextVar[Path | None] = ContextVar("overlay", default=None)


def require_memory() -> None:
    """Refuse to compute where the libraries and their threads cannot even begin, whatever they would say of it.

    Raises:
        StageError: the limit on the memory of a program is too low.
    """
    from pipeline.machine_memory import too_little

    needed = LEAST_ADDRESS_SPACE_BYTES + (os.cpu_count() or 1) * PER_CORE_BYTES
    if lacking := too_little(needed, 0, "a stage"):
        raise StageError(f"there is too little memory here to compute ({lacking}); raise the limit and run it again")


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
Port = Annotated[int, typer.Option(help="With --live: the port to serve on; 0 for any free one.")]
Bind = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS",
        help="With --live: the address to serve on. Any other than the default lets other machines see it.",
    ),
]
Stay = Annotated[
    bool | None,
    typer.Option(
        "--stay/--no-stay",
        help="With --live: serve until Ctrl-C (default on a terminal), or end when done (default elsewhere).",
    ),
]
