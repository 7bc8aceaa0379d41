"""Stage: the recording of a task for the Rerun viewer, made from the tables alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

from pipeline.answers.tables import NEXT, answer_markdown
from pipeline.arrays import FloatArray, IntArray
from pipeline.choice import entropy
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import read_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import Task
from pipeline.replay.along import along
from pipeline.replay.features import bind_features
from pipeline.replay.geometry import body_poses, extract_geometry
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene
from pipeline.studies.support import chance_notes
from pipeline.trajectories.random_streams import child_rng
from pipeline.views.headline import in_words
from pipeline.views.rerun.recording import write_inspection
from pipeline.views.rerun.records import (
    AlternativeSet,
    FeatureSpace,
    Inspection,
    Motions,
    Predicted,
    Replay,
    Weights,
)
from pipeline.views.task_summary import replay_samples
from pipeline.views.task_view import INPUTS, TaskView, read_waypoints, task_view
from pipeline.vocabulary import ALL, BOLTZMANN, INDEPENDENT, LESS, SAMPLER_SHIFT, SINGLE, TASK_ANCHOR, WORKING
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.scenes import load_task_scene
from pipeline.workspace.trust import register_task_kinds

REGIMES, MODELS = (INDEPENDENT, SAMPLER_SHIFT), (BOLTZMANN, LESS)
PATHS = 70  # of one set that are drawn; more hide each other and the scene
POINTS = 2000  # alternatives in the cube of three features
AXES = 3


def run(project: Project, name: str) -> None:
    """Write inspect.rrd of the task `name`."""
    task = project.params.task(name)
    with recorded_run(project, "inspect", name, (project.datasets / name / "inspect.rrd",)) as record:
        scene = load_task_scene(project, task)
        path = project.datasets / name / "inspect.rrd"
        write_inspection(path, inspection(project, name, task, scene))
        record.produced = f"{path.stat().st_size / 1e6:.1f} MB"


def inspection(project: Project, name: str, task: Task, scene: Scene) -> Inspection:
    """What the recording of a task shows, from its tables.

    Raises:
        TableError: a table is missing or not what it should be.
        ParameterError: see `register_task_kinds`.
    """
    register_task_kinds(project, task)
    with TaskTables(project.tables(name, INPUTS)) as tables:
        view = task_view(tables, project.table(name, "explored_posteriors"))
        alternatives = _alternatives(project, name, scene, view, tables["alternatives"])
        predicted = _predicted(project, name, scene)
    tip = scene.end_effector
    paths = view.demonstrations["waypoints"].to_numpy()
    return Inspection(
        task=name,
        replay=replay_of(scene, paths, view.demonstrations["duration_s"].to_numpy()),
        demonstration_ids=tuple(view.demonstrations["demonstration_id"]),
        demonstration_paths=body_positions(scene, paths, [tip])[tip],
        motions=_motions(task, scene, view, paths),
        alternatives=alternatives,
        curves=view.curves,
        map=view.map,
        space=_space(project, name, view),
        theta_labels=view.labels,
        theta_meaning=view.meaning,
        posteriors={model: np.stack([b.marginal_theta for b in steps]) for model, steps in view.beliefs.items()},
        robustness=_robustness(project, name),
        weights=_weights(project, name, view),
        nearest_truth=view.nearest_truth,
        predicted=predicted,
        summary=_summary(project, name, task, view),
    )


def _alternatives(
    project: Project, name: str, scene: Scene, view: TaskView, table: OpenTable
) -> tuple[AlternativeSet, ...]:
    """The working set, which is shown, and the independent sets, which wait to be selected; of each a seeded share."""
    working = view.alternatives.with_columns(log_weight=pl.Series(view.log_weights))
    drawn = []
    for rows in (working, *view.independent.partition_by("set_size", "set_id", maintain_order=True)):
        size, set_id = rows.select("set_size", "set_id").row(0)
        drawn.append(rows[_some(project, rows.height, PATHS, int(size), str(set_id))])
    waypoints = read_waypoints(table, pl.concat([rows["alternative_id"] for rows in drawn]))
    paths = body_positions(scene, waypoints, [scene.end_effector])[scene.end_effector]
    found, ends = [], np.cumsum([rows.height for rows in drawn])
    for rows, mine in zip(drawn, np.split(paths, ends[:-1]), strict=True):
        size, set_id = rows.select("set_size", "set_id").row(0)
        shown = set_id == WORKING
        found.append(
            AlternativeSet(
                name=(WORKING,) if shown else (f"sets of {size}", f"set {set_id}"),
                samplers=tuple(rows["sampler"]),
                paths=mine,
                log_weights=rows["log_weight"].to_numpy(),
                shown=shown,
            )
        )
    return tuple(found)


def _predicted(project: Project, name: str, scene: Scene) -> dict[str, Predicted]:
    """What someone new would do under each model; nothing if nothing is predicted yet."""
    paths = [project.table(name, one) for one in ("predicted_motion", "likely_paths")]
    if not all(path.exists() for path in paths):
        return {}
    motion, likely = (
        read_table(path, one).filter(kind=NEXT)
        for path, one in zip(paths, ("predicted_motion", "likely_paths"), strict=True)
    )
    found = {}
    for model in motion["model"].unique(maintain_order=True):
        tube = motion.filter(model=model).sort("waypoint")
        likeliest = likely.filter(model=model).sort("rank")["waypoints"].to_numpy().astype(np.float64)
        drawn = body_positions(scene, likeliest, [scene.end_effector])[scene.end_effector]
        low, median, high = (tube[column].to_numpy() for column in ("low", "median", "high"))
        found[str(model)] = Predicted(low, median, high, drawn)
    return found


def _motions(task: Task, scene: Scene, view: TaskView, waypoints: FloatArray) -> Motions:
    """The demonstrations along their waypoints."""
    features = bind_features(scene, {feature: task.features[feature] for feature in view.features})
    return Motions(
        joints=scene.joints,
        joint_units=scene.joint_units,
        axes=view.axes,
        waypoints=waypoints,
        along=along(features, waypoints),
        raw=view.demonstration_phi,
    )


def _weights(project: Project, name: str, view: TaskView) -> Weights | None:
    """What everybody wants, by the models; nothing if nothing is concluded yet."""
    path = project.table(name, "weights_summary")
    if not path.exists():
        return None
    rows = read_table(path, "weights_summary").filter(kind="group", quantity="direction")
    whole = [
        part for part in rows.partition_by("model", maintain_order=True) if set(part["feature"]) == {*view.features}
    ]
    if not whole:
        return None
    place = {model: number for number, model in enumerate(view.beliefs)}  # the order of the posteriors
    whole.sort(key=lambda part: place.get(part["model"][0], len(place)))
    return Weights(view.features, pl.concat(whole), None if view.truth is None else view.truth.mean)


def _space(project: Project, name: str, view: TaskView) -> FeatureSpace | None:
    """The three features that the belief gives the largest weights, if there are as many."""
    if len(view.features) < AXES:
        return None
    first, second, third = view.by_weight[:AXES]
    axes = [first, second, third]
    some = _some(project, len(view.phi), POINTS, "space")
    return FeatureSpace(
        labels=(view.axes[first].label, view.axes[second].label, view.axes[third].label),
        alternatives=view.shown(view.phi)[some][:, axes],
        log_weights=view.log_weights[some],
        demonstrations=view.shown(view.demonstration_phi)[:, axes],
        wanted={
            model: _reward(view, steps[-1].marginal_theta @ steps[-1].thetas) for model, steps in view.beliefs.items()
        },
        truth=None if view.truth is None else _reward(view, view.truth.mean),
    )


def _reward(view: TaskView, theta: FloatArray) -> FloatArray:
    """(3,) the reward for each unit of the axes of the feature space, of weights (F,) on scaled features."""
    per = np.array([axis.per for axis in view.axes])
    return np.asarray((theta * per / view.scale)[list(view.by_weight[:AXES])])


def _some(project: Project, count: int, most: int, *labels: str | int) -> IntArray:
    """Row numbers in order: all, or as many as are to be drawn."""
    if count <= most:
        return np.arange(count)
    return np.sort(child_rng(project.params.seed, "inspect", *labels).choice(count, most, replace=False))


def _robustness(project: Project, name: str) -> pl.DataFrame | None:
    """KLAggregate of single demonstrations under the models of the paper, if that study was run."""
    path = project.table(name, "robustness_summary")
    if not path.exists():
        return None
    rows = read_table(path, "robustness_summary").filter(
        pl.col("regime").is_in(REGIMES) & pl.col("model").is_in(MODELS), demonstrations=SINGLE
    )
    return rows if rows.height and (rows["value"] > 0).all() else None


def replay_of(scene: Scene, paths: FloatArray, durations_s: FloatArray) -> Replay:
    """The arm in its scene along waypoints (n, T, J), one demonstration after another, each as long as it took (n,)."""
    configurations, time_s, demonstration = replay_samples(paths, durations_s)
    positions, quaternions = body_poses(scene, configurations)
    return Replay(extract_geometry(scene.model), positions, quaternions, time_s, demonstration)


def _anchored(view: TaskView) -> str:
    anchor = view.alternatives["anchor"][0]
    return (
        ""
        if anchor == TASK_ANCHOR
        else f"; each demonstration has its own, drawn and summed up here are those of {anchor}"
    )


def _drawn(view: TaskView) -> str:
    count = view.alternatives.height
    paths = f"all {count}" if count <= PATHS else f"{PATHS} of {count:,}, drawn at random,"
    others = view.independent.select("set_size", "set_id").n_unique()
    return f"{paths} alternatives of the working set; at most {PATHS} of each of the {others} other sets"


def _answer(project: Project, name: str) -> list[str]:
    """The answer as `lessbench answer` says it; nothing if there is none yet."""
    path = project.table(name, "answers")
    if not path.exists():
        return []
    return [*answer_markdown(read_table(path, "answers")), ""]


def _summary(project: Project, name: str, task: Task, view: TaskView) -> str:
    origin = "simulated" if view.demonstrations["simulated"].all() else "recorded"
    lines = [
        f"### {name}",
        "",
        *_answer(project, name),
        f"**{view.demonstrations.height} {origin} demonstrations** from `{task.recordings}`, "
        f"{view.alternatives.height:,} alternatives ({project.params.sample.sampler}{_anchored(view)}), scene "
        f"`{Path(task.scene).name}`.",
        "",
        "| model | most probable | P(theta) | beta | thetas still plausible |",
        "|---|---|---|---|---|",
    ]
    together = view.fits.filter(demonstration_id=ALL, participant=ALL)
    better = dict(together.select("model", "better").iter_rows())
    for model, steps in view.beliefs.items():
        final = steps[-1]
        best = final.map_index
        beta = final.betas[int(np.exp(final.log_probability).sum(axis=0).argmax())]
        effective = np.exp(entropy(final.marginal_theta))
        lines.append(
            f"| {model} | {in_words(view.labels[best], better[model])} | {final.marginal_theta[best]:.3f} | {beta:g} | "
            f"{effective:.1f} of {len(view.labels)} |"
        )
    lines += [
        "",
        *(f"**{sentence[0].upper()}{sentence[1:]}.**\n" for sentence in chance_notes(view.fits)),
        f"Weights in words are {view.meaning}.",
        "",
        f"All demonstrations together, {view.over}. Thetas still plausible: the exponential of the entropy.",
        "",
        f"Bandwidth of the working set: {view.bandwidth:.4f} in scaled features ({project.params.density.bandwidth}).",
        "",
        f"Drawn: {_drawn(view)}. Other sets and single samplers: panel on the left, `scene`, `alternatives`, the eyes.",
        "",
        f"From `datasets/{name}/tables`: arm and paths `demonstrations`, `alternatives`; densities `features`, "
        "`densities`, `scales`; bars `explored_posteriors` or `posteriors`; KLAggregate (median over participants, "
        "95 % interval) `robustness_summary`. All in `datasets/catalog.duckdb`; ask with `lessbench sql`.",
    ]
    return "\n".join(lines)
