"""Stage: the recordings of a task, of whatever origin, as demonstrations of T waypoints each."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from pipeline.errors import RecordingError, StageError
from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.mcap.writer import METADATA
from pipeline.formats.parquet.tables import write_table
from pipeline.params import Ingest
from pipeline.replay.scene import Scene, model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.terminal import plain
from pipeline.trajectories.timebase import demonstration_waypoints
from pipeline.vocabulary import RESERVED_IDS
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project, recorded_run, table_path
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import load_task_scene

LONGEST_NAME = 200  # characters
LONGEST_THETA = 10_000  # characters
LARGEST_WEIGHT = 1e9
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
        files = sorted(project.path(task.recordings).glob("*.mcap"))
        if not files:
            raise StageError(
                f"{task.recordings}: there is no .mcap file in this folder; tasks.{name}.recordings names it"
            )
        found = _read(tracked(files, f"ingest {name}"), scene, settings)
        inputs = [*(file for file in files if file.name not in found.unreadable), *scene_files(scene.path)]
        stated = provenance(project, parameters("ingest", name), inputs, model=model_hash(scene))
        write_table(project.table(name, "rejected"), "rejected", pl.DataFrame(found.rejected, REJECTED), stated)
        if found.rejected and (settings.on_rejected == "stop" or not found.rows):
            raise StageError(_refusal(project, name, found.rejected, len(files)))
        write_table(project.table(name, "demonstrations"), "demonstrations", found.demonstrations(), stated)
        record.produced = found.summary()


@dataclass
class _Found:
    """What came of the recordings.

    Attributes:
        rows: of demonstrations.parquet.
        rejected: rows of rejected.parquet.
        unreadable: names of files of which nothing can be hashed, such as a pipe, which would never end.
    """

    rows: list[dict[str, Any]] = field(default_factory=list)
    rejected: list[dict[str, str]] = field(default_factory=list)
    unreadable: set[str] = field(default_factory=set)

    def demonstrations(self) -> pl.DataFrame:
        """The table of the demonstrations, of which there is at least one."""
        table = pl.DataFrame(self.rows, schema_overrides={"true_theta": pl.String, "lost": pl.String})
        return table.with_columns(waypoints=pl.Series(np.stack([row["waypoints"] for row in self.rows])))

    def summary(self) -> str:
        """One phrase for the record of the run."""
        salvaged = sum(row["salvaged"] for row in self.rows)
        return ", ".join(
            [
                f"{len(self.rows)} demonstrations",
                *([f"{salvaged} of them salvaged"] if salvaged else []),
                *([f"{len(self.rejected)} rejected"] if self.rejected else []),
            ]
        )


def _read(files: Iterable[Path], scene: Scene, settings: Ingest) -> _Found:
    found = _Found()
    for file in files:
        try:
            found.rows.append(demonstration(file, scene, settings))
        except RecordingError as error:
            if error.reason == "unreadable":
                found.unreadable.add(file.name)
            source = plain(file.name, LONGEST_NAME + 60)
            found.rejected.append({"source": source, "reason": error.reason, "detail": error.detail})
    return found


def demonstration(file: Path, scene: Scene, settings: Ingest) -> dict[str, Any]:
    """One row of demonstrations.parquet.

    Raises:
        RecordingError: the recording cannot be used.
    """
    _check_name("A recording", file.stem, "rename the file")
    recording = read_joint_states(file, joints=scene.joints, salvage=settings.salvage)
    time_s = (recording.time_ns - recording.time_ns[0]) / 1e9
    reference = recording.positions[0] if scene.start is None else scene.start
    path, start_s, duration_s = demonstration_waypoints(
        time_s, recording.positions, scene.continuous, reference, settings.waypoints, settings.idle_rad
    )
    stated = recording.metadata.get(METADATA, {})
    participant = stated.get("participant", file.stem)
    _check_name("A participant", participant, f"change it in the recording's metadata record {METADATA!r}")
    _check_true_theta(stated.get("true_theta"))
    return {
        "demonstration_id": file.stem,
        "participant": participant,
        "source": file.name,
        "simulated": stated.get("simulated") == "true",
        "true_theta": stated.get("true_theta"),
        "start_time_ns": int(recording.time_ns[0]) + round(start_s * 1e9),
        "duration_s": duration_s,
        "salvaged": recording.lost is not None,
        "lost": recording.lost,
        "waypoints": path,
    }


def _check_name(whose: str, name: str, remedy: str) -> None:
    if name in RESERVED_IDS:
        raise rejection(
            "reserved-name", f"{whose} cannot be called {name}, which tables use for all of them; {remedy}."
        )
    if not name.strip() or not name.isprintable() or len(name) > LONGEST_NAME:
        raise rejection(
            "reserved-name",
            f"{whose} cannot be called {name!r}; a name has 1 to {LONGEST_NAME} printable characters, {remedy}.",
        )


def _check_true_theta(text: str | None) -> None:
    """What a simulated participant wanted must be weights by feature, as later stages compute with them."""
    if text is None:
        return
    try:
        weights = json.loads(text) if len(text) <= LONGEST_THETA else None
    except (ValueError, RecursionError):
        weights = None
    if not isinstance(weights, dict) or not all(
        isinstance(weight, int | float) and not isinstance(weight, bool) and abs(weight) <= LARGEST_WEIGHT
        for weight in weights.values()
    ):
        raise rejection(
            "bad-metadata",
            f"The recording states true_theta as {text!r}; it must be a JSON object, feature name to a weight between "
            f"-{LARGEST_WEIGHT:g} and {LARGEST_WEIGHT:g}.",
        )


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
        f"{table_path(name, 'rejected')}; {remedy}"
    )
