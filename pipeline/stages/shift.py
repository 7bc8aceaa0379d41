"""Stage: sets of alternatives from different samplers, one sampler per set, as different people would have sampled."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from pipeline.choice.logspace import log_sum_exp
from pipeline.errors import StageError
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
from pipeline.workspace.trust import register_task_kinds

FEWEST = 2  # samplers that can be compared


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


Rows = tuple[pl.DataFrame, pl.DataFrame]  # of shifted_alternatives.parquet and of shifted_sampling.parquet


@dataclass(frozen=True, eq=False)
class Drawn:
    """What became of the samplers of one anchor.

    Attributes:
        sets: by sampler, its sets.
        absent: by sampler, why it has none.
        notes: what is to be said.
    """

    sets: dict[str, list[Rows]]
    absent: dict[str, str]
    notes: list[str]


def run(project: Project, name: str) -> None:
    """Write shifted_alternatives.parquet and shifted_sampling.parquet of the task `name`."""
    task, specs = project.params.task(name), project.params.robustness.samplers
    with recorded_run(project, "shift", name) as record, workers() as pool:
        own_kinds = register_task_kinds(project, task)
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
        drawn = list(pool.mapped(draw_shifted, jobs, f"shift {name}"))
        absent = {label: why for one in drawn for label, why in one.absent.items()}
        if len(specs) - len(absent) < FEWEST:
            raise StageError(
                f"of robustness.samplers, {len(specs) - len(absent)} can draw for every anchor and {FEWEST} are "
                f"needed to compare: {next(iter(absent.values()))}"
            )
        record.notes += [f"the study goes without the sampler {label!r}: {why}" for label, why in absent.items()]
        record.notes += shortened([note for one in drawn for note in one.notes])
        kept = [sets for one in drawn for label, sets in one.sets.items() if label not in absent]
        rows = [rows for sets in kept for rows, _ in sets]
        shares = pl.concat([shares for sets in kept for _, shares in sets])
        stated = provenance(
            project, parameters("shift", name), [*scene_files(scene.path), *own_kinds, source], model=model_hash(scene)
        )
        table = pl.concat(rows)
        write_table(project.table(name, "shifted_alternatives"), "shifted_alternatives", table, stated)
        write_table(project.table(name, "shifted_sampling"), "shifted_sampling", shares, stated)
        record.produced = f"{len(rows)} sets from {len(specs) - len(absent)} samplers, {table.height:,} trajectories"


def draw_shifted(job: Shifted) -> Drawn:
    """All sets of one anchor."""
    room, ends = job.ends.room(), job.ends
    samplers, found = named_samplers(job, room, ("shift-planner", ends.key))
    for label, sampler in samplers.items():
        try:
            found.sets[label] = [_set(job, room, label, sampler, size) for size in job.settings.sizes]
        except StageError as error:
            found.absent[label] = f"anchor {ends.label!r}: {error}"
    return found


def _set(job: Shifted, room: Room, label: str, sampler: Sampler, size: int) -> Rows:
    draw = room.draw(sampler, child_rng(job.seed, "shift", job.ends.key, size, label), size, job.waypoints)
    rows = alternative_rows(draw, job.ends.label, size, label)
    rows = rows.with_columns(log_proposal=_log_proposal(sampler, draw, room.anchor))
    return rows, sampling_rows(draw.tallies, job.ends.label, size, label)


def named_samplers(job: Shifted, room: Room, stream: tuple[str, ...]) -> tuple[dict[str, Sampler], Drawn]:
    """Each by its name, and those that cannot draw here.

    All deform with the same modes, so that their densities are of the same amplitudes; a mixture picks a sampler before
    anything is discarded, so that its density is known.

    Args:
        job: the samplers, and what they draw for.
        room: of the job's ends.
        stream: labels of the random numbers that paths are planned with.
    """
    planning = Planning.of(room, json.loads(job.preferences), job.waypoints)
    simple, found = dict[str, Sampler](), Drawn({}, {}, [])
    prefix = "" if job.ends.label == TASK_ANCHOR else f"{job.ends.label}: "
    for label, spec in job.specs:
        if spec.width_rad is not None:
            simple[label] = Deformation(spec.width_rad, job.settings.deformation.modes, name=label)
        elif spec.reach_rad is not None:
            simple[label] = ViaPoint(spec.reach_rad, name=label)
        elif spec.paths is not None:
            try:
                planner, notes = planned_sampler(planning, job.settings, spec.paths, job.seed, *stream, label)
            except StageError as error:
                found.absent[label] = f"anchor {job.ends.label!r}: {error}"
                continue
            simple[label] = replace(planner, name=label)
            found.notes.extend(f"{prefix}{note}" for note in notes if f"{prefix}{note}" not in found.notes)
    mixtures = dict[str, Sampler]()
    for label, spec in job.specs:
        lost = [found.absent[part] for part in spec.of or () if part not in simple]
        if lost:
            found.absent[label] = lost[0]
        elif spec.of is not None:
            mixtures[label] = Mixture(tuple(simple[part] for part in spec.of), (1.0,) * len(spec.of), name=label)
    return simple | mixtures, found


def _log_proposal(sampler: Sampler, draw: Draw, anchor: Anchor) -> pl.Series:
    """The log density of each draw, null where the sampler has none that is known."""
    parts = sampler.samplers if isinstance(sampler, Mixture) else (sampler,)
    known = [part for part in parts if isinstance(part, Deformation)]
    if len(known) < len(parts):
        return pl.Series([None] * len(draw.waypoints), dtype=pl.Float64)
    logs = np.stack([part.log_proposal(draw.waypoints, anchor) for part in known])
    return pl.Series(log_sum_exp(logs, axis=0) - np.log(len(known)))
