"""A task's scene and recordings in the viewer, before anything is computed."""

from __future__ import annotations

import numpy as np

from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene
from pipeline.stages.ingest import collect
from pipeline.stages.inspect import replay_of
from pipeline.views.rerun.recording import open_viewer
from pipeline.views.rerun.scene_view import write_scene_view
from pipeline.workspace.demonstrations import Intake
from pipeline.workspace.project import Project

VIEW = ".lessbench/scene.rrd"  # of the last task that was looked at
REST_S = 2.0


def view_scene(project: Project, name: str) -> None:
    """Show the arm of the task `name` in its scene: as in its recordings, or, if none can be used, from start to goal.

    Raises:
        StageError: there is no display; the message says where the file is.
    """
    intake = Intake.of(project, name)
    scene = intake.scene
    rows = collect(project.path(project.params.task(name).recordings), intake).rows
    paths = np.stack([row["waypoints"] for row in rows]) if rows else _at_rest(scene)
    durations_s = np.array([row["duration_s"] for row in rows] or [REST_S])
    tip = scene.end_effector
    file = project.root / VIEW
    file.parent.mkdir(exist_ok=True)
    write_scene_view(file, name, replay_of(scene, paths, durations_s), body_positions(scene, paths, [tip])[tip])
    open_viewer(file)


def _at_rest(scene: Scene) -> np.ndarray[tuple[int, int, int], np.dtype[np.float64]]:
    home = scene.home[scene.qpos_addresses]
    start, goal = (home if end is None else end for end in (scene.start, scene.goal))
    return np.stack([start, goal])[None]
