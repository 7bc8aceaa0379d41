"""Which feature files may run: those of which the user has said so, in this folder and with this content.

What was said is kept outside of every project, so that no project can say it of itself. It is keyed by the project's
folder and by the hash of the file: a file that changes, or the same project elsewhere, must be agreed to anew.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path

from pipeline.errors import ParameterError
from pipeline.formats.files.atomic import written_whole
from pipeline.params import Task
from pipeline.replay.kinds.own import FeatureFile, register_kinds
from pipeline.workspace.project import Project

EXPERIMENTS = (".dvc", "tmp", "exps")  # where DVC runs a project's experiments
DVC_YAML = "dvc.yaml"


def trusted_files(project: Project, task: Task) -> tuple[FeatureFile, ...]:
    """The feature files of a task, ready to run.

    Raises:
        ParameterError: a file is not there, nobody has agreed to what is in it, or DVC would not see it change.
    """
    agreed = _agreed().get(str(_home(project.root)), {})
    files = []
    for name in task.feature_files:
        file = _feature_file(project, name)
        if agreed.get(name) != file.content:
            state = "has changed since it was trusted" if name in agreed else "is code, and runs only once trusted"
            raise ParameterError(
                f"{name}: the feature file {state}; read it, then say `lessbench trust {project.root}`"
            )
        _require_listed(project, name)
        files.append(file)
    return tuple(files)


def register_task_kinds(project: Project, task: Task) -> list[Path]:
    """Run the feature files of a task, which must be trusted; their paths, for provenance.

    Raises:
        ParameterError: see `trusted_files` and `pipeline.replay.kinds.own.register_kinds`.
    """
    files = trusted_files(project, task)
    register_kinds(files)
    return [file.path for file in files]


def trust(project: Project) -> list[str]:
    """Agree to all feature files of a project as they are now; nothing of them is run.

    Returns:
        what was agreed to, a line each.

    Raises:
        ParameterError: a file is not there.
    """
    names = feature_files(project)
    if not names:
        return [f"{project.root} names no feature files, so there is nothing to trust"]
    found = {name: _feature_file(project, name).content for name in names}
    every = _agreed() | {str(_home(project.root)): found}
    _store().parent.mkdir(parents=True, exist_ok=True)
    with written_whole(_store()) as stream:
        stream.write(json.dumps(every, indent=1, sort_keys=True).encode())
    return [
        f"{name} may run as it is now (sha256 {content[:16]}...); what it imports is yours to check"
        for name, content in found.items()
    ]


def feature_files(project: Project) -> list[str]:
    """The feature files of all tasks, each once, as params.yaml names them."""
    return list(dict.fromkeys(name for task in project.params.tasks.values() for name in task.feature_files))


def _feature_file(project: Project, name: str) -> FeatureFile:
    path = project.path(name).resolve()
    try:
        return FeatureFile(path, hashlib.sha256(path.read_bytes()).hexdigest())
    except OSError as error:
        raise ParameterError(
            f"feature_files names {name}, which cannot be read ({error.strerror or error}); paths begin at "
            f"{project.root}"
        ) from error


def _require_listed(project: Project, name: str) -> None:
    """Stages depend on feature files through dvc.yaml, which is written from the parameters."""
    file = project.root / DVC_YAML
    listed = re.compile(rf"[\s\[]{re.escape(name)}[,\]]")
    if file.is_file() and not listed.search(file.read_text(encoding="utf-8", errors="replace")):
        raise ParameterError(
            f"{DVC_YAML} does not list the feature file {name}, so DVC would not see it change; write it anew with "
            "`python -m pipeline.stages.dvc_yaml`"
        )


def _home(root: Path) -> Path:
    """The folder that was trusted; of an experiment that DVC runs in a folder of its own, the project's."""
    root = root.resolve()
    for folder in root.parents:
        if folder.parts[-3:] == EXPERIMENTS:
            return folder.parents[2]
    return root


def _store() -> Path:
    configured = os.environ.get("XDG_CONFIG_HOME", "")
    base = Path(configured) if Path(configured).is_absolute() else Path.home() / ".config"
    return base / "lessbench" / "trusted.json"


def _agreed() -> dict[str, dict[str, str]]:
    file = _store()
    if not file.is_file():
        return {}
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ParameterError(f"{file}: cannot be read ({error}); remove it, and trust your projects anew") from error
    if not isinstance(found, dict) or not all(isinstance(files, dict) for files in found.values()):
        raise ParameterError(f"{file}: is not what `lessbench trust` writes; remove it, and trust your projects anew")
    return found
