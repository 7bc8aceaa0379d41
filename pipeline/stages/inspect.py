"""Stage: the recording of a task for the Rerun viewer, made from the tables alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.choice import Posterior, entropy, posterior_from
from pipeline.params import Task
from pipeline.replay.geometry import body_poses, extract_geometry
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene
from pipeline.stages.project import Project, recorded_run
from pipeline.stages.sample import WORKING
from pipeline.stages.scenes import load_task_scene
from pipeline.stores.tables import read_table
from pipeline.stores.viewer import Inspection, Replay, write_inspection
from pipeline.studies.inspection import (
    density_curve,
    density_map,
    replay_samples,
    theta_labels,
    theta_meaning,
)

Floats = NDArray[np.float64]
PATHS = 150  # alternatives that are drawn; more hide each other and the scene


def run(project: Project, name: str) -> None:
    """Write inspect.rrd of the task `name`."""
    task = project.params.task(name)
    with recorded_run(project, "inspect", name) as record:
        scene = load_task_scene(project, task)
        path = project.datasets / name / "inspect.rrd"
        write_inspection(path, _inspection(project, name, task, scene))
        record.produced = f"{path.stat().st_size / 1e6:.1f} MB"


def _inspection(project: Project, name: str, task: Task, scene: Scene) -> Inspection:
    demonstrations = read_table(project.table(name, "demonstrations"), "demonstrations")
    alternatives = _anchored_alike(read_table(project.table(name, "alternatives"), "alternatives"))
    features = read_table(project.table(name, "features"), "features")
    densities = alternatives.select("alternative_id").join(
        read_table(project.table(name, "densities"), "densities"), on="alternative_id", maintain_order="left"
    )
    scales = read_table(project.table(name, "scales"), "scales")
    posteriors = read_table(project.table(name, "posteriors"), "posteriors").filter(set_id=WORKING)
    names, units = scales["feature"].to_list(), scales["unit"].to_list()
    phi = (
        alternatives.select(id="alternative_id").join(features, on="id", maintain_order="left").select(names).to_numpy()
    )
    demos = (
        demonstrations.select(id="demonstration_id")
        .join(features, on="id", maintain_order="left")
        .select(names)
        .to_numpy()
    )
    bandwidth = densities["bandwidth"][0] * scales["scale"].to_numpy()
    log_weights = -densities["log_density"].to_numpy()
    ids = tuple(demonstrations["demonstration_id"])
    beliefs = {
        model: _sequence(posteriors.filter(model=model), ids)
        for model in posteriors["model"].unique(maintain_order=True)
    }
    final = list(beliefs.values())[-1][-1]
    thetas, order = final.thetas, _by_weight(final)
    pair = [order[0], order[min(1, len(order) - 1)]]
    labels = theta_labels(thetas, names)
    ends = [scene.end_effector]
    paths = demonstrations["waypoints"].to_numpy()
    return Inspection(
        task=name,
        replay=_replay(scene, paths, demonstrations["duration_s"].to_numpy()),
        demonstration_ids=ids,
        demonstration_paths=body_positions(scene, paths, ends)[ends[0]],
        alternative_paths=body_positions(scene, alternatives["waypoints"].to_numpy()[:PATHS].astype(np.float64), ends)[
            ends[0]
        ],
        alternative_log_weights=log_weights[:PATHS],
        curves=tuple(
            density_curve(names[f], units[f], phi[:, f], demos[:, f], bandwidth[f], log_weights) for f in order
        ),
        map=density_map(
            (names[pair[0]], names[pair[1]]),
            (units[pair[0]], units[pair[1]]),
            phi[:, pair],
            demos[:, pair],
            bandwidth[pair],
        ),
        theta_labels=labels,
        theta_meaning=theta_meaning(thetas),
        posteriors={model: np.stack([b.marginal_theta for b in steps]) for model, steps in beliefs.items()},
        summary=_summary(project, name, task, demonstrations, alternatives, densities["bandwidth"][0], beliefs, labels),
    )


def _anchored_alike(alternatives: pl.DataFrame) -> pl.DataFrame:
    """The working set; of several, anchored at one demonstration each, the first."""
    working = alternatives.filter(set_id=WORKING)
    return working.filter(anchor=working["anchor"][0])


def _by_weight(belief: Posterior) -> list[int]:
    """Feature indices, those first that the belief gives the largest weights."""
    return [int(f) for f in np.argsort(-belief.marginal_theta @ np.abs(belief.thetas), kind="stable")]


def _replay(scene: Scene, paths: Floats, durations_s: Floats) -> Replay:
    configurations, time_s, demonstration = replay_samples(paths, durations_s)
    positions, quaternions = body_poses(scene, configurations)
    return Replay(extract_geometry(scene.model), positions, quaternions, time_s, demonstration)


def _sequence(rows: pl.DataFrame, demonstration_ids: tuple[str, ...]) -> list[Posterior]:
    """The belief before any demonstration and after each.

    The prior over the hypotheses is uniform, so the posteriors of single demonstrations are their likelihoods up to a
    constant, and multiply.
    """
    rows = rows.sort("theta_id", "beta")
    one = rows.filter(demonstration_id=demonstration_ids[0])
    betas = one["beta"].unique().sort().to_numpy()
    thetas = one.unique("theta_id", maintain_order=True)["theta"].to_numpy()
    single = np.stack(
        [
            rows.filter(demonstration_id=key)["log_posterior"].to_numpy().reshape(len(thetas), len(betas))
            for key in demonstration_ids
        ]
    )
    return [posterior_from(single[:count], thetas, betas) for count in range(len(single) + 1)]


def _summary(
    project: Project,
    name: str,
    task: Task,
    demonstrations: pl.DataFrame,
    alternatives: pl.DataFrame,
    bandwidth: float,
    beliefs: dict[str, list[Posterior]],
    labels: tuple[str, ...],
) -> str:
    origin = "simulated" if demonstrations["simulated"].all() else "recorded"
    lines = [
        f"# {name}",
        "",
        f"**{demonstrations.height} {origin} demonstrations** from `{task.recordings}`, "
        f"{alternatives.height:,} alternatives ({project.params.sample.sampler}), scene `{Path(task.scene).name}`.",
        "",
        "| model | most probable cost | P | beta | thetas left |",
        "|---|---|---|---|---|",
    ]
    for model, steps in beliefs.items():
        final = steps[-1]
        best = final.map_index
        beta = final.betas[int(np.exp(final.log_probability).sum(axis=0).argmax())]
        effective = np.exp(entropy(final.marginal_theta))
        lines.append(
            f"| {model} | {labels[best]} | {final.marginal_theta[best]:.3f} | {beta:g} | "
            f"{effective:.1f} of {len(labels)} |"
        )
    lines += [
        "",
        "All demonstrations together; thetas left: the exponential of the posterior's entropy.",
        "",
        f"Bandwidth of the working set: {bandwidth:.4f} in scaled features ({project.params.density.bandwidth}).",
        "",
        f"Tables: `datasets/{name}/*.parquet`, all in `datasets/catalog.duckdb`; ask them with `lessbench sql`.",
    ]
    return "\n".join(lines)
