"""Stage: the choice space explored, so that the answer does not depend on who sampled the alternatives."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice.explored import Region
from pipeline.errors import ArgumentError, StageError
from pipeline.formats.parquet.tables import empty_table, write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import Explore, Task
from pipeline.replay.features import bind_features
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.stages.registry import parameters, stage
from pipeline.studies.exploration import convergence_rows, exploration_name, explored_posterior_rows
from pipeline.studies.posteriors import Group, groups_of, hypotheses
from pipeline.terminal import say
from pipeline.trajectories.exploration.archive import GRID_FEATURES
from pipeline.trajectories.exploration.choice_space import default_effort_multiple, default_width
from pipeline.vocabulary import LESS, TASK_ANCHOR, WORKING, model_name
from pipeline.workspace.anchors import Ends, ends_of
from pipeline.workspace.compute.executor import workers
from pipeline.workspace.compute.exploration import (
    Declared,
    Explored,
    Hypotheses,
    Plan,
    Rounds,
    explored,
    with_fine_cells,
)
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene
from pipeline.workspace.trust import register_task_kinds

MOST_SEEDS = 5000  # trajectories of the working set from which maps begin
CELL, CELLS_OF_EFFORT = 0.05, 36  # width of a cell, or, if that is more, this part of the bound on efficiency
DECAY = 2.0


@dataclass(frozen=True, eq=False)
class Inputs:
    """What the stage has read.

    Attributes:
        ends: the anchors.
        shown: (n, T, J) waypoints of the demonstrations.
        groups: those that get a posterior.
        phi: (n, F) scaled features of the demonstrations.
        features: JSON of the task's features in the order of the scales.
        scales: (F,).
        efficiency: scales of the features that are the effort.
        asked: the hypotheses.
    """

    ends: Sequence[Ends]
    shown: FloatArray
    groups: Sequence[Group]
    phi: FloatArray
    features: str
    scales: FloatArray
    efficiency: Sequence[float]
    asked: Hypotheses


def run(project: Project, name: str) -> None:
    """Write the tables about the explored choice space of the task `name`."""
    task, settings = project.params.task(name), project.params.explore
    with (
        recorded_run(project, "explore", name) as record,
        TaskTables(project.tables(name, stage("explore").reads)) as tables,
        workers() as pool,
    ):
        own_kinds = register_task_kinds(project, task)
        scene = load_task_scene(project, task)
        tables.check()
        given = read_inputs(project, name, scene, tables)
        stated = provenance(
            project, parameters("explore", name), [*tables.values(), *scene_files(scene.path), *own_kinds],
            model=model_hash(scene),
        )  # fmt: skip
        plan, found, reason = None, None, left_out(task, settings)
        if reason is None:
            try:
                plan = plan_of(project, task, given, _seeds(tables, settings.explorations))
                declared = plan.declared
                say(
                    f"explore {name}: effort up to {declared.effort_multiple:g} times the least, base measure "
                    f"{declared.width:.3f} rad, cells of {plan.cell:.3f}",
                    error=True,
                )
                found = explored(pool, plan, f"explore {name}")
            except (ArgumentError, StageError) as error:
                plan, reason = None, str(error)
        lengths = {"T": given.shown.shape[1], "J": given.shown.shape[2], "F": given.phi.shape[1]}
        made = _tables(name, given, plan, found) if plan and found else {}
        for table in stage("explore").makes[1:]:
            rows = made.get(table, empty_table(table, lengths))
            write_table(project.table(name, table), table, rows, stated)
        spaces = _spaces(project, name, scene, given, plan, reason)
        write_table(project.table(name, "choice_space"), "choice_space", spaces, stated)
        if plan is None or found is None:
            record.produced = "nothing"
            record.notes.append(f"the choice space is not explored, so the sampled sets are shown: {reason}")
            return
        record.produced = f"{len(plan.seeds)} explorations of {len(found.maps[0].archive):,} cells"
        record.notes += [note for model, one in found.models.items() if (note := _not_converged(model, one))]


def left_out(task: Task, settings: Explore) -> str | None:
    """Why a task is not explored."""
    if not settings.explorations:
        return "explore.explorations is 0"
    if task.anchor != TASK_ANCHOR:
        return (
            f"the task's anchor is {task.anchor}, so each demonstration has its own ends and its own choice space; "
            "only a space that all share is explored, as with anchor: task"
        )
    if len(task.features) > GRID_FEATURES:
        return (
            f"the task has {len(task.features)} features, and a map of more than {GRID_FEATURES} has more cells than a "
            "search fills"
        )
    if task.collisions:
        return "the task's collisions is true, and contacts are too slow to look at for a million trajectories"
    return None


def read_inputs(project: Project, name: str, scene: Scene, tables: TaskTables) -> Inputs:
    """What a choice space is declared from and what is asked about it.

    Raises:
        StageError: tables and parameters name different features.
    """
    task, infer = project.params.task(name), project.params.infer
    people, scales = tables["demonstrations"].read(), tables["scales"].read()
    names = scales["feature"].to_list()
    absent = [feature for feature in names if feature not in task.features]
    if absent or len(names) != len(task.features):
        raise StageError(
            f"{tables['scales'].path}: has the features {', '.join(names)} and params.yaml has "
            f"{', '.join(task.features)}; run `dvc repro`"
        )
    specs = {feature: dict(task.features[feature]) for feature in names}
    scale = scales["scale"].to_numpy()
    shown = people["waypoints"].to_numpy().astype(np.float64)
    efficiency = [value for feature, value in zip(names, scale, strict=True) if specs[feature]["kind"] == "efficiency"]
    thetas = hypotheses(task, infer, names, tuple(scales["direction"]))
    return Inputs(
        ends_of(scene, task, people), shown, groups_of(people.select("demonstration_id", "participant")),
        bind_features(scene, specs).evaluate(shown) / scale, json.dumps(specs), scale, efficiency,
        Hypotheses(thetas, np.array(infer.betas)),
    )  # fmt: skip


def plan_of(project: Project, task: Task, given: Inputs, seeds: Sequence[FloatArray]) -> Plan:
    """How the choice space of a task is explored.

    Args:
        project: with the parameters.
        task: whose space.
        given: see `read_inputs`.
        seeds: for each exploration (N, T, J) waypoints to begin with.

    Raises:
        ArgumentError, StageError: the space is not possible, or cannot be searched.
    """
    settings, (ends,) = project.params.explore, given.ends
    declared = Declared(
        ends, given.features, given.scales, project.params.ingest.waypoints,
        settings.effort_multiple or default_effort_multiple(given.shown),
        settings.width_rad or default_width(given.shown), settings.modes, settings.largest_step,
    )  # fmt: skip
    most = declared.space().most_effort
    cell = settings.cell or _cell(len(given.scales), [most / scale for scale in given.efficiency])
    plan = Plan(
        declared, given.asked, given.phi, [group[2] for group in given.groups],
        seeds, cell, settings.evaluations, settings.most_evaluations,
        settings.tolerance, project.params.seed,
    )  # fmt: skip
    return plan if settings.cell else with_fine_cells(plan)


def _cell(features: int, bounds: Sequence[float]) -> float:
    """The default width of a cell, in scaled features, before it is made finer (see `with_fine_cells`).

    As a search fills some thousand cells, they are wider where there are more than three features.

    Args:
        features: how many.
        bounds: the bound on effort, by the scale of each feature that is the effort.
    """
    return max(CELL, float(CELL ** (3 / features)), *(bound / CELLS_OF_EFFORT for bound in bounds))


def _seeds(tables: TaskTables, explorations: int) -> list[FloatArray]:
    """For each exploration trajectories of other samplers; of one sampler, or of few, other trajectories."""
    (working,) = [one for one in tables.contents("alternatives").sets if one.set_id == WORKING]
    every = -(-working.rows // MOST_SEEDS)
    rows = pl.concat(
        [part[::every] for part in tables["alternatives"].pieces(working.pieces, ["sampler", "waypoints"])]
    )
    samplers = sorted(rows["sampler"].unique())
    number = rows["sampler"].replace_strict(samplers, range(len(samplers)), return_dtype=pl.Int64)
    if len(samplers) < explorations:
        number = pl.Series(np.arange(rows.height))
    return [
        rows.filter(number % explorations == one)["waypoints"].to_numpy().astype(np.float64)
        for one in range(explorations)
    ]


def _tables(name: str, given: Inputs, plan: Plan, found: Explored) -> dict[str, pl.DataFrame]:
    """Rows of all tables but choice_space."""
    asked, groups, space = plan.asked, given.groups, plan.declared.space()
    tables: dict[str, list[pl.DataFrame]] = {}
    for model, one in found.models.items():
        about = {"task": name, "model": model}
        for number, weighted in enumerate(one.rows):
            waypoints = space.decode(found.maps[number].archive.z) if model == LESS else None
            tables.setdefault("explored", []).append(_weighted_rows(number, model, weighted, waypoints))
        rows = explored_posterior_rows(groups, one.posteriors[-1], asked.thetas, asked.betas, about)
        tables.setdefault("explored_posteriors", []).extend(rows)
        costs = [vars(cost) for cost in one.costs]
        settled = convergence_rows(groups, one.convergence, one.posteriors, asked.betas, costs, about)
        tables.setdefault("convergence", []).append(settled)
    return {table: pl.concat(rows) for table, rows in tables.items()}


def _weighted_rows(number: int, model: str, weighted: Region, waypoints: FloatArray | None) -> pl.DataFrame:
    """Rows of the table explored for one exploration and model."""
    rows = pl.DataFrame({"features": weighted.features, "log_weight": weighted.log_w})
    paths = None if waypoints is None else waypoints.astype(np.float32).astype(np.float64)
    return rows.with_columns(
        exploration=pl.lit(exploration_name(number)),
        model=pl.lit(model),
        row=pl.int_range(pl.len()),
        waypoints=pl.lit(None) if paths is None else pl.Series(paths),
    )


def _spaces(
    project: Project, name: str, scene: Scene, given: Inputs, plan: Plan | None, reason: str | None
) -> pl.DataFrame:
    """Rows of the table choice_space."""
    task, settings = project.params.task(name), project.params.explore
    joints, waypoints = given.shown.shape[2], project.params.ingest.waypoints
    declared = plan.declared if plan else None
    rows = []
    for ends in given.ends:
        anchor = plan.declared.ends.room().anchor if plan else ends.anchor
        step = anchor.goal - anchor.start
        rows.append(
            {
                "task": name,
                "anchor": ends.label,
                "explored": plan is not None,
                "reason": reason,
                "start": anchor.start,
                "goal": anchor.goal,
                "lower": scene.lower,
                "upper": scene.upper,
                "largest_step": None if settings.largest_step is None else [settings.largest_step] * joints,
                "surface": task.surface,
                "waypoints": waypoints,
                "modes": settings.modes,
                "decay": DECAY,
                "width_rad": declared.width if declared else settings.width_rad,
                "effort_multiple": declared.effort_multiple if declared else settings.effort_multiple,
                "effort_from": "demonstrations" if settings.effort_multiple is None else "declared",
                "least_effort": float(step @ step) / (waypoints - 1),
                "cell": plan.cell if plan else settings.cell,
            }
        )
    return pl.DataFrame(rows, schema=empty_table("choice_space", {"J": joints}).schema)


def _not_converged(model: str, one: Rounds) -> str | None:
    record = one.convergence
    if record.reached:
        return None
    further = record.further_evaluations
    more = "no number of evaluations can be foreseen" if further is None else f"about {further:,} more would do"
    return (
        f"{model_name(model)}: explorations differ by {record.disagreement:.3g} nats a pair and have changed by "
        f"{record.change:.3g} in the last round, {record.tolerance:g} is wanted; {more}, see `lessbench enough`"
    )
