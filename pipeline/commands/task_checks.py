"""Start, goal, limits, surface and the ends of the recordings held against each other, before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ParameterError, StageError, few_of
from pipeline.formats.mcap.rejection_reasons import SET_ASIDE
from pipeline.params import Ingest, Reading
from pipeline.replay.ends import distances
from pipeline.replay.room import Room
from pipeline.replay.scene import Scene
from pipeline.replay.surface import Surface
from pipeline.stages.ingest import Found, collect
from pipeline.trajectories.paths import Anchor
from pipeline.vocabulary import DEMONSTRATION_ANCHOR, TASK_ANCHOR
from pipeline.workspace.demonstrations import Intake
from pipeline.workspace.plausibility import is_far
from pipeline.workspace.project import Project

MOST = 5  # sentences of one kind


@dataclass(frozen=True)
class Choice:
    """Where alternatives start and end, and what was found on the way to it.

    Attributes:
        anchor: of the task.
        lines: what was found, a sentence each.
        demonstrations: (N, T, J) rad or m, N at least 1.
    """

    anchor: str
    lines: tuple[str, ...]
    demonstrations: FloatArray


def chosen_anchor(
    project: Project,
    name: str,
    scene: Scene,
    surface: str | None,
    recordings: Path,
    joint_names: Mapping[str, str],
    reading: Reading | None = None,
) -> Choice:
    """Read the recordings as the stage ingest will, and choose the anchor that their ends fit.

    Args:
        project: its settings of ingest are used.
        name: of the task.
        scene: with the task's joints and end effector.
        surface: of the task, or None.
        recordings: folder.
        joint_names, reading: of the task.

    Raises:
        ParameterError: no recording can be used.
    """
    top = None if surface is None else Surface(scene, surface)
    intake = Intake(name, scene, project.params.ingest, False, top, joint_names=joint_names, reading=reading)
    found = collect(recordings, intake)
    if not found.rows:
        raise ParameterError(_nothing_usable(recordings, found, joint_names))
    paths = np.stack([row["waypoints"] for row in found.rows])
    anchor, why = _anchor(scene, paths, intake)
    said = [f"Anchor: {anchor}, as {why}."]
    unmarked = scene.start is None and scene.goal is None
    if unmarked and len(paths) > 1 and shared_ends(scene, paths, project.params.ingest):
        said.append(
            "But all recordings start and end in the same places: name the file with --arm in place of --scene, and a "
            "scene that has these as keyframes is written; then the choice space can be explored."
        )
    said.append(found.people())
    if scene.start is not None and scene.goal is not None and np.allclose(scene.start, scene.goal):
        said.append("The keyframes 'start' and 'goal' are the same, so that the straight path between them rests.")
    said += _shortened(_of_recordings(found))
    said += _shortened(_of_rooms(scene, surface, found, anchor))
    return Choice(anchor, tuple(said), paths)


def _nothing_usable(recordings: Path, found: Found, names: Mapping[str, str]) -> str:
    taken = [f"{recorded}={ours}" for recorded, ours in names.items()]
    first = next((row for row in found.rejected if row["reason"] not in SET_ASIDE), found.rejected[0])
    return (
        f"--recordings is {recordings}, and none of the {len(found.rejected)} in it can be used, so no task is "
        f"written: {first['source']} ({first['reason']}): {first['detail'].rstrip('.')}. What tables and datasets "
        "mean, --reading says, such as --reading unit=deg"
        + (f"; --joint-name says which joint is which if {few_of(taken)} is wrong" if taken else "")
    )


def _anchor(scene: Scene, paths: FloatArray, intake: Intake) -> tuple[str, str]:
    missing = [key for key, pose in (("start", scene.start), ("goal", scene.goal)) if pose is None]
    if scene.start is None or scene.goal is None:
        return DEMONSTRATION_ANCHOR, f"the scene has no keyframe {' or '.join(missing)}"
    starts, goals = distances(scene, paths[:, 0], scene.start), distances(scene, paths[:, -1], scene.goal)
    far = sum(
        is_far(one, intake.settings) or is_far(other, intake.settings) for one, other in zip(starts, goals, strict=True)
    )
    if 2 * far > len(paths):
        return DEMONSTRATION_ANCHOR, f"{far} of {len(paths)} recordings start or end far from the scene's keyframes"
    return TASK_ANCHOR, (
        f"{len(paths) - far} of {len(paths)} recordings start and end near the scene's keyframes 'start' and 'goal'"
        + (f", and ingest refuses the {far} others" if far else "")
    )


def shared_ends(scene: Scene, paths: FloatArray, settings: Ingest) -> dict[str, FloatArray]:
    """`start` and `goal` (J,) that all paths (N, T, J) have, as nearly as ingest asks for; none if they have not."""
    ends = paths[:, [0, -1]]  # (N, 2, J)
    turns = 2 * np.pi * np.rint(ends[:, :1] / (2 * np.pi))
    ends = ends - np.where(scene.continuous, turns, 0.0)  # a joint without limits may have been recorded in any turn
    middle = np.median(ends, axis=0)
    apart = np.abs(ends - middle).max(axis=(0, 1))
    if (apart > np.where(scene.slides, settings.far_m, settings.far_rad)).any():
        return {}
    fitted = scene.limits.clamped(middle)
    return {"start": fitted[0], "goal": fitted[1]}


def _of_recordings(found: Found) -> list[str]:
    refused = [f"{row['source']} ({row['reason']}): {row['detail']}" for row in found.rejected]
    return refused + [f"{row['source']}: {row['remarks']}." for row in found.rows if row["remarks"]]


def _of_rooms(scene: Scene, surface: str | None, found: Found, anchor: str) -> list[str]:
    """What is odd about the ends that alternatives are to have."""
    ends: dict[str, Anchor] = {}
    if anchor == TASK_ANCHOR and scene.start is not None and scene.goal is not None:
        ends = {scene.path.name: Anchor(scene.start, scene.goal)}
    elif anchor == DEMONSTRATION_ANCHOR:
        ends = {row["source"]: Anchor(row["waypoints"][0], row["waypoints"][-1]) for row in found.rows}
    said = list[str]()
    for whose, one in ends.items():
        try:
            said += [f"{remark}." for remark in Room.of(scene, surface, False, one, whose).remarks]
        except StageError as error:
            said.append(f"{error}.")
    return said


def _shortened(lines: list[str]) -> list[str]:
    more = len(lines) - MOST
    return lines if more <= 0 else [*lines[:MOST], f"And {more} more of this kind; `lessbench check` lists them all."]
