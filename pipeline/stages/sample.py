"""Stage: independent sets of alternatives, each from its own random stream."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.errors import StageError
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.partitions import cut, gathered
from pipeline.formats.parquet.tables import read_column, table_writer, write_table
from pipeline.params import Sample
from pipeline.replay.planning import SEARCH, Planning, Room
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.trajectories.optimise import optimise_paths, random_weights
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import Deformation, Draw, Mixture, Planner, Sampler, Tally, ViaPoint
from pipeline.trajectories.timebase import to_branch
from pipeline.vocabulary import DEFORMATION, GIVEN, PLANNER, TASK_ANCHOR, VIA_POINT, WORKING
from pipeline.workspace.compute.executor import workers
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import SceneFile, load_task_scene, loaded, scene_file

Drawn = tuple[tuple[str, int, str], pl.DataFrame, tuple[Tally, ...]]  # which set, rows of its table, what it took


@dataclass(frozen=True)
class Portion:
    """Some of the rows of a set, drawn from a random stream of their own.

    Attributes:
        scene, surface: what the alternatives must keep to.
        sampler: draws them.
        ends: where they start and end.
        waypoints: T.
        seed, stream: of the random numbers.
        anchor, set_size, set_id: which set.
        first, count: its rows from `first` on.
    """

    scene: SceneFile
    surface: str | None
    sampler: Sampler
    ends: Anchor
    waypoints: int
    seed: int
    stream: tuple[str | int, ...]
    anchor: str
    set_size: int
    set_id: str
    first: int
    count: int


def run(project: Project, name: str) -> None:
    """Write alternatives.parquet and sampling.parquet of the task `name`."""
    task, settings = project.params.task(name), project.params.sample
    partition = project.params.compute.partition
    with recorded_run(project, "sample", name) as record:
        scene = load_task_scene(project, task)
        planning = Planning(scene, task, project.params.ingest.waypoints)
        with OpenTable(project.table(name, "demonstrations"), "demonstrations") as source:
            anchors = sampling_anchors(planning, source.read())
        inputs: list[Path | OpenTable] = [*scene_files(scene.path), source]
        if settings.given is not None:
            inputs.append(project.path(settings.given))
        stated = provenance(project, parameters("sample", name), inputs, model=model_hash(scene))
        tallies: dict[tuple[str, int, str], list[Tally]] = {}
        with (
            workers(project) as pool,
            table_writer(project.table(name, "alternatives"), "alternatives", stated) as writer,
            gathered(writer, partition) as table,
        ):
            if settings.given is None:
                portions = _portions(project, name, planning, anchors)
                drawn = pool.mapped(draw_portion, portions, f"sample {name}")
            else:
                drawn = _given(project, name, planning, anchors)
            for which, rows, counts in drawn:
                table.add(rows)
                tallies.setdefault(which, []).extend(counts)
        shares = pl.concat([sampling_rows(added(counts), *which) for which, counts in tallies.items()])
        write_table(project.table(name, "sampling"), "sampling", shares, stated)
        rate = 1 - table.rows / int(shares["proposed"].sum())
        record.produced = f"{len(tallies)} sets, {table.rows:,} trajectories ({rate:.0%} of the draws discarded)"


def _portions(project: Project, name: str, planning: Planning, anchors: Mapping[str, Anchor]) -> list[Portion]:
    """All sets, those larger than a partition cut into portions; the stream of a set that is not cut has no number."""
    settings, seed, partition = project.params.sample, project.params.seed, project.params.compute.partition
    sampler = _sampler(planning, settings, next(iter(anchors.values())), seed, name)
    file = scene_file(planning.scene)
    portions = []
    for (label, anchor), (size, set_id) in product(anchors.items(), _sets(settings)):
        for first, count in cut(size, partition):
            number = () if size <= partition else (first // partition,)
            stream = ("sample", name, label, size, set_id, *number)
            portions.append(
                Portion(
                    file, planning.task.surface, sampler, anchor, planning.waypoints, seed, stream, label, size, set_id,
                    first, count,
                )
            )  # fmt: skip
    return portions


def draw_portion(portion: Portion) -> Drawn:
    """Draw it."""
    room = Room(loaded(portion.scene), portion.surface)
    rng = child_rng(portion.seed, *portion.stream)
    draw = room.draw(portion.sampler, rng, portion.ends, portion.count, portion.waypoints)
    which = portion.anchor, portion.set_size, portion.set_id
    return which, alternative_rows(draw, *which, portion.first), draw.tallies


def _given(project: Project, name: str, planning: Planning, anchors: Mapping[str, Anchor]) -> Iterator[Drawn]:
    """All sets, from the trajectories that are given."""
    settings, partition = project.params.sample, project.params.compute.partition
    pool = given_trajectories(project.path(str(settings.given)), planning.scene, planning.waypoints)
    for label, (size, set_id) in product(anchors, _sets(settings)):
        if size > len(pool):
            raise StageError(
                f"a set of {size} is wanted and sample.given has {len(pool)} trajectories; lower sample.sizes or "
                "working_set"
            )
        rng = child_rng(project.params.seed, "sample", name, label, size, set_id)
        chosen = rng.choice(len(pool), size, replace=False)
        for first, count in cut(size, partition):
            tally = Tally(GIVEN, count, 0, 0)
            draw = Draw(pool[chosen[first : first + count]], (GIVEN,) * count, (tally,))
            yield (label, size, set_id), alternative_rows(draw, label, size, set_id, first), draw.tallies


def sampling_anchors(planning: Planning, demonstrations: pl.DataFrame) -> dict[str, Anchor]:
    """Where the alternatives start and end: the task's start and goal, or each demonstration's own."""
    if planning.task.anchor == TASK_ANCHOR:
        return {TASK_ANCHOR: planning.anchor}
    paths = demonstrations["waypoints"].to_numpy()
    ids = demonstrations["demonstration_id"].to_list()
    return {key: Anchor(path[0], path[-1]) for key, path in zip(ids, paths, strict=True)}


def given_trajectories(path: Path, scene: Scene, n_waypoints: int) -> FloatArray:
    """Somebody's own alternatives (P, T, J): the column `waypoints`, each on the branch of the scene's start.

    Raises:
        StageError: the file is missing, is no Parquet, or its trajectories have another shape or are not finite.
    """
    rows = read_column(path, "waypoints", "sample.given")
    try:
        flat = np.array([np.asarray(row, dtype=np.float64).ravel() for row in rows])
    except (TypeError, ValueError) as error:
        raise StageError(f"{path}: has no column `waypoints` of equal lists ({' '.join(str(error).split())})") from None
    if flat.ndim != 2 or flat.shape[1] != n_waypoints * len(scene.joints) or not np.isfinite(flat).all():
        raise StageError(
            f"{path}: has trajectories of {flat.shape[-1]} numbers; needed are {n_waypoints} waypoints x "
            f"{len(scene.joints)} joints = {n_waypoints * len(scene.joints)} finite ones"
        )
    paths = flat.reshape(len(flat), n_waypoints, len(scene.joints))
    reference = paths[0, 0] if scene.start is None else scene.start
    return np.stack([to_branch(path, reference, scene.continuous) for path in paths])


def _sets(settings: Sample) -> Iterator[tuple[int, str]]:
    yield settings.working_set, WORKING
    for size in settings.sizes:
        for number in range(settings.sets):
            yield size, f"{number:02d}"


def _sampler(planning: Planning, settings: Sample, anchor: Anchor, seed: int, name: str) -> Sampler:
    deformation = Deformation(settings.deformation.width_rad, settings.deformation.modes)
    via_point = ViaPoint(settings.via_point.reach_rad)
    if settings.sampler == DEFORMATION:
        return deformation
    if settings.sampler == VIA_POINT:
        return via_point
    planner = planned_sampler(planning, settings, anchor, settings.planner.paths, (seed, "planner", name))
    return planner if settings.sampler == PLANNER else Mixture((deformation, via_point, planner), (1.0, 1.0, 1.0))


def planned_sampler(
    planning: Planning, settings: Sample, anchor: Anchor, count: int, stream: tuple[int, *tuple[str, ...]]
) -> Planner:
    """The planner, its paths planned once, from `anchor`; they serve others as deviations from the straight path."""
    scales = planning.preference_scales(child_rng(*stream, "scales"), anchor, Deformation())
    lower, upper = planning.room.limits(anchor)
    planned = optimise_paths(
        [child_rng(*stream, path) for path in range(count)],
        anchor,
        random_weights(child_rng(*stream, "weights"), count, len(scales)),
        planning.scaled(scales),
        lower=lower,
        upper=upper,
        n_waypoints=planning.waypoints,
        search=SEARCH,
    )
    return Planner(planned.waypoints, Deformation(settings.planner.width_rad, settings.deformation.modes))


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
            "waypoints": draw.waypoints.astype(np.float32),
        }
    )


def added(tallies: Iterable[Tally]) -> tuple[Tally, ...]:
    """The tallies of all portions of a set, one for each sampler, in alphabetical order."""
    sums: dict[str, Tally] = {}
    for one in tallies:
        had = sums.get(one.sampler, Tally(one.sampler, 0, 0, 0))
        sums[one.sampler] = Tally(
            one.sampler,
            had.proposed + one.proposed,
            had.outside_limits + one.outside_limits,
            had.inadmissible + one.inadmissible,
        )
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
            "kept": [tally.kept for tally in tallies],
        }
    )
