"""The scene of a task, as the parameters name it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pipeline.errors import SceneError, one_of
from pipeline.params import Task
from pipeline.replay.kinds.own import FeatureFile, register_kinds, registered
from pipeline.replay.scene import Scene, load_scene, scene_files
from pipeline.workspace.project import Project


@dataclass(frozen=True)
class SceneFile:
    """What a worker needs to load the scene of a task, once for all parts.

    Attributes:
        path: the MJCF file, where every worker can read it.
        end_effector: body or site whose path matters.
        joints: which joints describe a trajectory, in order.
        content: SHA-256 over the file and those it includes, so that a changed scene is loaded again.
        kinds: feature files that define kinds of features; all that the process has run which made this.
    """

    path: Path
    end_effector: str
    joints: tuple[str, ...]
    content: str
    kinds: tuple[FeatureFile, ...] = ()


def load_task_scene(project: Project, task: Task) -> Scene:
    """Load the task's MJCF with its end effector and its joints.

    Raises:
        SceneError: see `pipeline.replay.load_scene`; or `joint_names` names a joint that is none of the task's.
    """
    scene = load_scene(project.path(task.scene), end_effector=task.end_effector, joints=task.joints)
    strangers = [name for name in task.joint_names.values() if name not in scene.joints]
    if strangers:
        raise SceneError(
            f"joint_names gives a recorded joint the name {strangers[0]!r}, and the joints of the task are "
            f"{one_of(scene.joints)}; write `name in the recordings: name in the scene`."
        )
    return scene


def scene_file(scene: Scene) -> SceneFile:
    """The file of a scene that has been loaded."""
    digest = hashlib.sha256()
    for path in scene_files(scene.path):
        digest.update(path.read_bytes())
    return SceneFile(scene.path, scene.end_effector, scene.joints, digest.hexdigest(), registered())


@lru_cache(maxsize=4)
def loaded(file: SceneFile) -> Scene:
    """The scene of a file; the kinds of features that go with it are registered."""
    register_kinds(file.kinds)
    return load_scene(file.path, end_effector=file.end_effector, joints=file.joints)
