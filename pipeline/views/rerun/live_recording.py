"""Demonstrations that are shown as they arrive: each is replayed once, beside the posteriors after it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pipeline.views import palette
from pipeline.views.rerun.density import log_map, log_map_points
from pipeline.views.rerun.labels import drawable, part
from pipeline.views.rerun.layout import map_view, page_view, scene_view, text_view
from pipeline.views.rerun.posterior import log_now, page_now
from pipeline.views.rerun.recording import written_recording
from pipeline.views.rerun.records import TIMELINE
from pipeline.views.rerun.scene import log_alternatives, log_bodies, log_playing, log_shapes, moving_bodies

if TYPE_CHECKING:
    from pathlib import Path

    from pipeline.arrays import FloatArray
    from pipeline.views.rerun.records import AlternativeSet, Replay
    from pipeline.views.task_summary import DensityMap

_PAUSE_S = 0.5  # between two demonstrations


@dataclass(frozen=True)
class Beginning:
    """What is shown before any demonstration.

    Attributes:
        task: name of the task.
        poses: the arm at configurations that it may reach; it is shown at the first.
        alternatives: the alternatives to draw.
        map: the density over two features, without demonstrations.
        theta_labels: (K,) the hypotheses in words.
        theta_meaning: what the numbers in the labels mean.
        priors: for each model, (K,) prior probabilities.
        summary: text in Markdown.
    """

    task: str
    poses: Replay
    alternatives: AlternativeSet
    map: DensityMap
    theta_labels: tuple[str, ...]
    theta_meaning: str
    priors: Mapping[str, FloatArray]
    summary: str


@dataclass(frozen=True)
class Arrival:
    """A demonstration that has arrived.

    Attributes:
        name: name of the demonstration.
        replay: the poses of the arm over time, which starts at 0.
        path: (T, 3) m, path of the end effector.
        on_map: (n, 2) raw values of the map's two features for all demonstrations so far.
        posteriors: for each model, (K,) probabilities after this demonstration.
        summary: text in Markdown.
    """

    name: str
    replay: Replay
    path: FloatArray
    on_map: FloatArray
    posteriors: Mapping[str, FloatArray]
    summary: str


class Watched:
    """A recording that grows with each demonstration."""

    def __init__(self, recording: rr.RecordingStream, beginning: Beginning) -> None:
        self._recording, self._beginning = recording, beginning
        self._moving = moving_bodies(beginning.poses)
        self._end_s = 0.0
        log_shapes(recording, beginning.poses.geometry)
        poses = beginning.poses
        start = replace(
            poses,
            body_positions=poses.body_positions[:1],
            body_quaternions=poses.body_quaternions[:1],
            time_s=np.zeros(1),
            demonstration=np.zeros(1, dtype=np.int64),
        )
        log_bodies(recording, start, self._moving)
        log_alternatives(recording, beginning.alternatives)
        log_map(recording, beginning.map, {})
        self._state(beginning.priors, beginning.summary)

    def show(self, arrival: Arrival) -> None:
        """Append a demonstration and the posteriors after it, and send them to all connected viewers."""
        begin_s = self._end_s + _PAUSE_S
        replay = replace(arrival.replay, time_s=arrival.replay.time_s + begin_s)
        self._end_s = float(replay.time_s[-1])
        log_bodies(self._recording, replay, self._moving)
        log_playing(self._recording, arrival.name, arrival.path, np.linspace(begin_s, self._end_s, len(arrival.path)))
        self._recording.set_time(TIMELINE, duration=self._end_s)
        path = rr.LineStrips3D([arrival.path], radii=rr.Radius.ui_points(1.8), colors=palette.DEMONSTRATION)
        self._recording.log(f"scene/demonstrations/{part(arrival.name)}", path)
        log_map_points(
            self._recording, self._beginning.map, "demonstrations", arrival.on_map, palette.DEMONSTRATION, static=False
        )
        self._state(arrival.posteriors, arrival.summary)

    def remove(self, name: str, on_map: FloatArray, posteriors: Mapping[str, FloatArray], summary: str) -> None:
        """Remove a demonstration; the arguments are those of `Arrival`, without that demonstration."""
        self._recording.set_time(TIMELINE, duration=self._end_s)
        self._recording.log(f"scene/demonstrations/{part(name)}", rr.Clear(recursive=False))
        log_map_points(
            self._recording, self._beginning.map, "demonstrations", on_map, palette.DEMONSTRATION, static=False
        )
        self._state(posteriors, summary)

    def _state(self, posteriors: Mapping[str, FloatArray], summary: str) -> None:
        self._recording.set_time(TIMELINE, duration=self._end_s)
        log_now(self._recording, self._beginning.theta_labels, posteriors)
        text = rr.TextDocument(drawable(summary), media_type=rr.MediaType.MARKDOWN)
        self._recording.log("summary", text)
        self._recording.reset_time()
        self._recording.flush(timeout_sec=30)


@contextmanager
def watched(path: Path, beginning: Beginning, *sinks: Any) -> Iterator[Watched]:
    """A recording that is sent to Rerun sinks at once, and saved if the block ends without an error.

    Args:
        path: the `.rrd` file, which is written whole or not at all.
        beginning: what is shown first.
        sinks: Rerun sinks, such as a server.
    """
    with written_recording(path, f"{beginning.task} watched", _layout(beginning), *sinks) as recording:
        yield Watched(recording, beginning)


def _layout(beginning: Beginning) -> rrb.Blueprint:
    poses, paths = beginning.poses, beginning.alternatives.paths
    in_picture = np.concatenate([paths.reshape(-1, 3), poses.body_positions[:, 1:].reshape(-1, 3)])
    name = f"Posterior over {beginning.theta_meaning}, after the demonstrations so far"
    above = rrb.Horizontal(
        scene_view(poses, in_picture, ()),
        page_view("posterior", name, page_now(beginning.priors).bounds),
        column_shares=[10, 10],
    )
    below = rrb.Horizontal(map_view(beginning.map), text_view("Demonstrations so far"), column_shares=[9, 20])
    return rrb.Blueprint(
        rrb.Vertical(above, below, row_shares=[62, 38]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )
