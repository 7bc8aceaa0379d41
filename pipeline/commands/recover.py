"""Mend what keeps the next `dvc repro` from beginning: files of DVC's own that are cut off, and no git.

DVC writes dvc.lock and .dvc/tmp/rwlock in place, and a kill may leave them cut off. What stages write appears whole and
needs no mending. Without git, as in a project unpacked from an archive, DVC does nothing unless it is told to.
"""

from __future__ import annotations

import fcntl
import json
from pathlib import Path

from pipeline.errors import StageError
from pipeline.formats.files.links import require_inside
from pipeline.workspace.project import KEPT_LOCK, Project


def recover(project: Project) -> list[str]:
    """Put back the last whole dvc.lock if it is cut off, drop a list of users that is, and let DVC work without git.

    Returns:
        one sentence for everything that was mended.

    Raises:
        StageError: DVC is at work, or its folder is a link that leads out of the project.
    """
    if not (project.root / ".dvc").is_dir():
        return []
    temporary = project.root / ".dvc" / "tmp"
    require_inside(temporary / "lock", opened=True)
    temporary.mkdir(exist_ok=True)
    with (temporary / "lock").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # DVC holds it whenever it writes these files
        except BlockingIOError:
            raise StageError(f"{project.root}: dvc is at work here; wait until it has ended") from None
        mended = []
        if not _whole(project.root / "dvc.lock"):
            kept = project.root / KEPT_LOCK
            if kept.is_file() and _whole(kept):
                kept.replace(project.root / "dvc.lock")
                mended.append("dvc.lock was cut off; the last whole one is back, and what ran since then runs again")
            else:
                (project.root / "dvc.lock").unlink()
                mended.append("dvc.lock was cut off and is removed; every stage runs again")
        users = temporary / "rwlock"
        if users.is_file() and not _is_json(users):
            users.unlink()
            mended.append(".dvc/tmp/rwlock was cut off and is removed")
    return [*mended, *_without_git(project.root)]


def _without_git(root: Path) -> list[str]:
    from dvc.config import Config

    config = Config(str(root / ".dvc"))
    if config["core"].get("no_scm") or any((folder / ".git").exists() for folder in (root, *root.parents)):
        return []
    with config.edit("local") as local:
        local.setdefault("core", {})["no_scm"] = True
    return [
        "this folder is in no git repository, and dvc now works without one (core.no_scm in .dvc/config.local); after "
        "`git init`, take that back with `dvc config --local --unset core.no_scm`"
    ]


def _whole(path: Path) -> bool:
    """Whether DVC can read `path`; a file that is not there does no harm."""
    from dvc.schema import COMPILED_LOCKFILE_SCHEMA
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    from voluptuous import Invalid

    if not path.is_file():
        return True
    try:
        COMPILED_LOCKFILE_SCHEMA(YAML(typ="safe").load(path.read_text(encoding="utf-8")))
    except (YAMLError, UnicodeDecodeError, Invalid):
        return False
    return True


def _is_json(path: Path) -> bool:
    try:
        json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return False
    return True
