"""A planned motion for the Rerun viewer, beside the demonstrations that it follows from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pipeline.views import palette
from pipeline.views.rerun.layout import scene_view
from pipeline.views.rerun.recording import written_recording
from pipeline.views.rerun.scene import log_bodies, log_shapes, moving_bodies

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray
    from pipeline.views.rerun.records import Replay

_THICK, _THIN = rr.Radius.ui_points(4.0), rr.Radius.ui_points(1.2)


def write_plan_view(
    path: Path, task: str, replay: Replay, plan: FloatArray, others: FloatArray, demonstrations: FloatArray, text: str
) -> None:
    """Write the recording, whole or not at all.

    Args:
        path: the `.rrd` file.
        task: name of the task.
        replay: the arm along the plan.
        plan: (T, 3) m, of the end effector.
        others: (C, T, 3) m, the best for other draws of the belief.
        demonstrations: (n, T, 3) m.
        text: what is said of it, in Markdown.
    """
    in_picture = np.concatenate([demonstrations.reshape(-1, 3), plan, others.reshape(-1, 3)])
    view = scene_view(replay, in_picture, [], in_picture)
    view.name = "Plan (yellow), best for other beliefs (blue), demonstrations (pink)"
    below = rrb.Horizontal(view, rrb.TextDocumentView(origin="summary", name="The plan"), column_shares=[72, 28])
    closed = (rrb.SelectionPanel(state="collapsed"), rrb.BlueprintPanel(state="collapsed"))
    layout = rrb.Blueprint(
        below, rrb.TimePanel(state="collapsed", timeline="replay", play_state="playing", loop_mode="all"), *closed,
        auto_layout=False, auto_views=False,
    )  # fmt: skip
    with written_recording(path, f"{task} plan", layout) as recording:
        log_shapes(recording, replay.geometry)
        log_bodies(recording, replay, moving_bodies(replay))
        for name, paths, radius, color in (
            ("demonstrations", demonstrations, _THIN, palette.DEMONSTRATION),
            ("other_beliefs", others, _THIN, palette.SKY),
            ("plan", plan[None], _THICK, palette.YELLOW),
        ):
            recording.log(f"scene/{name}", rr.LineStrips3D(list(paths), radii=radius, colors=color), static=True)
        recording.log("summary", rr.TextDocument(text, media_type="text/markdown"), static=True)
