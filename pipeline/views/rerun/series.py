"""Plots over time: joints and features along each demonstration, and the belief as demonstrations come in.

They are logged on two timelines, the clock of the replay and the number of demonstrations. The view shows whichever the
viewer's time panel has chosen. On the clock a feature is a line along each demonstration; against the demonstrations it
is a point for each, as on the axes of the densities.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pipeline.choice import entropy
from pipeline.views import palette
from pipeline.views.feature_axis import with_unit
from pipeline.views.hypothesis_rows import marked
from pipeline.views.rerun.labels import drawable, part
from pipeline.views.rerun.timelines import DEMONSTRATIONS, TIMELINE, at
from pipeline.vocabulary import model_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from pipeline.arrays import FloatArray
    from pipeline.views.feature_axis import FeatureAxis
    from pipeline.views.rerun.records import Inspection, Motions

JOINTS, FEATURES, BELIEF = "series/joints", "series/features", "series/belief"
EACH = "each demonstration"  # under a feature, beside the demonstrations' names
PLAUSIBLE = "plausible"  # under BELIEF, beside the models
MOST_LINES_WATCHED = 2  # the same of each moment while people demonstrate, where more come in time
MOST_LINES = 3  # hypotheses with a line in the plot of a model's belief
COLORS = (  # the first three are far apart in grey, too, and so are the next three
    palette.YELLOW,
    palette.SKY,
    palette.VERMILLION,
    palette.PINK,
    palette.GREEN,
    palette.ORANGE,
    palette.GREY,
)
MARKERS = tuple(  # to tell lines apart in grey too
    map(rr.components.MarkerShape.auto, ("Circle", "Square", "Up", "Diamond", "Cross", "Down", "Plus", "Asterisk"))
)
TRUE = len(MARKERS) - 1  # the place of the marker of the truth, which is white
_WIDTH, _MARK = 1.5, 4.0  # of lines and of markers


class Lines:
    """The lines of the belief plots: a hypothesis has one from when it is first asked for, always in one style."""

    def __init__(self, recording: rr.RecordingStream, labels: Sequence[str], truth: int | None = None) -> None:
        """Log nothing yet.

        Args:
            recording: the recording that is logged to.
            labels: (K,) the hypotheses in words.
            truth: the hypothesis nearest to the truth, if that is known.
        """
        self._recording, self._labels, self._truth = recording, labels, truth
        self._drawn: dict[str, list[int]] = {}
        self._places: dict[int, int] = {}  # of hypotheses, so that each looks the same under every model

    def log(self, posteriors: Mapping[str, FloatArray], wanted: Mapping[str, Sequence[int]]) -> None:
        """Log the belief at the recording's present times.

        Args:
            posteriors: for each model, (K,) probabilities.
            wanted: for each model, hypotheses that have a line from now on.
        """
        models = tuple(posteriors)
        for place, (model, posterior) in enumerate(posteriors.items()):
            drawn = self._drawn.setdefault(model, [])
            for k in wanted[model]:
                if k not in drawn:
                    drawn.append(k)
                    self._new(model, k)
            for k in drawn:
                self._recording.log(_belief(model, k), rr.Scalars(float(posterior[k])))
            entity = _plausible(model)
            if (PLAUSIBLE + model) not in self._drawn:
                self._drawn[PLAUSIBLE + model] = []
                _style(
                    self._recording, entity, model_name(model), place, step=True,
                    color=palette.model_color(model, models),
                )  # fmt: skip
            self._recording.log(entity, rr.Scalars(float(np.exp(entropy(posterior)))))

    def _new(self, model: str, k: int) -> None:
        entity, label = _belief(model, k), self._labels[k]
        if k == self._truth:
            _style(self._recording, entity, marked(label), TRUE, step=True, color=palette.WHITE)
        else:
            _style(self._recording, entity, label, self._places.setdefault(k, len(self._places)), step=True)


def log_series(recording: rr.RecordingStream, inspection: Inspection) -> None:
    """Log the plots under `/series`."""
    motions = inspection.motions
    log_motion_styles(recording, motions.axes, motions.joints)
    for row, name in enumerate(inspection.demonstration_ids):
        time_s = np.linspace(inspection.start_s[row], inspection.end_s[row], motions.waypoints.shape[1])
        log_motion(recording, motions, row, name, time_s, row + 1)
    lines = Lines(recording, inspection.theta_labels, inspection.nearest_truth)
    wanted = lines_of(inspection)
    times = np.concatenate([inspection.replay.time_s[:1], inspection.end_s])
    for step, time_s in enumerate(times):
        at(recording, float(time_s), step)
        lines.log({model: steps[step] for model, steps in inspection.posteriors.items()}, wanted)
    recording.reset_time()


def lines_of(inspection: Inspection) -> dict[str, list[int]]:
    """For each model the hypotheses with a line: those that it finds most probable in the end, and the truth."""
    final = {model: steps[-1] for model, steps in inspection.posteriors.items()}
    return {model: first_of(posterior, MOST_LINES, inspection.nearest_truth) for model, posterior in final.items()}


def first_of(posterior: FloatArray, most: int, truth: int | None = None) -> list[int]:
    """The most probable hypotheses, the first of them first, and the truth if it is known."""
    first = [int(k) for k in np.argsort(-posterior, kind="stable")[:most]]
    return first if truth is None or truth in first else [*first, truth]


def log_motion_styles(recording: rr.RecordingStream, axes: Sequence[FeatureAxis], joints: Sequence[str]) -> None:
    """Log what the lines of joints look like, and the points that stand for whole demonstrations."""
    for axis in axes:
        points = rr.SeriesPoints(names=drawable(axis.label), colors=palette.DEMONSTRATION, marker_sizes=_MARK)
        recording.log(f"{FEATURES}/{part(axis.feature)}/{part(EACH)}", points, static=True)
    for place, (joint, said) in enumerate(zip(joints, short_names(joints), strict=True)):
        _style(recording, f"{JOINTS}/{part(joint)}", said, place, marker=False)


def log_motion(
    recording: rr.RecordingStream, motions: Motions, row: int, name: str, time_s: FloatArray, step: int
) -> None:
    """Log one demonstration along its waypoints.

    Args:
        recording: the recording that is logged to.
        motions: the demonstrations.
        row: which of them.
        name: its name.
        time_s: (T,) s, on the clock of the replay.
        step: its number, from 1.
    """
    clock = rr.TimeColumn(TIMELINE, duration=np.append(time_s, time_s[-1] + 1e-3))
    for column, joint in enumerate(motions.joints):
        positions = rr.Scalars.columns(scalars=motions.waypoints[row, :, column])
        # a row without a value at the end: else the line would go on to the next demonstration
        gapped = positions.partition([1] * len(time_s) + [0])
        recording.send_columns(f"{JOINTS}/{part(joint)}", indexes=[clock], columns=gapped)
    for column, axis in enumerate(motions.axes):
        entity = f"{FEATURES}/{part(axis.feature)}/{part(name)}"
        _style(recording, entity, name, 0, color=palette.DEMONSTRATION, marker=False)
        values = motions.along[row, :, column]
        there = np.isfinite(values)
        if there.any():
            times = [rr.TimeColumn(TIMELINE, duration=time_s[there])]
            recording.send_columns(entity, indexes=times, columns=rr.Scalars.columns(scalars=values[there]))
    recording.reset_time()
    recording.set_time(DEMONSTRATIONS, sequence=step)
    for column, axis in enumerate(motions.axes):
        value = float(axis.shown(motions.raw[row, column]))
        recording.log(f"{FEATURES}/{part(axis.feature)}/{part(EACH)}", rr.Scalars(value))
    recording.reset_time()


def short_names(joints: Sequence[str]) -> list[str]:
    """Names of joints without the words with which all of them begin, but for the last of these words."""
    words = [joint.split("_") for joint in joints]
    shared = 0
    while len(joints) > 1 and all(len(one) > shared + 1 and one[shared] == words[0][shared] for one in words):
        shared += 1
    return ["_".join(one[max(0, shared - 1) :]) for one in words]


def motion_views(
    axes: Sequence[FeatureAxis], joints: Sequence[str], joint_units: Sequence[str], window_s: float | None
) -> rrb.Tabs:
    """A plot for each feature and one for the joints of each unit.

    Args:
        axes: the features.
        joints, joint_units: names and units of the joints.
        window_s: how much of the clock is shown before and after the present; None: all of it.
    """
    views = [
        _plot(f"{FEATURES}/{part(axis.feature)}", f"{with_unit(axis.feature, axis.unit)} along the path", window_s)
        for axis in axes
    ]
    for unit in dict.fromkeys(joint_units):
        mine = [f"/{JOINTS}/{part(j)}/**" for j, u in zip(joints, joint_units, strict=True) if u == unit]
        views.append(_plot(JOINTS, f"Joints ({unit})", window_s, contents=mine, legend=True))
    return rrb.Tabs(*views, active_tab=0)


def belief_views(models: Iterable[str], hypotheses: int) -> rrb.Tabs:
    """A plot of each model's belief, and one of how many of the hypotheses are still plausible."""
    models = list(models)
    views = [
        _plot(f"{BELIEF}/{part(model)}", f"P(theta), {model_name(model)}", legend=True, y=(-0.02, 1.02), contents=None)
        for model in models
    ]
    plausible = _plot(
        f"{BELIEF}/{PLAUSIBLE}", "Thetas still plausible", legend=True, corner="RightTop", y=(0.0, 1.05 * hypotheses)
    )
    return rrb.Tabs(*views, plausible, active_tab=len(views) - 1)


