"""From a recording to a demonstration: what cannot be right is refused, what is merely odd is used and said."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.formats.mcap.joint_states import JointRecording
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.mcap.writer import METADATA
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.folders import PARTICIPANTS, Bag
from pipeline.formats.recordings.readers import read_recording
from pipeline.params import Ingest, Reading
from pipeline.replay.scene import Scene
from pipeline.replay.surface import Surface
from pipeline.terminal import plain
from pipeline.trajectories.motion import longest_gap, rate_hz
from pipeline.trajectories.timebase import moving_part
from pipeline.vocabulary import RESERVED_IDS, TASK_ANCHOR
from pipeline.workspace.participants import by_file_name, participants_in
from pipeline.workspace.people import identity
from pipeline.workspace.plausibility import ends_apart, remark_on_surface, require_plausible, within_limits
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene

LONGEST_NAME = 200  # characters
LONGEST_THETA = 10_000  # characters
LONGEST_REMARKS = 4000  # characters
LARGEST_WEIGHT = 1e9
NAMED_BY = "named by"


@dataclass(frozen=True, eq=False)
class Intake:
    """What recordings of a task are judged by.

    Attributes:
        task: its name.
        scene: of the task.
        settings: of ingest.
        shared_ends: whether all demonstrations are compared with alternatives from the scene's start to its goal.
        surface: of the task, if it has one.
        elsewhere: of the project's other tasks, those with a folder of recordings of their own.
        joint_names: what the scene calls joints that the recordings call otherwise.
        reading: what the task says of tables, datasets and names of files.
        folder: of the recordings, where participants.csv may be.
    """

    task: str
    scene: Scene
    settings: Ingest
    shared_ends: bool
    surface: Surface | None = None
    elsewhere: frozenset[str] = frozenset()
    joint_names: Mapping[str, str] = field(default_factory=dict)
    reading: Reading | None = None
    folder: Path | None = None

    @property
    def columns(self) -> ColumnMap:
        """What the columns of tables and datasets mean; a unit of angles for all is one of those that turn alone."""
        said = column_map(self.reading)
        if not isinstance(said.unit, str):
            return said
        turning, sliding = (said.unit, "m") if said.unit in ("rad", "deg") else ("rad", said.unit)
        joints = zip(self.recorded_joints, self.scene.slides, strict=True)
        return replace(said, unit={joint: sliding if slides else turning for joint, slides in joints})

    @property
    def recorded_joints(self) -> tuple[str, ...]:
        """The scene's joints, as the recordings call them."""
        recorded = {ours: theirs for theirs, ours in self.joint_names.items()}
        return tuple(recorded.get(joint, joint) for joint in self.scene.joints)

    @classmethod
    def of(cls, project: Project, name: str) -> Intake:
        """That of a task.

        Raises:
            SceneError: see `load_task_scene` and `Surface`.
        """
        task = project.params.task(name)
        others = frozenset(key for key, other in project.params.tasks.items() if other.recordings != task.recordings)
        scene = load_task_scene(project, task)
        surface = None if task.surface is None else Surface(scene, task.surface)
        return cls(
            name, scene, project.params.ingest, task.anchor == TASK_ANCHOR, surface, others, task.joint_names,
            task.reading, project.path(task.recordings),
        )  # fmt: skip

    def salvaging(self) -> Intake:
        """The same, with what stands before the cut of a recording that is cut off."""
        return replace(self, settings=self.settings.model_copy(update={"salvage": True}))


def column_map(reading: Reading | None) -> ColumnMap:
    """What a task says of columns, as readers take it."""
    said = reading or Reading()
    return ColumnMap(
        said.time, said.time_unit, said.rate_hz, said.joints or (), said.unit or {}, said.array, said.id,
        said.participant,
    )  # fmt: skip


def read_bag(bag: Bag, intake: Intake) -> JointRecording:
    """The recording that is in the files of a bag, of the scene's joints.

    Raises:
        RecordingError: see `read_recording`.
    """
    settings = intake.settings
    return read_recording(
        bag,
        settings.topic,
        intake.recorded_joints,
        intake.columns,
        clock=settings.clock,
        salvage=settings.salvage,
    )


