"""Stage: independent sets of alternatives, each from its own random stream."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import polars as pl

from pipeline.params import Sample
from pipeline.replay.scene import scene_files
from pipeline.stages.planning import SEARCH, Planning
from pipeline.stages.progress import tracked
from pipeline.stages.project import Project, recorded_run
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

WORKING = "working"


def run(project: Project, name: str) -> None:
    """Write alternatives.parquet and sampling.parquet of the task `name`."""
    task, settings, seed = project.params.task(name), project.params.sample, project.params.seed
    with recorded_run(project, "sample", name) as record:
        scene = load_task_scene(project, task)
        planning = Planning(scene, task, project.params.ingest.waypoints)
        source = project.table(name, "demonstrations")
        anchors = _anchors(planning, settings, read_table(source, "demonstrations"))
        sampler = _sampler(planning, settings, next(iter(anchors.values())), seed, name)
        wanted = [(anchor, size, set_id) for anchor in anchors for size, set_id in _sets(settings)]
        draws = [
            draw_admissible(
                sampler, child_rng(seed, "sample", name, anchor, size, set_id), anchors[anchor], size, planning.waypoints,
                lower=np.minimum(scene.lower, np.minimum(anchors[anchor].start, anchors[anchor].goal)),
                upper=np.maximum(scene.upper, np.maximum(anchors[anchor].start, anchors[anchor].goal)),
                admissible=planning.admissible,
            )
            for anchor, size, set_id in tracked(wanted, f"sample {name}")
        ]  # fmt: skip
        depends_on = [task.end_effector, task.surface, task.preferences, settings, planning.waypoints]
        provenance = project.provenance(depends_on, [*scene_files(scene.path), source])
        rows = pl.concat([_rows(draw, *which) for draw, which in zip(draws, wanted, strict=True)])
        shares = pl.concat([_shares(draw, *which) for draw, which in zip(draws, wanted, strict=True)])
        write_table(project.table(name, "alternatives"), "alternatives", rows, provenance)
        write_table(project.table(name, "sampling"), "sampling", shares, provenance)
        rate = 1 - rows.height / sum(tally.proposed for draw in draws for tally in draw.tallies)
        record.produced = f"{len(wanted)} sets, {rows.height:,} trajectories ({rate:.0%} of the draws discarded)"


def _anchors(planning: Planning, settings: Sample, demonstrations: pl.DataFrame) -> dict[str, Anchor]:
    if settings.anchor == "task":
        return {"task": planning.anchor}
    paths = demonstrations["waypoints"].to_numpy()
    ids = demonstrations["demonstration_id"].to_list()
    return {key: Anchor(path[0], path[-1]) for key, path in zip(ids, paths, strict=True)}


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
    planner = _planner(planning, settings, anchor, seed, name)
    return planner if settings.sampler == "planner" else Mixture((deformation, via_point, planner), (1.0, 1.0, 1.0))


def _planner(planning: Planning, settings: Sample, anchor: Anchor, seed: int, name: str) -> Planner:
    """The planner, its paths planned once from `anchor`; they serve other anchors as deviations from the straight path."""
    scales = planning.preference_scales(child_rng(seed, "planner", name, "scales"), anchor, Deformation())
    count = settings.planner.paths
    planned = optimise_paths(
        [child_rng(seed, "planner", name, path) for path in range(count)],
        anchor,
        random_weights(child_rng(seed, "planner", name, "weights"), count, len(scales)),
        planning.scaled(scales),
        lower=planning.scene.lower,
        upper=planning.scene.upper,
        n_waypoints=planning.waypoints,
        search=SEARCH,
    )
    return Planner(planned.waypoints, Deformation(settings.planner.width_rad, settings.deformation.modes))


def _rows(draw: Draw, anchor: str, size: int, set_id: str) -> pl.DataFrame:
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


def _shares(draw: Draw, anchor: str, size: int, set_id: str) -> pl.DataFrame:
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
