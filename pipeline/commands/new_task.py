"""A task skeleton for somebody's own arm and recordings, written into params.yaml beside what is there."""

from __future__ import annotations

import io
from pathlib import Path

from ruamel.yaml import YAML

from pipeline import params
from pipeline.errors import ParameterError
from pipeline.formats.files.atomic import written_whole
from pipeline.replay.scene import Scene, load_scene
from pipeline.stages import dvc_yaml
from pipeline.vocabulary import DEMONSTRATION_ANCHOR, RESERVED_FOLDERS, TASK_ANCHOR
from pipeline.workspace.project import Project


def add_task(project: Project, name: str, scene: Path, recordings: Path, end_effector: str | None) -> list[str]:
    """Add the task `name` to params.yaml, comments kept, and say what to do next.

    Args:
        project: where to add it.
        name: of the task, not used before.
        scene: MJCF file.
        recordings: folder of MCAP files.
        end_effector: body or site whose path matters; None for the last body that moves.

    Returns:
        lines that say what is there now, and what to do next.

    Raises:
        ParameterError: the name is taken or not a name, or the folder holds no recordings.
        SceneError: see `pipeline.replay.load_scene`.
    """
    if name in project.params.tasks:
        raise ParameterError(f"there is a task {name!r} already in {params.FILE}; choose another name")
    if name in RESERVED_FOLDERS:
        raise ParameterError(f"a task cannot be called {name!r}, since datasets/{name} is taken; choose another name")
    if not any(recordings.glob("*.mcap")):
        raise ParameterError(f"--recordings is {recordings}: there is no .mcap file in it; name a folder that has some")
    loaded = load_scene(scene, end_effector=end_effector)
    yaml = YAML(typ="rt")
    yaml.width = 10_000
    yaml.indent(mapping=2, sequence=4, offset=2)
    file = project.root / params.FILE
    document = yaml.load(file.read_text(encoding="utf-8"))
    document["tasks"][name] = _skeleton(loaded, project.named(scene), project.named(recordings))
    text = io.StringIO()
    yaml.dump(document, text)
    params.parse(YAML(typ="safe", pure=True).load(text.getvalue()), str(file))
    with written_whole(file) as stream:
        stream.write(text.getvalue().encode())
    remedy = _feed_dvc(project)
    return [
        f"task {name!r} is in {params.FILE}: arm of {len(loaded.joints)} joints ({', '.join(loaded.joints)}), end "
        f"effector {loaded.end_effector}.",
        *(f"Of the scene: {remark}." for remark in loaded.remarks),
        f"Say there which features matter, then run: dvc repro inspect@{name}",
        *([] if remedy is None else [remedy]),
    ]


def _feed_dvc(before: Project) -> str | None:
    """Let the stages of the whole project wait for a new task, and show its figures, as DVC cannot list them by itself.

    Returns:
        what to do, if dvc.yaml has been changed by hand where this should stand.
    """
    file = before.root / dvc_yaml.FILE
    if not file.is_file():
        return None
    text = file.read_text(encoding="utf-8")
    parts = dvc_yaml.of_all_tasks(before.params), dvc_yaml.of_all_tasks(Project(before.root).params)
    for old, new in zip(*parts, strict=True):
        if old not in text:
            return (
                f"{dvc_yaml.FILE} is not as `python -m pipeline.stages.dvc_yaml` writes it, so its catalog will not "
                "wait for this task: write it anew with that command, or add the task to its last stages by hand"
            )
        text = text.replace(old, new)
    with written_whole(file) as stream:
        stream.write(text.encode())
    return None


def _skeleton(scene: Scene, file: str, recordings: str) -> dict[str, object]:
    terms = {"efficiency": {"kind": "efficiency"}, "height": {"kind": "height"}}
    return {
        "scene": file,
        "end_effector": scene.end_effector,
        "surface": scene.box_sites()[0] if len(scene.box_sites()) == 1 else None,
        "collisions": False,
        "recordings": recordings,
        "anchor": DEMONSTRATION_ANCHOR if scene.start is None or scene.goal is None else TASK_ANCHOR,
        "features": terms,
        "preferences": {name: dict(spec) for name, spec in terms.items()},
        "thetas": "grid",
    }