def demonstration(bag: Bag, intake: Intake) -> dict[str, Any]:
    """One row of demonstrations.parquet, and under `NAMED_BY` what says whose it is.

    Raises:
        RecordingError: the recording cannot be used.
    """
    return demonstration_row(bag.name, read_bag(bag, intake), intake)


def demonstration_row(name: str, recording: JointRecording, intake: Intake) -> dict[str, Any]:
    """The same from a recording that was read, of the scene's joints.

    Raises:
        RecordingError: the recording cannot be used.
    """
    _check_name("A recording", name, "rename the file")
    remarks = list(recording.remarks)
    stated, named_by = _stated(name, recording, intake, remarks)
    participant = stated.get("participant", name)
    _check_name("A participant", participant, f"change it in {named_by}")
    scene, settings = intake.scene, intake.settings
    time_s = (recording.time_ns - recording.time_ns[0]) / 1e9
    positions = within_limits(scene, recording.positions, time_s, remarks)
    part = moving_part(time_s, positions, scene.continuous, settings.idle_rad)
    fastest = require_plausible(scene, part, settings, remarks)
    reference = positions[0] if scene.start is None else scene.start
    path = part.waypoints(reference, scene.continuous, settings.waypoints)
    ends = ends_apart(scene, path, settings, remarks) if intake.shared_ends else None
    if intake.surface is not None:
        remark_on_surface(scene, path, intake.surface, remarks)
    return {
        "demonstration_id": name,
        "participant": participant,
        NAMED_BY: named_by,
        "source": recording.source,
        "simulated": stated.get("simulated") == "true",
        "true_theta": stated.get("true_theta"),
        "start_time_ns": int(recording.time_ns[0]) + round(part.start_s * 1e9),
        "duration_s": part.duration_s,
        "salvaged": recording.lost is not None,
        "lost": recording.lost,
        "files": len(recording.hashes),
        "clock": recording.clock,
        "rate_hz": rate_hz(time_s),
        "dropped": recording.dropped,
        "longest_gap_s": longest_gap(part.time_s).size,
        "greatest_speed": fastest.size,
        "fastest_joint": scene.joints[fastest.joint],
        "start_apart": ends[0].size if ends else None,
        "start_apart_m": ends[0].end_effector_m if ends else None,
        "goal_apart": ends[1].size if ends else None,
        "goal_apart_m": ends[1].end_effector_m if ends else None,
        "remarks": plain("; ".join(remark.replace("; ", ", ") for remark in remarks), LONGEST_REMARKS) or None,
        "waypoints": path,
    }


def _stated(name: str, recording: JointRecording, intake: Intake, remarks: list[str]) -> tuple[Mapping[str, str], str]:
    """What is known of a demonstration beside its poses, and what says whose it is.

    Its own metadata count most, then participants.csv, then the name of its file.

    Raises:
        RecordingError: it is of another task of the project, or something says what it may not say.
    """
    own = recording.metadata.get(METADATA, {})
    listed = participants_in(intake.folder).of(name, recording.source, recording.path.name, recording.path.stem)
    pattern = intake.reading.file_name if intake.reading else None
    by_name = by_file_name(name, pattern) if pattern else {}
    if by_name is None:
        remarks.append(f"its name does not follow reading.file_name, {pattern}")
        by_name = {}
    itself = f"the recording's metadata record {METADATA!r}"
    places = {itself: own, PARTICIPANTS: listed, f"the name of the file {name!r}": by_name}
    said_by = {key: next((place for place in places if key in places[place]), "") for key in ("participant", "task")}
    stated = {**by_name, **listed, **own}
    task = stated.get("task", intake.task)
    if task in intake.elsewhere:
        raise rejection(
            "another-task",
            f"By {said_by['task']} it is of task {task!r}, which has recordings of its own; move it there, or change "
            f"that if it is of {intake.task!r}.",
        )
    if task != intake.task:
        says = "says of itself that it is" if "task" in own else f"is by {said_by['task']}"
        remarks.append(f"{says} of task {task!r}")
    _check_true_theta(stated.get("true_theta"))
    return stated, said_by["participant"]


def _check_name(whose: str, name: str, remedy: str) -> None:
    if identity(name) in RESERVED_IDS:
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
