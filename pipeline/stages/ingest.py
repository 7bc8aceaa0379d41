"""Stage: the recordings of a task, of whatever origin, as demonstrations of T waypoints each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from pipeline.errors import RecordingError, StageError
from pipeline.params import Ingest
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.stages.progress import tracked
from pipeline.stages.project import Project, recorded_run
from pipeline.stages.provenance import provenance
from pipeline.stages.scenes import load_task_scene
from pipeline.stores.recording_writing import METADATA
from pipeline.stores.recordings import read_joint_states
from pipeline.stores.tables import write_table
from pipeline.trajectories.timebase import demonstration_waypoints

RESERVED = ("all", "task")  # what demonstration_id and anchor say of no single demonstration
REJECTED = {"source": pl.String, "reason": pl.String, "detail": pl.String}


def run(project: Project, name: str) -> None:
    """Write demonstrations.parquet and rejected.parquet of the task `name`.

    Raises:
        StageError: there are no recordings, or some cannot be used and the parameters do not say to go on without
            them; rejected.parquet then lists all of these, and demonstrations.parquet stays as it was.
    """
    task, settings = project.params.task(name), project.params.ingest
    with recorded_run(project, "ingest", name) as record:
        scene = load_task_scene(project, task)
        folder = project.path(task.recordings)
        files = sorted(folder.glob("*.mcap"))
        if not files:
            raise StageError(
                f"{task.recordings}: there is no .mcap file in this folder; tasks.{name}.recordings names it"
            )
        rows: list[dict[str, Any]] = []
        rejected: list[dict[str, str]] = []
        for file in tracked(files, f"ingest {name}"):
            try:
                rows.append(demonstration(file, scene, settings))
            except RecordingError as error:
                rejected.append({"source": file.name, "reason": error.reason, "detail": error.detail})
        stated = provenance(
            project, depends_on(project, name), [*files, *scene_files(scene.path)], model=model_hash(scene)
        )
        write_table(project.table(name, "rejected"), "rejected", pl.DataFrame(rejected, REJECTED), stated)
        if rejected and (settings.on_rejected == "stop" or not rows):
            raise StageError(_refusal(project, name, rejected, len(files)))
        table = pl.DataFrame(rows, schema_overrides={"true_theta": pl.String, "lost": pl.String}).with_columns(
            waypoints=pl.Series(np.stack([row["waypoints"] for row in rows]))
        )
        write_table(project.table(name, "demonstrations"), "demonstrations", table, stated)
        salvaged = sum(row["salvaged"] for row in rows)
        record.produced = ", ".join(
            [
                f"{len(rows)} demonstrations",
                *([f"{salvaged} of them salvaged"] if salvaged else []),
                *([f"{len(rejected)} rejected"] if rejected else []),
            ]
        )


def depends_on(project: Project, name: str) -> list[object]:
    """The parameters that the tables depend on."""
    return [project.params.task(name).end_effector, project.params.ingest]


def demonstration(file: Path, scene: Scene, settings: Ingest) -> dict[str, Any]:
    """One row of demonstrations.parquet.

    Raises:
        RecordingError: the recording cannot be used.
    """
    if file.stem in RESERVED:
        raise RecordingError(
            "reserved-name",
            f"A recording cannot be called {file.stem}, which tables use for all of them; rename the file.",
        )
    recording = read_joint_states(file, joints=scene.joints, salvage=settings.salvage)
    time_s = (recording.time_ns - recording.time_ns[0]) / 1e9
    reference = recording.positions[0] if scene.start is None else scene.start
    path, start_s, duration_s = demonstration_waypoints(
        time_s, recording.positions, scene.continuous, reference, settings.waypoints, settings.idle_rad
    )
    stated = recording.metadata.get(METADATA, {})
    return {
        "demonstration_id": file.stem,
        "participant": stated.get("participant", file.stem),
        "source": file.name,
        "simulated": stated.get("simulated") == "true",
        "true_theta": stated.get("true_theta"),
        "start_time_ns": int(recording.time_ns[0]) + round(start_s * 1e9),
        "duration_s": duration_s,
        "salvaged": recording.lost is not None,
        "lost": recording.lost,
        "waypoints": path,
    }


def _refusal(project: Project, name: str, rejected: list[dict[str, str]], total: int) -> str:
    first = rejected[0]
    others = f" and {len(rejected) - 1} more" if len(rejected) > 1 else ""
    remedy = (
        "mend or remove them"
        if len(rejected) == total
        else "mend or remove them, or set ingest.on_rejected to continue"
    )
    return (
        f"{len(rejected)} of {total} recordings in {project.params.task(name).recordings} cannot be used: "
        f"{first['source']} ({first['reason']}): {first['detail'].rstrip('.')}{others}; all are listed in "
        f"datasets/{name}/rejected.parquet; {remedy}"
    )
