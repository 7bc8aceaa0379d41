"""Stage: the task's scene, looked at once, so that the stages that load it re-run only when it is another one.

The MJCF file includes others, of folders that all tasks share. This stage re-runs, in a second, when anything in those
folders changes; its record changes only if a file of this scene did.
"""

from __future__ import annotations

import json
from importlib.metadata import version

from pipeline.formats.files.atomic import written_whole
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import content_hash
from pipeline.workspace.scenes import load_task_scene


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
        record.produced = f"{len(scene.joints)} joints, {len(files)} files"


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
