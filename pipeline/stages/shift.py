"""Stage: sets of alternatives from different samplers, one sampler per set, as different people would have sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import polars as pl

from pipeline.choice.logspace import log_sum_exp
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import write_table
from pipeline.params import Sample, ShiftedSampler
from pipeline.replay.planning import Planning
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.stages.sample import alternative_rows, planned_sampler, sampling_anchors, sampling_rows
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import Deformation, Draw, Mixture, Sampler, ViaPoint
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene


def run(project: Project, name: str) -> None:
    """Write shifted_alternatives.parquet and shifted_sampling.parquet of the task `name`."""
    task, settings, seed = project.params.task(name), project.params.sample, project.params.seed
    specs = project.params.robustness.samplers
    with recorded_run(project, "shift", name) as record:
        scene = load_task_scene(project, task)
        planning = Planning(scene, task, project.params.ingest.waypoints)
        with OpenTable(project.table(name, "demonstrations"), "demonstrations") as source:
            anchors = sampling_anchors(planning, source.read())
        rows, shares = [], []
        for label, anchor in tracked(list(anchors.items()), f"shift {name}"):
            # planned anew from every anchor: what is clear of the surface from one may not be from another
            for set_id, sampler in _samplers(planning, settings, specs, anchor, seed, name).items():
                for size in settings.sizes:
                    rng = child_rng(seed, "shift", name, label, size, set_id)
                    draw = planning.room.draw(sampler, rng, anchor, size, planning.waypoints)
                    log_proposal = _log_proposal(sampler, draw, anchor)
                    rows.append(alternative_rows(draw, label, size, set_id).with_columns(log_proposal=log_proposal))
                    shares.append(sampling_rows(draw.tallies, label, size, set_id))
        stated = provenance(
            project, parameters("shift", name), [*scene_files(scene.path), source], model=model_hash(scene)
        )
        table = pl.concat(rows)
        write_table(project.table(name, "shifted_alternatives"), "shifted_alternatives", table, stated)
        write_table(project.table(name, "shifted_sampling"), "shifted_sampling", pl.concat(shares), stated)
        record.produced = f"{len(rows)} sets from {len(specs)} samplers, {table.height:,} trajectories"


def _samplers(
    planning: Planning, settings: Sample, specs: Mapping[str, ShiftedSampler], anchor: Anchor, seed: int, name: str
) -> dict[str, Sampler]:
    """Each by its name. All deform with the same modes, so that their densities are of the same amplitudes."""
    simple: dict[str, Sampler] = {}
    for label, spec in specs.items():
        if spec.width_rad is not None:
            simple[label] = Deformation(spec.width_rad, settings.deformation.modes, name=label)
        elif spec.reach_rad is not None:
            simple[label] = ViaPoint(spec.reach_rad, name=label)
        elif spec.paths is not None:
            stream = (seed, "shift-planner", name, label)
            simple[label] = replace(planned_sampler(planning, settings, anchor, spec.paths, stream), name=label)
    mixtures: dict[str, Sampler] = {
        label: Mixture(tuple(simple[part] for part in spec.of), (1.0,) * len(spec.of), name=label)
        for label, spec in specs.items()
        if spec.of is not None
    }
    return simple | mixtures


def _log_proposal(sampler: Sampler, draw: Draw, anchor: Anchor) -> pl.Series:
    """The log density of each draw, null where the sampler has none that is known."""
    parts = sampler.samplers if isinstance(sampler, Mixture) else (sampler,)
    known = [part for part in parts if isinstance(part, Deformation)]
    if len(known) < len(parts):
        return pl.Series([None] * len(draw.waypoints), dtype=pl.Float64)
    logs = np.stack([part.log_proposal(draw.waypoints, anchor) for part in known])
    return pl.Series(log_sum_exp(logs, axis=0) - np.log(len(known)))
