"""A scene and the recordings in it for the Rerun viewer, before anything of a task has been computed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import rerun as rr
import rerun.blueprint as rrb

from pipeline.views import palette
from pipeline.views.rerun.recording import written_recording
from pipeline.views.rerun.scene import log_bodies, log_shapes, moving_bodies

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray
    from pipeline.views.rerun.records import Replay


def write_scene_view(path: Path, task: str, replay: Replay, paths: FloatArray) -> None:
    """Write the recording, whole or not at all.

    Args:
        path: the `.rrd` file.
        task: name of the task.
        replay: the arm over time.
        paths: (n, T, 3) m, of the end effector in the world frame.
    """
    layout = rrb.Blueprint(rrb.Spatial3DView(origin="scene"), auto_layout=False, auto_views=False)
    with written_recording(path, task, layout) as recording:
        log_shapes(recording, replay.geometry)
        log_bodies(recording, replay, moving_bodies(replay))
        recording.log("scene/paths", rr.LineStrips3D(list(paths), colors=palette.DEMONSTRATION), static=True)
