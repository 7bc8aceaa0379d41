"""Stage: independent sets of alternatives, each from its own random stream."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.errors import StageError
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.partitions import cut, gathered
from pipeline.formats.parquet.tables import table_writer, write_table
from pipeline.params import Sample
from pipeline.replay.planning import Planning, planned_paths
from pipeline.replay.room import Room
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.trajectories.installed_sampler import installed_sampler
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import Deformation, Draw, Planner, Sampler, Tally, ViaPoint
from pipeline.vocabulary import DEFORMATION, GIVEN, MIXTURE, PLANNER, TASK_ANCHOR, VIA_POINT, WORKING
from pipeline.workspace.anchors import Ends, ends_of, shortened
from pipeline.workspace.compute.executor import workers
from pipeline.workspace.given import Given, pool_of, read_given
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene
from pipeline.workspace.trust import register_task_kinds

MIXED = (DEFORMATION, VIA_POINT, PLANNER)  # what a mixture has equal parts of
TRIED, LEAST_ACCEPTANCE = 20, 0.01  # drawn from each of them, and the share that must keep to the room
Drawn = tuple[tuple[str, int, str], pl.DataFrame, tuple[Tally, ...]]  # which set, rows of its table, what it took


@dataclass(frozen=True, eq=False)
class Planned:
    """What a worker needs to find the samplers of one anchor.

    Attributes:
        ends: the anchor.
        preferences: JSON of what paths are planned for.
        settings: which samplers.
        waypoints: T.
        seed: of the random numbers.
    """

    ends: Ends
    preferences: str
    settings: Sample
    waypoints: int
    seed: int


@dataclass(frozen=True, eq=False)
class Share:
    """Rows of a set that one sampler draws, from a random stream of their own."""

    sampler: Sampler
    count: int
    stream: tuple[str | int, ...]


@dataclass(frozen=True, eq=False)
class Portion:
    """Some of the rows of a set.

    Attributes:
        ends: where they start and end.
        shares: who draws them, one after another.
        waypoints: T.
        seed: of the random numbers.
        set_size, set_id: which set.
        first: the place of the first of them.
    """

    ends: Ends
    shares: tuple[Share, ...]
    waypoints: int
    seed: int
    set_size: int
    set_id: str
    first: int


def run(project: Project, name: str) -> None:
    """Write alternatives.parquet and sampling.parquet of the task `name`."""
    task, settings = project.params.task(name), project.params.sample
    partition = project.params.compute.partition
    with recorded_run(project, "sample", name) as record:
        own_kinds = register_task_kinds(project, task)
        scene = load_task_scene(project, task)
        with OpenTable(project.table(name, "demonstrations"), "demonstrations") as source:
            ends = ends_of(scene, task, source.read())
        inputs: list[Path | OpenTable] = [*scene_files(scene.path), *own_kinds, source]
        given = None
        if settings.given is not None:
            given = read_given(project.path(settings.given), scene, project.params.ingest.waypoints)
            inputs.append(given.path)
        read = {given.path: given.digest} if given else {}
        stated = provenance(project, parameters("sample", name), inputs, model=model_hash(scene), hashes=read)
        tallies: dict[tuple[str, int, str], list[Tally]] = {}
        with (
            workers() as pool,
            table_writer(project.table(name, "alternatives"), "alternatives", stated) as writer,
            gathered(writer, partition) as table,
        ):
            if given is None:
                preferences = json.dumps({key: dict(spec) for key, spec in task.preferences.items()})
                jobs = [
                    Planned(one, preferences, settings, project.params.ingest.waypoints, project.params.seed)
                    for one in ends
                ]
                found = list(pool.mapped(samplers_of, jobs, f"sample {name}: plans"))
                record.notes += shortened([note for _, notes in found for note in notes])
                portions = _portions(project, ends, [samplers for samplers, _ in found])
                drawn = pool.mapped(draw_portion, portions, f"sample {name}")
            else:
                drawn = _given(project, given, scene, ends, record.notes)
            for which, rows, counts in drawn:
                table.add(rows)
                tallies.setdefault(which, []).extend(counts)
        shares = pl.concat([sampling_rows(added(counts), *which) for which, counts in tallies.items()])
        write_table(project.table(name, "sampling"), "sampling", shares, stated)
        rate = 1 - table.rows / int(shares["proposed"].sum())
        touching = shares["in_collision"].sum() / int(shares["proposed"].sum())
        collided = f", {touching:.0%} in collision" if task.collisions else ""
        record.produced = (
            f"{len(tallies)} sets, {table.rows:,} trajectories ({rate:.0%} of the draws discarded{collided})"
        )


def samplers_of(job: Planned) -> tuple[tuple[Sampler, ...], tuple[str, ...]]:
    """The samplers of one anchor, in equal parts if there are several, and what is to be said of them.

    Of a mixture, a sampler that hardly ever keeps to the room is left out, and why is said.

    Raises:
        StageError: no sampler is left, or the ends are not possible.
    """
    room = job.ends.room()
    parts = MIXED if job.settings.sampler == MIXTURE else (job.settings.sampler,)
    found, notes, absent = list[Sampler](), list[str](), list[str]()
    for part in parts:
        try:
            sampler, said = _sampler(part, job, room)
            if len(parts) > 1:
                rng = child_rng(job.seed, "trial", job.ends.key, part)
                room.draw(sampler, rng, TRIED, job.waypoints, LEAST_ACCEPTANCE)
        except StageError as error:
            absent.append(f"no alternatives from {part!r}, whose part the others have: {error}")
            continue
        found.append(sampler)
        notes += said
    if not found:
        raise StageError(f"anchor {job.ends.label!r}: {absent[0]}")
    prefix = "" if job.ends.label == TASK_ANCHOR else f"{job.ends.label}: "
    return tuple(found), (*room.remarks, *(f"{prefix}{note}" for note in [*notes, *absent]))


def _sampler(part: str, job: Planned, room: Room) -> tuple[Sampler, list[str]]:
    settings = job.settings
    if part == DEFORMATION:
        return Deformation(settings.deformation.width_rad, settings.deformation.modes), []
    if part == VIA_POINT:
        return ViaPoint(settings.via_point.reach_rad), []
    if part != PLANNER:
        return installed_sampler(part, settings.settings), []
    planning = Planning.of(room, json.loads(job.preferences), job.waypoints)
    return planned_sampler(planning, settings, settings.planner.paths, job.seed, "planner", job.ends.key)


def planned_sampler(
    planning: Planning, settings: Sample, count: int, seed: int, *labels: str
) -> tuple[Planner, list[str]]:
    """The planner of one anchor, and what could not be planned for.

    Raises:
        StageError: see `planned_paths`.
    """
    paths, unvaried = planned_paths(planning, count, seed, *labels)
    said = (
        [f"paths are planned without {', '.join(map(repr, unvaried))}, the same for all deformations"]
        if unvaried
        else []
    )
    return Planner(paths, Deformation(settings.planner.width_rad, settings.deformation.modes)), said


def _portions(project: Project, ends: Sequence[Ends], samplers: Sequence[tuple[Sampler, ...]]) -> list[Portion]:
    """All sets, each in equal parts from the samplers of its anchor; those larger than a partition in portions."""
    settings, seed, partition = project.params.sample, project.params.seed, project.params.compute.partition
    waypoints, portions = project.params.ingest.waypoints, []
    for (one, parts), (size, set_id) in product(zip(ends, samplers, strict=True), _sets(settings)):
        stream = ("sample", one.key, size, set_id)
        counts = _equal_parts(size, len(parts), child_rng(seed, *stream))
        starts = np.cumsum([0, *counts])
        for number, (first, count) in enumerate(cut(size, partition)):
            here = np.diff(np.clip(starts, first, first + count))
            label = () if size <= partition else (number,)
            shares = tuple(
                Share(sampler, int(rows), (*stream, sampler.name, *label))
                for sampler, rows in zip(parts, here, strict=True)
                if rows
            )
            portions.append(Portion(one, shares, waypoints, seed, size, set_id, first))
    return portions


def _equal_parts(size: int, parts: int, rng: np.random.Generator) -> list[int]:
    """How many rows of a set each part has; which have one more is left to chance."""
    more = rng.permutation(parts) < size % parts
    return [size // parts + int(extra) for extra in more]


def draw_portion(portion: Portion) -> Drawn:
    """Draw it."""
    room = portion.ends.room()
    draws = [
        room.draw(share.sampler, child_rng(portion.seed, *share.stream), share.count, portion.waypoints)
        for share in portion.shares
    ]
    draw = Draw(
        _short(np.concatenate([one.waypoints for one in draws])),
        tuple(name for one in draws for name in one.sampler),
        tuple(tally for one in draws for tally in one.tallies),
    )
    which = portion.ends.label, portion.set_size, portion.set_id
    return which, alternative_rows(draw, *which, portion.first), draw.tallies


def _short(waypoints: FloatArray) -> FloatArray:
    """Rounded to float32, which halves the file; only given trajectories need all digits, for those that are equal."""
    return waypoints.astype(np.float32).astype(np.float64)


def _given(project: Project, given: Given, scene: Scene, ends: Sequence[Ends], notes: list[str]) -> Iterator[Drawn]:
    """All sets, from the trajectories that are given; what is to be said of these is added to the notes."""
    settings, partition = project.params.sample, project.params.compute.partition
    pools = [pool_of(given, one, scene, project.params.ingest) for one in ends]
    notes += shortened([*given.notes, *(note for pool in pools for note in pool.notes)])
    for (one, pool), (size, set_id) in product(zip(ends, pools, strict=True), _sets(settings)):
        if size > pool.size:
            left_out = f" ({pool.notes[0]})" if pool.notes else ""
            raise StageError(
                f"a set of {size} is wanted, and {pool.size} of the {len(given.waypoints)} trajectories of "
                f"sample.given can be used for anchor {one.label!r}{left_out}; lower sample.sizes or working_set, or, "
                "where the surface leaves too many out, set the task's surface to null"
            )
        chosen, tally = pool.choose(child_rng(project.params.seed, "sample", one.key, size, set_id, GIVEN), size)
        for first, count in cut(size, partition):
            draw = Draw(given.waypoints[chosen[first : first + count]], (GIVEN,) * count, (tally,) if not first else ())
            yield (one.label, size, set_id), alternative_rows(draw, one.label, size, set_id, first), draw.tallies


def _sets(settings: Sample) -> Iterator[tuple[int, str]]:
    yield settings.working_set, WORKING
    for size in settings.sizes:
        for number in range(settings.sets):
            yield size, f"{number:02d}"


def alternative_rows(draw: Draw, anchor: str, size: int, set_id: str, first: int = 0) -> pl.DataFrame:
    """Rows of alternatives.parquet, those of the set from `first` on; its ids are in the order of their places."""
    digits = max(6, len(str(size - 1)))
    places = range(first, first + len(draw.sampler))
    return pl.DataFrame(
        {
            "alternative_id": [f"{anchor}/{size}/{set_id}/{place:0{digits}d}" for place in places],
            "anchor": anchor,
            "sampler": draw.sampler,
            "set_size": size,
            "set_id": set_id,
            "waypoints": draw.waypoints,
        }
    )


def added(tallies: Iterable[Tally]) -> tuple[Tally, ...]:
    """The tallies of all portions of a set, one for each sampler, in alphabetical order."""
    sums: dict[str, Tally] = {}
    for one in tallies:
        sums[one.sampler] = sums[one.sampler] + one if one.sampler in sums else one
    return tuple(sums[sampler] for sampler in sorted(sums))


def sampling_rows(tallies: Sequence[Tally], anchor: str, size: int, set_id: str) -> pl.DataFrame:
    """Rows of sampling.parquet."""
    return pl.DataFrame(
        {
            "anchor": anchor,
            "set_size": size,
            "set_id": set_id,
            "sampler": [tally.sampler for tally in tallies],
            "proposed": [tally.proposed for tally in tallies],
            "outside_limits": [tally.outside_limits for tally in tallies],
            "through_surface": [tally.through_surface for tally in tallies],
            "in_collision": [tally.in_collision for tally in tallies],
            "kept": [tally.kept for tally in tallies],
        }
    )
