"""Stage: independent sets of alternatives, each from its own random stream."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.errors import StageError
from pipeline.params import Sample
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.stages.planning import SEARCH, Planning
from pipeline.stages.progress import tracked
from pipeline.stages.project import WORKING, Project, recorded_run
from pipeline.stages.provenance import provenance
from pipeline.stages.scenes import load_task_scene
from pipeline.stores.tables import read_table, write_table
from pipeline.trajectories.optimise import optimise_paths, random_weights
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.samplers import (
    Deformation,
    Draw,
    Mixture,
    Planner,
    Sampler,
    Tally,
    ViaPoint,
    draw_admissible,
)
from pipeline.trajectories.streams import child_rng
from pipeline.trajectories.timebase import to_branch

Array = NDArray[np.float64]


def run(project: Project, name: str) -> None:
    """Write alternatives.parquet and sampling.parquet of the task `name`."""
    task, settings, seed = project.params.task(name), project.params.sample, project.params.seed
    with recorded_run(project, "sample", name) as record:
        scene = load_task_scene(project, task)
        planning = Planning(scene, task, project.params.ingest.waypoints)
        source = project.table(name, "demonstrations")
        anchors = sampling_anchors(planning, read_table(source, "demonstrations"))
        wanted = [(anchor, size, set_id) for anchor in anchors for size, set_id in _sets(settings)]
        streams = [child_rng(seed, "sample", name, *which) for which in wanted]
        inputs = [*scene_files(scene.path), source]
        if settings.given is not None:
            pool = given_trajectories(project.path(settings.given), scene, planning.waypoints)
            inputs.append(project.path(settings.given))
            draws = [_draw_given(pool, rng, size) for rng, (_, size, _) in zip(streams, wanted, strict=True)]
        else:
            sampler = _sampler(planning, settings, next(iter(anchors.values())), seed, name)
            draws = [
                draw_set(planning, sampler, rng, anchors[anchor], size)
                for rng, (anchor, size, _) in tracked(list(zip(streams, wanted, strict=True)), f"sample {name}")
            ]
        stated = provenance(project, depends_on(project, name), inputs, seeded=True, model=model_hash(scene))
        rows = pl.concat([alternative_rows(draw, *which) for draw, which in zip(draws, wanted, strict=True)])
        shares = pl.concat([sampling_rows(draw, *which) for draw, which in zip(draws, wanted, strict=True)])
        write_table(project.table(name, "alternatives"), "alternatives", rows, stated)
        write_table(project.table(name, "sampling"), "sampling", shares, stated)
        rate = 1 - rows.height / sum(tally.proposed for draw in draws for tally in draw.tallies)
        record.produced = f"{len(wanted)} sets, {rows.height:,} trajectories ({rate:.0%} of the draws discarded)"


def depends_on(project: Project, name: str) -> list[object]:
    """The parameters that the tables depend on."""
    task = project.params.task(name)
    settings = [project.params.sample, project.params.ingest.waypoints]
    return [task.end_effector, task.surface, task.anchor, task.preferences, *settings]


def sampling_anchors(planning: Planning, demonstrations: pl.DataFrame) -> dict[str, Anchor]:
    """Where the alternatives start and end: the task's start and goal, or each demonstration's own."""
    if planning.task.anchor == "task":
        return {"task": planning.anchor}
    paths = demonstrations["waypoints"].to_numpy()
    ids = demonstrations["demonstration_id"].to_list()
    return {key: Anchor(path[0], path[-1]) for key, path in zip(ids, paths, strict=True)}


def draw_set(planning: Planning, sampler: Sampler, rng: np.random.Generator, anchor: Anchor, size: int) -> Draw:
    """One set of alternatives."""
    lower, upper = planning.limits(anchor)
    return draw_admissible(
        sampler, rng, anchor, size, planning.waypoints, lower=lower, upper=upper, admissible=planning.admissible
    )


def given_trajectories(path: Path, scene: Scene, n_waypoints: int) -> Array:
    """Somebody's own alternatives (P, T, J): the column `waypoints`, row-major, each on the branch of the scene's start.

    Raises:
        StageError: the file is missing, is no Parquet, or its trajectories have another shape or are not finite.
    """
    try:
        column = pl.read_parquet(path, columns=["waypoints"])["waypoints"]
        flat = np.array([np.asarray(row, dtype=np.float64).ravel() for row in column.to_list()])
    except FileNotFoundError:
        raise StageError(f"{path}: there is no such file; sample.given names it") from None
    except (pl.exceptions.PolarsError, ValueError) as error:
        raise StageError(f"{path}: has no column `waypoints` of equal lists ({' '.join(str(error).split())})") from None
    if flat.ndim != 2 or flat.shape[1] != n_waypoints * len(scene.joints) or not np.isfinite(flat).all():
        raise StageError(
            f"{path}: has trajectories of {flat.shape[-1]} numbers; needed are {n_waypoints} waypoints x "
            f"{len(scene.joints)} joints = {n_waypoints * len(scene.joints)} finite ones"
        )
    paths = flat.reshape(len(flat), n_waypoints, len(scene.joints))
    reference = paths[0, 0] if scene.start is None else scene.start
    return np.stack([to_branch(path, reference, scene.continuous) for path in paths])


def _draw_given(pool: Array, rng: np.random.Generator, size: int) -> Draw:
    """A set of `size` different ones of the given trajectories."""
    if size > len(pool):
        raise StageError(
            f"a set of {size} is wanted and sample.given has {len(pool)} trajectories; lower sample.sizes or working_set"
        )
    return Draw(pool[rng.choice(len(pool), size, replace=False)], ("given",) * size, (Tally("given", size, 0, 0),))


def _sets(settings: Sample) -> Iterator[tuple[int, str]]:
    yield settings.working_set, WORKING
    for size in settings.sizes:
        for number in range(settings.sets):
            yield size, f"{number:02d}"


def _sampler(planning: Planning, settings: Sample, anchor: Anchor, seed: int, name: str) -> Sampler:
    deformation = Deformation(settings.deformation.width_rad, settings.deformation.modes)
    via_point = ViaPoint(settings.via_point.reach_rad)
    if settings.sampler == "deformation":
        return deformation
    if settings.sampler == "via-point":
        return via_point
    planner = planned_sampler(planning, settings, anchor, settings.planner.paths, (seed, "planner", name))
    return planner if settings.sampler == "planner" else Mixture((deformation, via_point, planner), (1.0, 1.0, 1.0))


def planned_sampler(
    planning: Planning, settings: Sample, anchor: Anchor, count: int, stream: tuple[int, *tuple[str, ...]]
) -> Planner:
    """The planner, its paths planned once from `anchor`; they serve other anchors as deviations from the straight path."""
    scales = planning.preference_scales(child_rng(*stream, "scales"), anchor, Deformation())
    lower, upper = planning.limits(anchor)
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


def alternative_rows(draw: Draw, anchor: str, size: int, set_id: str) -> pl.DataFrame:
    """Rows of alternatives.parquet."""
    return pl.DataFrame(
        {
            "alternative_id": [f"{anchor}/{size}/{set_id}/{place:06d}" for place in range(size)],
            "anchor": anchor,
            "sampler": draw.sampler,
            "set_size": size,
            "set_id": set_id,
            "waypoints": draw.waypoints.astype(np.float32),
        }
    )


def sampling_rows(draw: Draw, anchor: str, size: int, set_id: str) -> pl.DataFrame:
    """Rows of sampling.parquet."""
    return pl.DataFrame(
        {
            "anchor": anchor,
            "set_size": size,
            "set_id": set_id,
            "sampler": [tally.sampler for tally in draw.tallies],
            "proposed": [tally.proposed for tally in draw.tallies],
            "kept": [tally.kept for tally in draw.tallies],
        }
    )
