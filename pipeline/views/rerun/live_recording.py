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
from pipeline.views.rerun.posterior import bounds_of_any, log_now
from pipeline.views.rerun.recording import written_recording
from pipeline.views.rerun.records import Motions
from pipeline.views.rerun.scene import (
    DEMONSTRATED,
    label_lift,
    log_alternatives,
    log_bodies,
    log_playing,
    log_shapes,
    moving_bodies,
)
from pipeline.views.rerun.series import (
    MOST_LINES_WATCHED,
    Lines,
    belief_views,
    first_of,
    log_motion,
    log_motion_styles,
    motion_views,
)
from pipeline.views.rerun.timelines import TIMELINE, at
from pipeline.views.rerun.weights import log_weights, weights_bounds

if TYPE_CHECKING:
    from pathlib import Path

    from pipeline.arrays import FloatArray
    from pipeline.views.feature_axis import FeatureAxis
    from pipeline.views.rerun.records import AlternativeSet, Replay, Weights
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
        joints: names of the joints.
        joint_units: their units, `rad` or `m`.
        axes: the features.
        prior: what is believed.
    """

    task: str
    poses: Replay
    alternatives: AlternativeSet
    map: DensityMap
    theta_labels: tuple[str, ...]
    theta_meaning: str
    joints: tuple[str, ...]
    joint_units: tuple[str, ...]
    axes: tuple[FeatureAxis, ...]
    prior: Believed


@dataclass(frozen=True)
class Believed:
    """What is believed after the demonstrations so far.

    Attributes:
        posteriors: for each model, (K,) probabilities.
        summary: text in Markdown.
        truth: the hypothesis nearest to what the people so far truly want; None if that is not known.
        weights: of all demonstrations so far together; None if there is none yet.
    """

    posteriors: Mapping[str, FloatArray]
    summary: str
    truth: int | None = None
    weights: Weights | None = None


@dataclass(frozen=True)
class Arrival:
    """A demonstration that has arrived.

    Attributes:
        name: name of the demonstration.
        replay: the poses of the arm over time, which starts at 0.
        path: (T, 3) m, path of the end effector.
        waypoints: (T, J) of the joints.
        along: (T, F) the features along it, NaN where they have no value.
        raw: (F,) raw values of the features.
        on_map: (n, 2) values of the map's two features for all demonstrations so far.
        belief: what is believed after it.
    """

    name: str
    replay: Replay
    path: FloatArray
    waypoints: FloatArray
    along: FloatArray
    raw: FloatArray
    on_map: FloatArray
    belief: Believed


class Watched:
    """A recording that grows with each demonstration."""

    def __init__(self, recording: rr.RecordingStream, beginning: Beginning) -> None:
        self._recording, self._beginning = recording, beginning
        self._moving = moving_bodies(beginning.poses)
        self._end_s, self._step = 0.0, 0
        self._lift_m = label_lift(beginning.alternatives.paths)
        self._lines = Lines(recording, beginning.theta_labels)
        log_shapes(recording, beginning.poses.geometry)
        poses = beginning.poses
        start = replace(
            poses,
            body_positions=poses.body_positions[:1],
            body_quaternions=poses.body_quaternions[:1],
            time_s=np.zeros(1),
            demonstration=np.zeros(1, dtype=np.int64),
        )
        log_bodies(recording, start, self._moving, 0)
        log_alternatives(recording, beginning.alternatives)
        log_map(recording, beginning.map, {})
        log_motion_styles(recording, beginning.axes, beginning.joints)
        self._state(beginning.prior)

    def show(self, arrival: Arrival) -> None:
        """Append a demonstration and the posteriors after it, and send them to all connected viewers."""
        begin_s = self._end_s + _PAUSE_S
        replay = replace(arrival.replay, time_s=arrival.replay.time_s + begin_s)
        self._end_s, self._step = float(replay.time_s[-1]), self._step + 1
        log_bodies(self._recording, replay, self._moving, self._step)
        times = np.linspace(begin_s, self._end_s, len(arrival.path))
        log_playing(self._recording, arrival.name, arrival.path, times, self._step, self._lift_m)
        shown = self._beginning
        motion = Motions(
            shown.joints, shown.joint_units, shown.axes, arrival.waypoints[None], arrival.along[None], arrival.raw[None]
        )
        log_motion(self._recording, motion, 0, arrival.name, times, self._step)
        at(self._recording, self._end_s, self._step)
        path = rr.LineStrips3D([arrival.path], radii=DEMONSTRATED, colors=palette.DEMONSTRATION)
        self._recording.log(f"scene/demonstrations/{part(arrival.name)}", path)
        log_map_points(
            self._recording, self._beginning.map, "demonstrations", arrival.on_map, palette.DEMONSTRATION, static=False
        )
        self._state(arrival.belief)

    def remove(self, name: str, on_map: FloatArray, belief: Believed) -> None:
        """Remove a demonstration, which is a step of its own; the arguments are those of `Arrival`, without it."""
        self._step += 1
        at(self._recording, self._end_s, self._step)
        self._recording.log(f"scene/demonstrations/{part(name)}", rr.Clear(recursive=False))
        log_map_points(
            self._recording, self._beginning.map, "demonstrations", on_map, palette.DEMONSTRATION, static=False
        )
        self._state(belief)

    def _state(self, belief: Believed) -> None:
        at(self._recording, self._end_s, self._step)
        log_now(self._recording, self._beginning.theta_labels, belief.posteriors, belief.truth)
        if self._step:  # before, no hypothesis is ahead of another
            now = {model: first_of(posterior, MOST_LINES_WATCHED) for model, posterior in belief.posteriors.items()}
            self._lines.log(belief.posteriors, now)
        if belief.weights is not None:
            log_weights(self._recording, belief.weights, static=False)
        elif self._step:
            self._recording.log("weights", rr.Clear(recursive=True))
        text = rr.TextDocument(drawable(belief.summary), media_type=rr.MediaType.MARKDOWN)
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
    poses, paths, models = beginning.poses, beginning.alternatives.paths, tuple(beginning.prior.posteriors)
    in_picture = np.concatenate([paths.reshape(-1, 3), poses.body_positions[:, 1:].reshape(-1, 3)])
    name = f"Posterior: {beginning.theta_meaning}, after the demonstrations so far"
    believed = [
        page_view("posterior", name, bounds_of_any(models, len(beginning.theta_labels))),
        page_view("weights", "Weights, all as one person (line: 90 % interval)", weights_bounds(len(beginning.axes))),
    ]
    above = rrb.Horizontal(
        scene_view(poses, in_picture, (), paths.reshape(-1, 3)),
        rrb.Tabs(*believed, active_tab=0),
        column_shares=[8, 12],
    )
    below = rrb.Horizontal(
        motion_views(beginning.axes, beginning.joints, beginning.joint_units, None),
        belief_views(models, len(beginning.theta_labels)),
        rrb.Tabs(text_view("Demonstrations so far"), map_view(beginning.map), active_tab=0),
        column_shares=[10, 10, 11],
    )
    return rrb.Blueprint(
        rrb.Vertical(above, below, row_shares=[60, 40]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )
