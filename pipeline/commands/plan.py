"""`lessbench plan`: the motion that is best for what people want, as far as that is known, for a controller."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from scipy.interpolate import CubicSpline

from pipeline.answers.tables import NEXT, PERSON, answer_lines, group_of
from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.weights import WeightDraws, weighted_quantiles
from pipeline.commands.answer import answer_of
from pipeline.errors import SceneError, StageError, one_of
from pipeline.formats.files.atomic import folder_written_whole, written_whole
from pipeline.formats.mcap.plan_writer import TimedMotion, write_plan
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.replay.contacts import with_drawn_solids
from pipeline.replay.features import bind_features
from pipeline.replay.planning import Planning
from pipeline.replay.replay import body_positions
from pipeline.replay.room import Room, task_anchor
from pipeline.replay.scene import Scene
from pipeline.stages.inspect import replay_of
from pipeline.stages.registry import parameters
from pipeline.terminal import say
from pipeline.trajectories.best_in_expectation import Plan, bounded, plan_in_expectation
from pipeline.trajectories.optimise import Search
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.random_streams import child_rng
from pipeline.views.rerun.plan import write_plan_view
from pipeline.vocabulary import ALL, TASK_ANCHOR, model_name
from pipeline.workspace.choice_sets import Chosen, choice_tables, read_choices
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.scenes import load_task_scene
from pipeline.workspace.trust import register_task_kinds

FOLDER = "plan"  # in the task's folder of datasets
RESTARTS, SEARCHED = 3, 8  # searches for the mean, and for single draws of the belief
SEARCH = Search(iterations=60)
STATES_HZ = 100
CLEARANCE_M = 0.01  # as contacts are looked for at steps, and the motion between waypoints is not quite straight


@dataclass(frozen=True)
class Wanted:
    """What to plan.

    Attributes:
        person: for whom; None: for someone new.
        model: whose weights.
        contacts: whether the arm may touch nothing.
    """

    person: str | None
    model: str
    contacts: bool


def run(project: Project, name: str, wanted: Wanted) -> None:
    """Plan, say what the plan is, and write it into `datasets/<task>/plan`.

    Raises:
        StageError: there are no weights yet, nobody is called so, or nothing can be planned.
        SceneError, TableError: see `Room` and `TaskTables`.
    """
    task = project.params.task(name)
    draws, people = _belief(project, name, wanted)
    with recorded_run(project, "plan", name) as record, TaskTables(choice_tables(project, name)) as tables:
        tables.check()
        chosen = read_choices(tables, project, parameters("explore", name))
        register_task_kinds(project, task)
        scene = load_task_scene(project, task)
        mine = _rows(chosen, people)
        anchor = _anchor(scene, task.anchor, chosen, mine, name)
        room, roomy = (
            _room(scene, task.surface, wanted.contacts, anchor, clearance_m) for clearance_m in (0.0, CLEARANCE_M)
        )
        specs = {feature: dict(task.features[feature]) for feature in chosen.features}
        features, length = bind_features(scene, specs), project.params.ingest.waypoints
        known, raw = chosen.known(mine[0])
        scaled = raw / chosen.scale
        narrow = False
        try:
            plan = _planned(project, Planning(roomy, features, length), chosen.scale, draws, scaled, known)
        except StageError:
            if room.contacts is None:
                raise
            plan, narrow = _planned(project, Planning(room, features, length), chosen.scale, draws, scaled, known), True
        duration_s = float(np.median(chosen.people["duration_s"].to_numpy()[mine]))
        points, states = timed(plan.waypoints, duration_s)
        clear = room.admissible(states.positions[None]).item()
        lines = _lines(name, wanted, chosen, plan, draws, scaled, duration_s)
        lines += _clear(room, wanted, clear, states, scene)
        if narrow:
            lines.append(f"  no motion with {100 * CLEARANCE_M:g} cm of clearance was found, so it was planned without")
        answer = answer_lines(answer_of(project, name))
        verdict = next(line for line in answer if not line.startswith(" ") and line != answer[0])
        lines.append(f"the answer that it rests on: {verdict}" if verdict != "trust" else "the answer can be trusted")
        target = project.datasets / name / FOLDER
        with folder_written_whole(target) as folder:
            about = {"task": name, "for": wanted.person or "someone new", "model": wanted.model}
            write_plan(folder / "plan.mcap", scene.joints, points, states, about)
            _write_csv(folder / "plan.csv", scene, points)
            _write_view(folder / "plan.rrd", name, scene, plan, chosen, duration_s, [*lines, "", *answer])
        record.produced = f"plan.mcap, plan.csv and plan.rrd in {project.shown(target)}"
    for line in lines:
        say(line)


def _belief(project: Project, name: str, wanted: Wanted) -> tuple[WeightDraws, str | None]:
    """The draws to plan for."""
    path = project.table(name, "weights")
    if not path.exists():
        raise StageError(
            f"{project.shown(path)}: there are no weights yet; run `dvc repro`, or `lessbench conclude {name}`"
        )
    with OpenTable(path, "weights") as table:
        rows = table.read(where=pl.col("model") == wanted.model)
    if rows.is_empty():
        raise StageError(f"{project.shown(path)}: has no model {wanted.model!r}; --model may be less or boltzmann")
    names = rows.filter(kind=PERSON)["participant"].unique().sort().to_list()
    if wanted.person is not None and wanted.person not in names:
        raise StageError(f"{name} has no demonstration of {wanted.person!r}; there are {one_of(names)}")
    kind = NEXT if wanted.person is None else PERSON
    return group_of(rows, kind, wanted.person or ALL), wanted.person


def _rows(chosen: Chosen, person: str | None) -> list[int]:
    people = chosen.people["participant"].to_list()
    return [row for row, who in enumerate(people) if person in (None, who)]


def _anchor(scene: Scene, anchor: str, chosen: Chosen, mine: Sequence[int], name: str) -> Anchor:
    """Where the plan starts and ends: as the task's alternatives do, or as the first demonstration of the person."""
    if anchor == TASK_ANCHOR:
        return task_anchor(scene)
    if len(mine) == len(chosen.people) > 1:
        raise StageError(
            f"tasks.{name}.anchor is {anchor}, so there is no one start and goal to plan for; say whose with --for"
        )
    path = chosen.people["waypoints"].to_numpy()[mine[0]].astype(np.float64)
    return Anchor(path[0], path[-1])


def _room(scene: Scene, surface: str | None, contacts: bool, anchor: Anchor, clearance_m: float) -> Room:
    """The room for the plan, which is made with a clearance and checked without.

    Where the scene lets nothing touch, solids that are drawn count, and if none is, contacts are not looked at.
    """
    try:
        try:
            return Room.of(scene, surface, contacts, anchor, "the plan", clearance_m)
        except SceneError:
            if not contacts:
                raise
        try:
            return Room.of(with_drawn_solids(scene), surface, True, anchor, "the plan", clearance_m)
        except SceneError:
            return Room.of(scene, surface, False, anchor, "the plan")
    except StageError as error:
        if not contacts:
            raise
        raise StageError(f"{str(error).rstrip('.')}; or plan without contacts: --no-contacts") from None


def _planned(
    project: Project, planning: Planning, scale: FloatArray, draws: WeightDraws, scaled: FloatArray, known: FloatArray
) -> Plan:
    def assess(waypoints: FloatArray) -> tuple[FloatArray, BoolArray]:
        terms, allowed = planning.assess(waypoints)
        return terms / scale, allowed

    scene = planning.room.scene
    return plan_in_expectation(
        [child_rng(project.params.seed, "plan", number) for number in range(RESTARTS + SEARCHED)],
        planning.room.anchor, draws.omega, draws.weight,
        bounded(assess, scaled.min(axis=0), scaled.max(axis=0)),
        lower=scene.lower, upper=scene.upper, n_waypoints=planning.waypoints, candidates=known,
        restarts=RESTARTS, search=SEARCH,
    )  # fmt: skip


def timed(waypoints: FloatArray, duration_s: float) -> tuple[TimedMotion, TimedMotion]:
    """The motion through the waypoints (T, J), evenly in time and at rest at both ends.

    Between waypoints it is a cubic spline, so velocities are smooth.

    Returns:
        The motion at its waypoints, and `STATES_HZ` times a second.
    """
    spline = CubicSpline(np.linspace(0, duration_s, len(waypoints)), waypoints, bc_type="clamped")
    found = []
    for count in (len(waypoints), max(2, round(duration_s * STATES_HZ) + 1)):
        time_ns = np.round(np.linspace(0, duration_s, count) * 1e9).astype(np.int64)
        values = [spline(time_ns / 1e9, order) for order in range(3)]
        found.append(TimedMotion(time_ns, *values))
    return found[0], found[1]


def _lines(
    name: str, wanted: Wanted, chosen: Chosen, plan: Plan, draws: WeightDraws, scaled: FloatArray, duration_s: float
) -> list[str]:
    share = (scaled < plan.features).mean(axis=0)
    places = ", ".join(
        f"{feature} {value:.3g} (more than {100 * part:.0f} % of the motions that people chose from)"
        for feature, value, part in zip(chosen.features, plan.features * chosen.scale, share, strict=True)
    )
    most = float(weighted_quantiles(plan.regret[:, None], draws.weight, [0.9])[0, 0])
    lead = plan.expected_reward - float((scaled @ draws.mean).max())
    return [
        f"{name}: the motion that is best for {wanted.person or 'someone new'} under {model_name(wanted.model)}, "
        f"{duration_s:.1f} s",
        f"  {places}",
        f"  expected reward: {abs(lead):.2f} nat {'above' if lead >= 0 else 'below'} the best of them",
        f"  expected loss from not knowing the weights: {plan.expected_regret:.2f} nat (90 % probable: below "
        f"{most:.2f})",
        f"  for other plausible weights, the best motion is {plan.change.min():.2f} to {plan.change.max():.2f} rad "
        "away from this one (root mean square)",
    ]


def _clear(room: Room, wanted: Wanted, clear: bool, states: TimedMotion, scene: Scene) -> list[str]:
    within = bool(((states.positions >= scene.lower) & (states.positions <= scene.upper)).all())
    faults = {"limits": "passes a limit"}
    if room.top is not None:
        faults["surface"] = "goes under the surface"
    if room.contacts is not None:
        faults["contacts"] = "has a contact"
    said = f"{STATES_HZ} poses a second were checked ({', '.join(faults)})"
    lines = [f"  {said}: {'no contact, and ' if room.contacts else ''}no limit is passed"]
    if not (clear and within):
        lines = [f"  careful: between its waypoints the motion {' or '.join(faults.values())}; {said}"]
    lines += [f"  {remark}" for remark in room.remarks]
    if wanted.contacts and room.contacts is None:
        lines.append("  contacts were not checked: no geom of the arm can touch another, and none is drawn")
    elif room.contacts is not None and room.scene is not scene:
        lines.append(
            "  the scene lets nothing touch (contype and conaffinity), so all drawn solids count: those that move "
            "against those that stay"
        )
    return lines


def _write_csv(path: Path, scene: Scene, points: TimedMotion) -> None:
    """One row for each waypoint: time, joints, and the end effector."""
    tip = body_positions(scene, points.positions[None], [scene.end_effector])[scene.end_effector][0]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time_s", *scene.joints, "x_m", "y_m", "z_m"])
    for time, pose, place in zip(points.time_ns / 1e9, points.positions, tip, strict=True):
        writer.writerow([f"{value:.9g}" for value in (time, *pose, *place)])
    with written_whole(path) as stream:
        stream.write(text.getvalue().encode())


def _write_view(
    path: Path, name: str, scene: Scene, plan: Plan, chosen: Chosen, duration_s: float, lines: Sequence[str]
) -> None:
    shown = chosen.people["waypoints"].to_numpy().astype(np.float64)
    tip = scene.end_effector
    paths = body_positions(scene, np.concatenate([plan.waypoints[None], plan.alternatives, shown]), [tip])[tip]
    mine, others, demonstrations = np.split(paths, [1, 1 + len(plan.alternatives)])
    replay = replay_of(scene, plan.waypoints[None], np.array([duration_s]))
    text = "\n".join(f"- {line.strip()}" if line.startswith("  ") else f"\n{line}\n" for line in lines)
    write_plan_view(path, name, replay, mine[0], others, demonstrations, text)
