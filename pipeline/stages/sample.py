"""Stage: independent sets of alternatives, each from its own random stream."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import polars as pl

from pipeline.params import Sample
from pipeline.replay.scene import scene_files
from pipeline.stages.planning import SEARCH, Planning
from pipeline.stages.progress import tracked
from pipeline.stages.project import WORKING, Project, recorded_run
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
    ViaPoint,
    draw_admissible,
)
from pipeline.trajectories.streams import child_rng


def run(project: Project, name: str) -> None:
    """Write alternatives.parquet and sampling.parquet of the task `name`."""
    task, settings, seed = project.params.task(name), project.params.sample, project.params.seed
    with recorded_run(project, "sample", name) as record:
        scene = load_task_scene(project, task)
        planning = Planning(scene, task, project.params.ingest.waypoints)
        source = project.table(name, "demonstrations")
        anchors = sampling_anchors(planning, read_table(source, "demonstrations"))
        sampler = _sampler(planning, settings, next(iter(anchors.values())), seed, name)
        wanted = [(anchor, size, set_id) for anchor in anchors for size, set_id in _sets(settings)]
        draws = [
            draw_set(planning, sampler, child_rng(seed, "sample", name, anchor, size, set_id), anchors[anchor], size)
            for anchor, size, set_id in tracked(wanted, f"sample {name}")
        ]
        depends_on = [
            task.end_effector, task.surface, task.anchor, task.preferences, settings, planning.waypoints,
        ]  # fmt: skip
        provenance = project.provenance(depends_on, [*scene_files(scene.path), source], seeded=True)
        rows = pl.concat([alternative_rows(draw, *which) for draw, which in zip(draws, wanted, strict=True)])
        shares = pl.concat([sampling_rows(draw, *which) for draw, which in zip(draws, wanted, strict=True)])
        write_table(project.table(name, "alternatives"), "alternatives", rows, provenance)
        write_table(project.table(name, "sampling"), "sampling", shares, provenance)
        rate = 1 - rows.height / sum(tally.proposed for draw in draws for tally in draw.tallies)
        record.produced = f"{len(wanted)} sets, {rows.height:,} trajectories ({rate:.0%} of the draws discarded)"


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
