"""The layout of an inspection in the viewer: a page about people and one about the choices that they had."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun.blueprint as rrb

from pipeline.views import palette
from pipeline.views.rerun import posterior as posterior_view
from pipeline.views.rerun.density import curve_bounds, curve_entity, map_bounds
from pipeline.views.rerun.labels import drawable, part
from pipeline.views.rerun.robustness import spread_bounds
from pipeline.views.rerun.scene import PREDICTED, alternatives_entity
from pipeline.views.rerun.series import belief_views, motion_views
from pipeline.views.rerun.timelines import TIMELINE
from pipeline.views.rerun.weights import weights_bounds
from pipeline.vocabulary import BOLTZMANN, LESS, model_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    import polars as pl

    from pipeline.arrays import FloatArray
    from pipeline.views.rerun.records import AlternativeSet, Inspection, Replay
    from pipeline.views.task_summary import DensityMap

_SHORT_REPLAY_S = 60.0  # a longer replay is played faster, so that it takes about this time
# Distance of the camera from what it looks at, and how far below the middle it looks: shares of the picture's diagonal.
_DISTANCE, _LOWER = 0.86, 0.05
# Angle between where the hand reaches and the camera, seen from above, and in which share of the time it may be less.
_ASIDE, _SELDOM = np.radians(50.0), 0.1
_COLOURS = {BOLTZMANN: "blue", LESS: "orange"}  # of `palette.MODELS`, in words


def layout(inspection: Inspection) -> rrb.Blueprint:
    """The views of an inspection, and a replay that starts by itself and takes at most about a minute.

    They are on two pages, so that each has room in a small window: what people did and what follows, and the choices
    that they had.
    """
    length_s = float(inspection.replay.time_s[-1] - inspection.replay.time_s[0])
    time = rrb.TimePanel(
        state="collapsed",
        timeline=TIMELINE,
        play_state="playing",
        loop_mode="all",
        playback_speed=max(1.0, float(np.ceil(length_s / _SHORT_REPLAY_S))),
    )
    return rrb.Blueprint(
        rrb.Tabs(_people_page(inspection), _choices_page(inspection), active_tab=0),
        time,
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _people_page(inspection: Inspection) -> rrb.Container:
    believed: list[rrb.View] = [_posterior_view(inspection)]
    if inspection.weights is not None:
        name = "Weights (line: 90 % interval)"
        believed.append(page_view("weights", name, weights_bounds(len(inspection.weights.features))))
    above = rrb.Horizontal(_scene_view(inspection), _one_or_tabs(believed), column_shares=[8, 12])
    motions, longest_s = inspection.motions, float((inspection.end_s - inspection.start_s).max())
    below = rrb.Horizontal(
        motion_views(motions.axes, motions.joints, motions.joint_units, longest_s),
        belief_views(inspection.posteriors, len(inspection.theta_labels)),
        text_view(),
        column_shares=[10, 10, 11],
    )
    return rrb.Vertical(above, below, row_shares=[60, 40], name="People: motions and beliefs")


def _choices_page(inspection: Inspection) -> rrb.Container:
    views: list[rrb.View | rrb.Container] = [_curve_views(inspection), map_view(inspection.map)]
    if inspection.space is not None:
        truly = "" if inspection.space.truth is None else " (white: truly)"
        eye = rrb.EyeControls3D(position=(1.75, -0.85, 1.3), look_target=(0.5, 0.5, 0.4), eye_up=(0.0, 0.0, 1.0))
        views.append(
            rrb.Spatial3DView(
                origin="space", name=f"Three features, and arrows to what people want{truly}", background=_background(),
                line_grid=False, eye_controls=eye,
            )
        )  # fmt: skip
    if inspection.robustness is not None:
        views.append(_spread_view(inspection.robustness))
    return rrb.Grid(*views, grid_columns=2, name="Choices: alternatives and their features")


def _one_or_tabs(views: list[rrb.View]) -> rrb.View | rrb.Container:
    return views[0] if len(views) == 1 else rrb.Tabs(*views, active_tab=0)


def _scene_view(inspection: Inspection) -> rrb.View | rrb.Container:
    """The scene with what people could have done; if predictions are there, on a second page with these instead."""
    shown = [group.paths for group in inspection.alternatives if group.shown]
    moving = [inspection.demonstration_paths, *shown, inspection.replay.body_positions[:, 1:]]
    in_picture = np.concatenate([points.reshape(-1, 3) for points in moving])
    apart, hands = hidden(inspection.alternatives), inspection.demonstration_paths.reshape(-1, 3)
    if not inspection.predicted:
        return scene_view(inspection.replay, in_picture, apart, hands)
    chosen_from = scene_view(inspection.replay, in_picture, [*apart, PREDICTED], hands)
    wide = [f"{PREDICTED}/{part(model)}/interval" for model in inspection.predicted]
    expected = scene_view(inspection.replay, in_picture, ["scene/alternatives", *wide], hands)
    colours = ", ".join(f"{model_name(model)} {_COLOURS.get(model, 'green')}" for model in inspection.predicted)
    expected.name = f"Someone new: {colours}"
    return rrb.Tabs(chosen_from, expected, active_tab=0)


def scene_view(
    replay: Replay, in_picture: FloatArray, hidden_entities: Sequence[str], hands: FloatArray | None = None
) -> rrb.Spatial3DView:
    """The view of the arm in its scene.

    Args:
        replay: gives the position of the robot's base and of the scene's camera.
        in_picture: (P, 3) m, points that should be in the picture.
        hidden_entities: entities that are hidden until the user selects them.
        hands: (H, 3) m, where the hand comes, so that the arm is not seen end on; not looked at by default.
    """
    position, target = camera(in_picture, replay.body_positions[0, 1], replay.geometry.viewpoint, hands)
    return rrb.Spatial3DView(
        origin="scene",
        name="Demonstrations (pink), alternatives by LESS weight (blue low, yellow high)",
        background=_background(palette.ROOM),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 0.0, 1.0)),
        overrides={entity: rrb.EntityBehavior(visible=False) for entity in hidden_entities},
    )


def hidden(alternatives: Sequence[AlternativeSet]) -> list[str]:
    """The entities of the sets that are hidden until the user selects them."""
    return [alternatives_entity(group.name) for group in alternatives if not group.shown]


def camera(
    in_picture: FloatArray, base: FloatArray, viewpoint: FloatArray | None, hands: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Position and target of the viewer's camera, which looks at all points from the side of the scene's camera.

    Where the arm would come to point at that camera, and so be hidden behind its hand and the paths, the camera is
    turned aside. If the scene has no camera, it looks back at the robot from beyond the points, from one side and from
    above.

    Args:
        in_picture: (P, 3) m, points that should be in the picture.
        base: (3,) m, position of the robot's base.
        viewpoint: (3,) m, position of the scene's camera, or None.
        hands: (H, 3) m, where the hand comes; None if the arm may point anywhere.

    Returns:
        (3,) position and (3,) target, m.
    """
    low, high = in_picture.min(axis=0), in_picture.max(axis=0)
    target = (low + high) / 2
    direction = _beyond(target - base) if viewpoint is None else viewpoint - target
    if viewpoint is not None and hands is not None:
        direction = _aside(direction, hands - base)
    diagonal = np.linalg.norm(high - low)
    away = _DISTANCE * diagonal
    # a little lower: the table and what is on it matter more than the air above
    target = target - np.array([0.0, 0.0, _LOWER * diagonal])
    return target + away * direction / np.linalg.norm(direction), target


