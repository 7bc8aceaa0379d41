"""Stage: the sets of each sampler drawn again and again, to tell what is the draw's, the sampler's and the people's."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.errors import StageError
from pipeline.formats.parquet.tables import empty_table, write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import ShiftedSampler, Task
from pipeline.replay.features import bind_features
from pipeline.replay.room import Room
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.stages.shift import Shifted, named_samplers
from pipeline.studies.posteriors import hypotheses
from pipeline.studies.robustness.problem import ChoiceSets, Demonstrations
from pipeline.studies.robustness.redraws import (
    Measured,
    Redraw,
    by_demonstration,
    density_likelihood,
    explored_scores,
    held_out_leads,
    leads,
    measure,
    no_scores,
    paper_tests,
    positions,
)
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import Sampler
from pipeline.vocabulary import BOLTZMANN, LESS
from pipeline.workspace.anchors import Ends, ends_of, shortened
from pipeline.workspace.choice_sets import demonstrations_of
from pipeline.workspace.compute.executor import workers
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene, loaded
from pipeline.workspace.trust import register_task_kinds

INPUTS = ("demonstrations", "features", "scales")
FURTHER = ("explored", "choice_space")  # if the choice space was explored


@dataclass(frozen=True, eq=False)
class Job:
    """What a worker needs for one draw of one sampler.

    Attributes:
        anchors: for each, what its sets are drawn with.
        label, draw: which sampler and draw.
        sets: how many of each size.
        specs: JSON of the features.
        people: the demonstrations, scaled.
        scale: (F,).
        thetas, betas: the hypotheses.
        bandwidth: how LESS selects it.
    """

    anchors: tuple[Shifted, ...]
    label: str
    draw: int
    sets: int
    specs: str
    people: Demonstrations
    scale: FloatArray
    thetas: FloatArray
    betas: FloatArray
    bandwidth: str | float


def run(project: Project, name: str) -> None:
    """Write the tables of the redrawn sets of the task `name`.

    Raises:
        StageError: the parameters name no redraws, a table is missing, or no sampler can draw.
    """
    task, settings = project.params.task(name), project.params.robustness.redraws
    if settings is None:
        raise StageError("params.yaml has no robustness.redraws; take over that section from this project's own")
    paths = project.tables(name, INPUTS)
    further = {table: path for table, path in project.tables(name, FURTHER).items() if path.is_file()}
    with (
        recorded_run(project, "redraws", name) as record,
        TaskTables(paths | further) as tables,
        workers() as pool,
    ):
        own_kinds = register_task_kinds(project, task)
        scene = load_task_scene(project, task)
        stated = provenance(
            project, parameters("redraws", name), [*tables.values(), *scene_files(scene.path), *own_kinds],
            model=model_hash(scene),
        )  # fmt: skip
        people, scales, names = demonstrations_of(tables)
        anchors = ends_of(scene, task, tables["demonstrations"].read())
        betas = np.array(project.params.infer.betas)
        thetas = hypotheses(task, project.params.infer, names, tuple(scales["direction"]))
        drawn_with = [_drawn_with(project, task, ends, settings.samplers) for ends in anchors]
        jobs = [
            Job(
                tuple(drawn_with), label, draw, project.params.sample.sets,
                json.dumps({feature: dict(task.features[feature]) for feature in names}), people,
                scales["scale"].to_numpy(), thetas, betas, project.params.density.bandwidth,
            )
            for label in settings.samplers
            for draw in range(settings.draws)
        ]  # fmt: skip
        found = list(pool.mapped(measure_draw, jobs, f"redraws {name}"))
        record.notes += shortened(sorted({one for one in found if isinstance(one, str)}))
        parts = [one for one in found if isinstance(one, Measured)]
        if not parts:
            raise StageError(f"none of robustness.redraws.samplers can draw for {name}: {record.notes[0]}")
        measured = Measured.together(parts)
        explored = _over_the_space(tables, people, thetas, betas) if len(further) == len(FURTHER) else no_scores()
        anova, post_hoc = paper_tests(measured.divergences)
        made = {
            "redraws": measured.divergences.drop("kl_low", "kl_high"),
            "redraws_anova": anova,
            "redraws_post_hoc": post_hoc,
            "redraws_leads": leads(measured.divergences, post_hoc),
            "redraws_held_out": by_demonstration(pl.concat([measured.scores, explored])),
            "redraws_held_out_leads": pl.concat([held_out_leads(one) for one in (measured.scores, explored)]),
            "redraws_positions": positions(measured.positions),
        }
        for table, rows in made.items():
            write_table(project.table(name, table), table, rows if rows.width else empty_table(table, {}), stated)
        record.produced = f"{len(parts)} draws of {project.params.sample.sets} sets of each size"


def _drawn_with(project: Project, task: Task, ends: Ends, specs: dict[str, ShiftedSampler]) -> Shifted:
    preferences = json.dumps({key: dict(spec) for key, spec in task.preferences.items()})
    params = project.params
    return Shifted(ends, preferences, params.sample, tuple(specs.items()), params.ingest.waypoints, params.seed)


def measure_draw(job: Job) -> Measured | str:
    """What comes of one draw of one sampler, or why it cannot draw."""
    features = bind_features(loaded(job.anchors[0].ends.scene), json.loads(job.specs))
    sizes = job.anchors[0].settings.sizes
    drawn = dict[tuple[int, int], dict[str, FloatArray]]()  # by size and number of the set, by anchor
    pool = dict[str, FloatArray]()
    for anchor in job.anchors:
        room = anchor.ends.room()
        stream = ("redraws", anchor.ends.key, job.draw, job.label)
        try:
            sampler = _sampler(job, anchor, room)
            for size in (*sizes, 0):
                for number in range(job.sets if size else 1):
                    count = size or max(sizes)
                    draw = room.draw(sampler, child_rng(anchor.seed, *stream, size, number), count, anchor.waypoints)
                    values = features.evaluate(draw.waypoints) / job.scale
                    into = drawn.setdefault((size, number), {}) if size else pool
                    into[anchor.ends.label] = values
        except StageError as error:
            return f"the study goes without the sampler {job.label!r}: anchor {anchor.ends.label!r}: {error}"
    sets = tuple(ChoiceSets(size, f"{number:02d}", rows, {}) for (size, number), rows in drawn.items())
    redraw = Redraw(job.label, job.draw, sets, pool)
    return measure(redraw, job.people, features.names, job.thetas, job.betas, job.bandwidth)


def _sampler(job: Job, anchor: Shifted, room: Room) -> Sampler:
    """The sampler of one draw; a planner plans anew in each."""
    wanted = {job.label, *(dict(anchor.specs)[job.label].of or ())}
    own = Shifted(
        anchor.ends, anchor.preferences, anchor.settings,
        tuple((label, spec) for label, spec in anchor.specs if label in wanted), anchor.waypoints, anchor.seed,
    )  # fmt: skip
    samplers, found = named_samplers(own, room, ("redraws-planner", anchor.ends.key, str(job.draw)))
    if job.label not in samplers:
        raise StageError(found.absent[job.label])
    return samplers[job.label]


def _over_the_space(tables: TaskTables, people: Demonstrations, thetas: FloatArray, betas: FloatArray) -> pl.DataFrame:
    """Held-out scores of both models over every exploration, as densities of the scaled features."""
    cell = tables["choice_space"].read()["cell"][0]
    rows = tables["explored"].read(["exploration", "model", "features", "log_weight"])
    found: dict[str, list[FloatArray]] = {BOLTZMANN: [], LESS: []}
    for (_, model), part in rows.group_by("exploration", "model", maintain_order=True):
        phi, log_w = part["features"].to_numpy(), part["log_weight"].to_numpy()
        values = density_likelihood(str(model), people.features, phi, log_w, cell, thetas, betas)
        found[str(model)].append(values)
    if not (found[BOLTZMANN] and found[LESS]):
        return no_scores()
    return explored_scores(people, found, betas)
