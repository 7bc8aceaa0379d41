"""The scene of a task, as the parameters name it."""

from __future__ import annotations

from pipeline.params import Task
from pipeline.replay.scene import Scene, load_scene
from pipeline.stages.project import Project


def load_task_scene(project: Project, task: Task) -> Scene:
    """Load the task's MJCF with its end effector.

    Raises:
        SceneError: see `pipeline.replay.load_scene`.
    """
    return load_scene(project.path(task.scene), end_effector=task.end_effector)
