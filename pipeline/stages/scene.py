"""Stage: the task's scene, looked at once, so that the stages that load it re-run only when it is another one.

The MJCF file includes others, of folders that all tasks share or of those that the tasks name. This stage re-runs, in a
second, when anything in them changes; its record changes only if a file of this scene did.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from pipeline.errors import few_of
from pipeline.formats.files.atomic import written_whole
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.stages.registry import stage
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import content_hash
from pipeline.workspace.scenes import load_task_scene

PARTS = {".stl", ".obj", ".msh", ".dae", ".mtl", ".png", ".ktx", ".skn", ".hf"}  # meshes, pictures and the like


def run(project: Project, name: str) -> None:
    """Write scene.json of the task `name`.

    Raises:
        SceneError: see `load_task_scene`.
    """
    with recorded_run(project, "scene", name, (project.scene_record(name),)) as record:
        scene = load_task_scene(project, project.params.task(name))
        files = {project.shown(path): content_hash(path) for path in scene_files(scene.path)}
        about = {
            "scene": project.shown(scene.path),
            "files": files,
            "model": model_hash(scene),
            "mujoco": version("mujoco"),
            "end_effector": scene.end_effector,
            "joints": joints(scene),
            "joint_names": dict(project.params.task(name).joint_names),
            "keyframes": [key for key, pose in (("start", scene.start), ("goal", scene.goal)) if pose is not None],
            "remarks": scene.remarks,
        }
        with written_whole(project.scene_record(name)) as stream:
            stream.write(f"{json.dumps(about, indent=2)}\n".encode())
        record.notes += scene.remarks
        if unseen := unwatched_files(project, scene.path, project.params.task(name).scene_files):
            record.notes.append(
                f"DVC does not notice a change of {few_of(unseen)}, which the scene depends on; name it in the task's "
                "scene_files, then run `python -m pipeline.stages.dvc_yaml`"
            )
        record.produced = f"{len(scene.joints)} joints, {len(files)} files"


def unwatched_files(project: Project, scene: Path, listed: Sequence[str] = ()) -> list[str]:
    """Files that a scene depends on and this stage does not wait for, as params.yaml names them.

    A folder that has nothing but parts of scenes stands for those in it.

    Args:
        project: where paths begin.
        scene: file of the scene.
        listed: files and folders that the task names in `scene_files`.
    """
    watched = [project.path(path).resolve() for path in (*stage("scene").inputs, *listed)]
    others = [file.resolve() for file in scene_files(scene) if file.resolve() != scene.resolve()]
    unseen = [file for file in others if not any(file.is_relative_to(path) for path in watched)]
    names = [project.named(_folder_of_parts(file, project) or file) for file in unseen]
    return list(dict.fromkeys(names))


def _folder_of_parts(file: Path, project: Project) -> Path | None:
    """The folder of a mesh or picture, if it has nothing else."""
    folder = file.parent
    if file.suffix.lower() not in PARTS or project.root.resolve().is_relative_to(folder):
        return None
    return folder if all(one.is_file() and one.suffix.lower() in PARTS for one in folder.iterdir()) else None


def joints(scene: Scene) -> list[dict[str, object]]:
    """Name, kind and limits (rad or m) of each joint; null where it has no limit."""
    limits = zip(scene.lower.tolist(), scene.upper.tolist(), strict=True)
    kinds = ["slide" if slides else "hinge" for slides in scene.slides]
    return [
        {"name": name, "kind": kind, "lower": _finite(lower), "upper": _finite(upper)}
        for name, kind, (lower, upper) in zip(scene.joints, kinds, limits, strict=True)
    ]


def _finite(limit: float) -> float | None:
    return limit if abs(limit) < float("inf") else None
