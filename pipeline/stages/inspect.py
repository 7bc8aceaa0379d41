"""Stage: the recording of a task for the Rerun viewer, made from the tables alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.choice import entropy
from pipeline.params import Task
from pipeline.replay.geometry import body_poses, extract_geometry
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene
from pipeline.stages.project import Project, recorded_run
from pipeline.stages.scenes import load_task_scene
from pipeline.stages.task_view import TaskView, task_view
from pipeline.stores.viewer import write_inspection
from pipeline.stores.viewer_data import Inspection, Replay
from pipeline.studies.inspection import replay_samples

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
    view = task_view(project, name)
    tip = scene.end_effector
    paths = view.demonstrations["waypoints"].to_numpy()
    drawn = view.alternatives["waypoints"].to_numpy()[:PATHS].astype(np.float64)
    return Inspection(
        task=name,
        replay=_replay(scene, paths, view.demonstrations["duration_s"].to_numpy()),
        demonstration_ids=tuple(view.demonstrations["demonstration_id"]),
        demonstration_paths=body_positions(scene, paths, [tip])[tip],
        alternative_paths=body_positions(scene, drawn, [tip])[tip],
        alternative_log_weights=view.log_weights[:PATHS],
        curves=view.curves,
        map=view.map,
        theta_labels=view.labels,
        theta_meaning=view.meaning,
        posteriors={model: np.stack([b.marginal_theta for b in steps]) for model, steps in view.beliefs.items()},
        summary=_summary(project, name, task, view),
    )


def _replay(scene: Scene, paths: Floats, durations_s: Floats) -> Replay:
    configurations, time_s, demonstration = replay_samples(paths, durations_s)
    positions, quaternions = body_poses(scene, configurations)
    return Replay(extract_geometry(scene.model), positions, quaternions, time_s, demonstration)


def _anchored(view: TaskView) -> str:
    anchor = view.alternatives["anchor"][0]
    return (
        "" if anchor == "task" else f"; each demonstration has its own, drawn and summed up here are those of {anchor}"
    )


def _summary(project: Project, name: str, task: Task, view: TaskView) -> str:
    origin = "simulated" if view.demonstrations["simulated"].all() else "recorded"
    lines = [
        f"# {name}",
        "",
        f"**{view.demonstrations.height} {origin} demonstrations** from `{task.recordings}`, "
        f"{view.alternatives.height:,} alternatives ({project.params.sample.sampler}{_anchored(view)}), scene "
        f"`{Path(task.scene).name}`.",
        "",
        "| model | most probable cost | P | beta | thetas left |",
        "|---|---|---|---|---|",
    ]
    for model, steps in view.beliefs.items():
        final = steps[-1]
        best = final.map_index
        beta = final.betas[int(np.exp(final.log_probability).sum(axis=0).argmax())]
        effective = np.exp(entropy(final.marginal_theta))
        lines.append(
            f"| {model} | {view.labels[best]} | {final.marginal_theta[best]:.3f} | {beta:g} | "
            f"{effective:.1f} of {len(view.labels)} |"
        )
    lines += [
        "",
        "All demonstrations together; thetas left: the exponential of the posterior's entropy.",
        "",
        f"Bandwidth of the working set: {view.bandwidth:.4f} in scaled features ({project.params.density.bandwidth}).",
        "",
        f"Tables: `datasets/{name}/*.parquet`, all in `datasets/catalog.duckdb`; ask them with `lessbench sql`.",
    ]
    return "\n".join(lines)
