"""Stage: sets of alternatives from different samplers, one sampler per set, as different people would have sampled."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from pipeline.choice.logspace import log_sum_exp
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import write_table
from pipeline.params import Sample, ShiftedSampler
from pipeline.replay.planning import Planning
from pipeline.replay.room import Room
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.stages.sample import alternative_rows, planned_sampler, sampling_rows
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import Deformation, Draw, Mixture, Sampler, ViaPoint
from pipeline.vocabulary import TASK_ANCHOR
from pipeline.workspace.anchors import Ends, ends_of, shortened
from pipeline.workspace.compute.executor import workers
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene


@dataclass(frozen=True, eq=False)
class Shifted:
    """What a worker needs to draw all sets of one anchor.

    Attributes:
        ends: the anchor.
        preferences: JSON of what paths are planned for.
        settings: sizes, modes and jitter.
        specs: the samplers.
        waypoints: T.
        seed: of the random numbers.
    """

    ends: Ends
    preferences: str
    settings: Sample
    specs: tuple[tuple[str, ShiftedSampler], ...]
    waypoints: int
    seed: int


def run(project: Project, name: str) -> None:
    """Write shifted_alternatives.parquet and shifted_sampling.parquet of the task `name`."""
    task, specs = project.params.task(name), project.params.robustness.samplers
    with recorded_run(project, "shift", name) as record, workers(project) as pool:
        scene = load_task_scene(project, task)
        with OpenTable(project.table(name, "demonstrations"), "demonstrations") as source:
            anchors = ends_of(scene, task, source.read())
        preferences = json.dumps({key: dict(spec) for key, spec in task.preferences.items()})
        jobs = [
            Shifted(
                ends, preferences, project.params.sample, tuple(specs.items()), project.params.ingest.waypoints,
                project.params.seed,
            )
            for ends in anchors
        ]  # fmt: skip
        rows, shares, notes = [], [], []
        for more_rows, more_shares, said in pool.mapped(draw_shifted, jobs, f"shift {name}"):
            rows += more_rows
            shares += more_shares
            notes += said
        record.notes += shortened(notes)
        stated = provenance(
            project, parameters("shift", name), [*scene_files(scene.path), source], model=model_hash(scene)
        )
        table = pl.concat(rows)
        write_table(project.table(name, "shifted_alternatives"), "shifted_alternatives", table, stated)
        write_table(project.table(name, "shifted_sampling"), "shifted_sampling", pl.concat(shares), stated)
        record.produced = f"{len(rows)} sets from {len(specs)} samplers, {table.height:,} trajectories"


def draw_shifted(job: Shifted) -> tuple[list[pl.DataFrame], list[pl.DataFrame], list[str]]:
    """Rows of shifted_alternatives.parquet and of shifted_sampling.parquet of one anchor, and what is to be said."""
    room, ends = job.ends.room(), job.ends
    samplers, said = _samplers(job, room)
    rows, shares = [], []
    for set_id, sampler in samplers.items():
        for size in job.settings.sizes:
            draw = room.draw(sampler, child_rng(job.seed, "shift", ends.key, size, set_id), size, job.waypoints)
            log_proposal = _log_proposal(sampler, draw, room.anchor)
            rows.append(alternative_rows(draw, ends.label, size, set_id).with_columns(log_proposal=log_proposal))
            shares.append(sampling_rows(draw.tallies, ends.label, size, set_id))
    prefix = "" if ends.label == TASK_ANCHOR else f"{ends.label}: "
    return rows, shares, [f"{prefix}{note}" for note in said]


def _samplers(job: Shifted, room: Room) -> tuple[dict[str, Sampler], list[str]]:
    """Each by its name, and what is to be said. All deform with the same modes, so that their densities are of the same
    amplitudes; a mixture picks a sampler before anything is discarded, so that its density is known.
    """
    planning = Planning.of(room, json.loads(job.preferences), job.waypoints)
    simple, said = dict[str, Sampler](), list[str]()
    for label, spec in job.specs:
        if spec.width_rad is not None:
            simple[label] = Deformation(spec.width_rad, job.settings.deformation.modes, name=label)
        elif spec.reach_rad is not None:
            simple[label] = ViaPoint(spec.reach_rad, name=label)
        elif spec.paths is not None:
            labels = ("shift-planner", job.ends.key, label)
            planner, notes = planned_sampler(planning, job.settings, spec.paths, job.seed, *labels)
            simple[label] = replace(planner, name=label)
            said += [note for note in notes if note not in said]
    mixtures: dict[str, Sampler] = {
        label: Mixture(tuple(simple[part] for part in spec.of), (1.0,) * len(spec.of), name=label)
        for label, spec in job.specs
        if spec.of is not None
    }
    return simple | mixtures, said


def _log_proposal(sampler: Sampler, draw: Draw, anchor: Anchor) -> pl.Series:
    """The log density of each draw, null where the sampler has none that is known."""
    parts = sampler.samplers if isinstance(sampler, Mixture) else (sampler,)
    known = [part for part in parts if isinstance(part, Deformation)]
    if len(known) < len(parts):
        return pl.Series([None] * len(draw.waypoints), dtype=pl.Float64)
    logs = np.stack([part.log_proposal(draw.waypoints, anchor) for part in known])
    return pl.Series(log_sum_exp(logs, axis=0) - np.log(len(known)))
