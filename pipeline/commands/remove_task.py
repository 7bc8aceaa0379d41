"""A task taken out of a project, with all that its stages made; what no stage made stays."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

from ruamel.yaml import YAML

from pipeline import params
from pipeline.commands.task_files import DvcFile
from pipeline.errors import ParameterError
from pipeline.formats.files.atomic import written_whole
from pipeline.stages.registry import STAGES
from pipeline.workspace.params_edits import without_entry
from pipeline.workspace.project import LOCKS, RUNS, TABLES, Project
from pipeline.yaml_text import plain_yaml

DVC_LOCK = "dvc.lock"


def remove_task(project: Project, name: str) -> list[str]:
    """Take a task out of params.yaml, dvc.yaml and dvc.lock, and delete what its stages made.

    Recordings are deleted only if they are simulated. The scene file stays.

    Returns:
        lines: what is gone, what stays, what to do next.

    Raises:
        ParameterError: there is no such task, it is the only one, or params.yaml cannot be changed by itself.
    """
    task = project.params.task(name)
    simulated = name in project.params.simulate.weights
    if len(project.params.tasks) == 1:
        raise ParameterError(f"{name!r} is the only task in {params.FILE}, which needs one; add another one first")
    file = project.root / params.FILE
    text = file.read_text(encoding="utf-8")
    dvc = DvcFile(project)
    if own := project.own_tasks.get(name):
        file = project.root / own
        file.unlink()
        if not any(file.parent.iterdir()):
            file.parent.rmdir()
        return [*_gone(project, name, False, task.scene, task.recordings), *_remedy(dvc)]
    if simulated:
        text = without_entry(text, "simulate.weights", name)
    text = without_entry(text, "tasks", name)
    params.parse(plain_yaml(text), str(file))
    with written_whole(file) as stream:
        stream.write(text.encode())
    return [*_gone(project, name, simulated, task.scene, task.recordings), *_remedy(dvc)]


def _gone(project: Project, name: str, simulated: bool, scene: str, recordings: str) -> list[str]:
    """Delete what the stages of a task made, and say what is left."""
    _forget_in_lock(project, name)
    _remove_made(project, name, simulated)
    folder = project.datasets / name
    left = sorted(project.shown(path) for path in folder.iterdir()) if folder.is_dir() else []
    kept = [scene, *([] if simulated else [recordings]), *(path for path in left if path != recordings)]
    return [
        f"task {name!r} and all that its stages made are gone.",
        f"Still there, as no stage made it: {', '.join(kept)}.",
        "So that the catalog and the report forget it too, run: dvc repro report",
    ]


def _remedy(dvc: DvcFile) -> list[str]:
    found = dvc.follow()
    return [] if found is None else [found]


def _forget_in_lock(project: Project, name: str) -> None:
    lock = project.root / DVC_LOCK
    if not lock.is_file():
        return
    yaml = YAML(typ="rt")
    document = yaml.load(lock.read_text(encoding="utf-8"))
    mine = [key for key in document.get("stages", {}) if key.endswith(f"@{name}")]
    for key in mine:
        del document["stages"][key]
    if mine:
        text = io.StringIO()
        yaml.dump(document, text)
        with written_whole(lock) as stream:
            stream.write(text.getvalue().encode())


def _remove_made(project: Project, name: str, simulated: bool) -> None:
    folder = project.datasets / name
    made = [path.format(task=name) for one in STAGES if one.per_task for path in (*one.outputs, *one.metrics)]
    made = [path for path in made if simulated or path != f"datasets/{name}/recordings"]
    for path in (*made, TABLES.format(task=name), f"datasets/{name}/.gitignore"):
        _remove(project.root / path)
    for record in (*(project.root / RUNS).glob(f"*@{name}.json"), *(project.root / LOCKS).glob(f"*@{name}*")):
        _remove(record)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
