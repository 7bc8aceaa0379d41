"""Links that lead out of a project: whoever made it may have put them there, so nothing is written through one."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import StageError

_projects: set[Path] = set()


def keep_inside(project: Path) -> None:
    """From now on, refuse to write through links that lead out of this folder."""
    _projects.add(project)


def require_inside(path: Path, *, opened: bool = False) -> None:
    """Go on only if writing `path`, where it is in a project, writes into that project.

    Args:
        path: what is written.
        opened: whether the file itself is opened, rather than replaced by a new one of its name.

    Raises:
        StageError: a link on the way leads out of the project; or what is opened is no file of its own.
    """
    for project in tuple(_projects):
        if path.is_relative_to(project):
            if leads_out(project, path if opened else path.parent):
                raise StageError(
                    f"{path}: a link leads from here out of the project, so nothing was written; remove the link and "
                    "run it again"
                )
            if opened and path.exists() and not (path.is_file() and path.stat().st_nlink == 1):
                raise StageError(f"{path}: is no file of its own, so nothing was written; remove it and run it again")


def leads_out(project: Path, path: Path) -> bool:
    """Whether a path, once links are followed, is not in the folder of the project, or leads nowhere."""
    try:
        return not path.resolve().is_relative_to(project.resolve())
    except (OSError, RuntimeError):  # a link that leads to itself
        return True
