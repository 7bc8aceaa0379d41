"""`lessbench export`: which forms there are, and where they are written to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from pipeline.commands import export_arviz, export_motions
from pipeline.errors import ParameterError, StageError, one_of
from pipeline.formats.motions.lerobot import RATE_HZ
from pipeline.workspace.project import Project


@dataclass(frozen=True)
class Wanted:
    """What to export.

    Attributes:
        form: one of `FORMS`.
        folder: where to; None: `datasets/<task>/<form>`, for a plan `datasets/<task>/<form>-plan`.
        plan: the plan in place of the demonstrations.
        rate_hz: poses per second; None: as they are there.
        force: whether a folder that was named and has something in it is replaced, with all that is in it.
    """

    form: str
    folder: Path | None = None
    plan: bool = False
    rate_hz: int | None = None
    force: bool = False


@dataclass(frozen=True)
class Form:
    """A form of results.

    Attributes:
        about: what is written, in a few words.
        write: writes it for a task into a folder.
        motions: whether it is of motions, so that it can be the plan, and of another rate.
    """

    about: str
    write: Callable[[Project, str, Path, Wanted], object]
    motions: bool = True


def _arviz(project: Project, name: str, folder: Path, wanted: Wanted) -> None:
    export_arviz.export_arviz(project, name, folder)


def _motions(project: Project, name: str, folder: Path, wanted: Wanted) -> None:
    export_motions.export_motions(project, name, folder, wanted.form, plan=wanted.plan, rate_hz=wanted.rate_hz)


FORMS: Mapping[str, Form] = MappingProxyType(
    {
        "mcap": Form("a ROS 2 recording of each motion", _motions),
        "parquet": Form("one table of all motions", _motions),
        "csv": Form("the same as text", _motions),
        export_motions.LEROBOT: Form(f"a LeRobot dataset v3.0 ({RATE_HZ} Hz)", _motions),
        "arviz": Form("the draws of the weights as JSON", _arviz, motions=False),
    }
)


def export(project: Project, name: str, wanted: Wanted) -> None:
    """Write a task's motions or weights in another program's form, whole or not at all.

    Raises:
        ParameterError: the form is unknown or has no such option, or there is no such task.
        StageError: the folder has something in it, or there is nothing to export yet.
    """
    form = FORMS.get(wanted.form)
    if form is None:
        raise ParameterError(f"--to is {wanted.form!r}; allowed are {one_of(FORMS)}")
    if not form.motions and (wanted.plan or wanted.rate_hz is not None):
        of_motions = [one for one in FORMS if FORMS[one].motions]
        raise ParameterError(
            f"--to {wanted.form} is of weights and takes neither --plan nor --hz; {one_of(of_motions)} do"
        )
    project.params.task(name)
    form.write(project, name, _target(project, name, wanted), wanted)


def _target(project: Project, name: str, wanted: Wanted) -> Path:
    """The folder to write: what an export wrote there before is replaced, what somebody else has there is not."""
    if wanted.folder is None:
        return project.datasets / name / f"{wanted.form}{'-plan' if wanted.plan else ''}"
    folder = wanted.folder.absolute()
    if any(one.resolve().is_relative_to(folder.resolve()) for one in _kept(project)):
        raise StageError(f"{folder}: is a folder that holds more than an export; name a new folder inside it")
    if folder.is_symlink() or folder.is_file():
        raise StageError(f"{folder}: is a file or link, and an export is a folder; name a new one")
    if folder.is_dir() and any(folder.iterdir()) and not wanted.force:
        raise StageError(f"{folder}: has something in it, so nothing was written; name a new folder, or say --force")
    return folder


def _kept(project: Project) -> list[Path]:
    """Folders and files that no export takes the place of, whatever is forced."""
    tasks = project.params.tasks
    used = [project.path(file) for task in tasks.values() for file in (task.scene, task.recordings)]
    return [project.root, Path.cwd(), Path.home(), *used, *(project.table(task, "demonstrations") for task in tasks)]