def _aside(direction: FloatArray, reached: FloatArray) -> FloatArray:
    """`direction`, turned about the vertical as little as makes the hand seldom reach within _ASIDE of it.

    Where the hand reaches all around, it is turned to where the arm points least at it.
    """
    azimuths = np.arctan2(reached[:, 1], reached[:, 0])
    turns = np.radians(np.arange(-180.0, 180.0, 5.0))
    own = np.arctan2(direction[1], direction[0])
    apart = np.abs((own + turns[:, None] - azimuths + np.pi) % (2 * np.pi) - np.pi)
    apart = np.quantile(apart, _SELDOM, axis=1)
    enough = np.minimum(apart, _ASIDE)
    best = min(np.flatnonzero(enough >= enough.max() - 1e-9), key=lambda one: (abs(turns[one]), turns[one]))
    across = float(np.hypot(direction[0], direction[1]))
    angle = own + turns[best]
    return np.array([across * np.cos(angle), across * np.sin(angle), direction[2]])


def _beyond(outward: FloatArray) -> FloatArray:
    angle = np.arctan2(outward[1], outward[0]) + np.radians(50.0)
    return np.array([np.cos(angle), np.sin(angle), np.tan(np.radians(24.0))])


def _posterior_view(inspection: Inspection) -> rrb.Spatial2DView:
    name = f"Posterior: {inspection.theta_meaning} (line: after all)"
    return page_view("posterior", name, posterior_view.page(inspection).bounds)


def _curve_views(inspection: Inspection) -> rrb.View | rrb.Container:
    views: list[rrb.View] = [
        page_view(curve_entity(curve.feature), f"{'' if place else 'Density: '}{curve.feature}", curve_bounds(curve))
        for place, curve in enumerate(inspection.curves)
    ]
    return rrb.Tabs(*views, active_tab=0)


def _spread_view(robustness: pl.DataFrame) -> rrb.Spatial2DView:
    return page_view("robustness", "KLAggregate (nats) against set size", spread_bounds(robustness))


def map_view(density: DensityMap) -> rrb.Spatial2DView:
    """The view of the density over two features."""
    return page_view("map", f"Density: {' and '.join(density.features)}", map_bounds(density))


def page_view(origin: str, name: str, bounds: tuple[tuple[float, float], tuple[float, float]]) -> rrb.Spatial2DView:
    """A view that shows the whole of a page."""
    across, down = bounds
    return rrb.Spatial2DView(
        origin=origin,
        name=drawable(name),
        background=_background(),
        visual_bounds=rrb.VisualBounds2D(x_range=across, y_range=down),
    )


def text_view(name: str = "Numbers, and where they came from") -> rrb.TextDocumentView:
    """The view of the summary."""
    return rrb.TextDocumentView(origin="summary", name=name)


def _background(color: palette.RGB = palette.BACKGROUND) -> rrb.Background:
    return rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=color)