def _plot(
    origin: str,
    name: str,
    window_s: float | None = None,
    *,
    contents: list[str] | None = None,
    legend: bool = False,
    y: tuple[float, float] | None = None,
    corner: Literal["LeftTop", "RightTop"] = "LeftTop",
) -> rrb.TimeSeriesView:
    edge = rrb.TimeRangeBoundary
    ranges = None
    if window_s is not None:
        near = [edge.cursor_relative(seconds=sign * window_s) for sign in (-1, 1)]
        ranges = [
            rrb.VisibleTimeRange(TIMELINE, start=near[0], end=near[1]),
            rrb.VisibleTimeRange(DEMONSTRATIONS, start=edge.infinite(), end=edge.infinite()),
        ]
    return rrb.TimeSeriesView(
        origin=origin,
        name=drawable(name),
        contents=contents or "$origin/**",
        time_ranges=ranges,
        axis_x=None
        if window_s is not None
        else rrb.TimeAxis(view_range=rr.TimeRange(edge.infinite(), edge.infinite())),
        axis_y=None if y is None else rrb.ScalarAxis(range=y),
        plot_legend=rrb.PlotLegend(visible=legend, corner=corner),
    )


def _belief(model: str, k: int) -> str:
    return f"{BELIEF}/{part(model)}/{k}"


def _plausible(model: str) -> str:
    return f"{BELIEF}/{PLAUSIBLE}/{part(model)}"


def _style(
    recording: rr.RecordingStream,
    entity: str,
    name: str,
    place: int,
    *,
    color: palette.RGB | None = None,
    step: bool = False,
    marker: bool = True,
) -> None:
    """Log how a line looks: its name, its colour, and a marker of its own."""
    said, color = drawable(name), color or COLORS[place % len(COLORS)]
    form = rr.components.InterpolationMode.auto("StepAfter" if step else "Linear")
    lines = rr.SeriesLines(names=said, colors=color, widths=_WIDTH, interpolation_mode=form)
    recording.log(entity, lines, static=True)
    if marker:
        points = rr.SeriesPoints(names=said, colors=color, markers=MARKERS[place % len(MARKERS)], marker_sizes=_MARK)
        recording.log(entity, points, static=True)
