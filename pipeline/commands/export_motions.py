"""`lessbench export TASK --to mcap|parquet|csv|lerobot`: demonstrations, or the plan, for other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from pipeline.commands.plan import FOLDER as PLAN
from pipeline.errors import ArgumentError, StageError
from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.formats.mcap.plan_writer import STATES_TOPIC
from pipeline.formats.motions.joint_state_files import write_mcap
from pipeline.formats.motions.lerobot import RATE_HZ, write_lerobot
from pipeline.formats.motions.named_motions import NS, MotionSet, NamedMotion
from pipeline.formats.motions.tables import write_csv, write_parquet
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.replay.scene import Scene, model_hash
from pipeline.terminal import say
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene

WRITERS: Mapping[str, Callable[[Path, MotionSet], None]] = MappingProxyType(
    {"mcap": write_mcap, "parquet": write_parquet, "csv": write_csv}
)
LEROBOT = "lerobot"


def export_motions(
    project: Project, name: str, folder: Path, form: str, *, plan: bool = False, rate_hz: int | None = None
) -> None:
    """Write the motions of a task into a new folder.

    Args:
        project: whose task it is.
        name: of the task.
        folder: where to.
        form: one of `WRITERS`, or `LEROBOT`.
        plan: what `lessbench plan` planned in place of the demonstrations.
        rate_hz: poses per second; None: as they are there, or LeRobot's.

    Raises:
        StageError: there are none yet, they are of another scene, or there would be too many poses.
        SceneError, TableError: see `load_task_scene` and `OpenTable`.
    """
    scene = load_task_scene(project, project.params.task(name))
    motions = (planned if plan else demonstrated)(project, name, scene)
    try:
        if form == LEROBOT:
            write = partial(write_lerobot, rate_hz=rate_hz or RATE_HZ)
        else:
            write = partial(WRITERS[form])
            motions = motions if rate_hz is None else motions.sampled(rate_hz)
        with folder_written_whole(folder) as partial_folder:
            write(partial_folder, motions)
    except ArgumentError as error:
        raise StageError(f"{name} cannot be exported to {form}: {error}") from error
    count = len(motions.motions)
    what = "the plan" if plan else f"{count} demonstration{'' if count == 1 else 's'}"
    say(f"{project.shown(folder)}: {what} of {name}, joints {', '.join(motions.joints)}, in rad and m")


def demonstrated(project: Project, name: str, scene: Scene) -> MotionSet:
    """The demonstrations as they are compared with alternatives: T poses, evenly in time, idle ends cut off."""
    path = project.table(name, "demonstrations")
    if not path.exists():
        raise StageError(f"{project.shown(path)}: there are no demonstrations yet; run `lessbench ingest {name}`")
    with OpenTable(path, "demonstrations") as table:
        if table.provenance.get("model") != model_hash(scene):
            raise StageError(
                f"{project.shown(path)}: is of another scene than the one that tasks.{name}.scene names now; run "
                f"`lessbench ingest {name}` again"
            )
        rows = table.read()
    waypoints = rows["waypoints"].to_numpy()
    found = [_demonstration(row, poses) for row, poses in zip(rows.to_dicts(), waypoints, strict=True)]
    return MotionSet(name, scene.joints, tuple(scene.slides.tolist()), tuple(found))


def planned(project: Project, name: str, scene: Scene) -> MotionSet:
    """What `lessbench plan` wrote last, as closely in time as it has it."""
    path = project.datasets / name / PLAN / "plan.mcap"
    if not path.exists():
        raise StageError(f"{project.shown(path)}: there is no plan yet; run `lessbench plan {name}`")
    read = read_joint_states(path, STATES_TOPIC, scene.joints)
    about = read.metadata.get("plan", {})
    motion = NamedMotion(
        "plan", f"plan for {about.get('for', 'someone')}", 0, read.time_ns - read.time_ns[0], read.positions, about
    )
    return MotionSet(name, scene.joints, tuple(scene.slides.tolist()), (motion,))


def _demonstration(row: Mapping[str, Any], poses: np.ndarray) -> NamedMotion:
    about = {"simulated": "true"} if row["simulated"] else {}
    about |= {"true_theta": row["true_theta"]} if row["true_theta"] is not None else {}
    time_ns = np.rint(np.linspace(0, row["duration_s"], len(poses)) * NS).astype(np.int64)
    return NamedMotion(
        row["demonstration_id"], row["participant"], row["start_time_ns"], time_ns, poses.astype(np.float64), about
    )
