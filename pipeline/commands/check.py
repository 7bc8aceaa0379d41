"""What recordings hold and whether they can be used, in words and as data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import RecordingError
from pipeline.formats.mcap.joint_states import JointRecording, RecordingReport
from pipeline.formats.mcap.rejection_reasons import SET_ASIDE
from pipeline.formats.recordings.folders import Bag, bags_of, read_folder, unread
from pipeline.formats.recordings.readers import inspect
from pipeline.params import Ingest
from pipeline.terminal import plain
from pipeline.trajectories.motion import greatest_speeds, longest_gap, rate_hz
from pipeline.trajectories.timebase import moving_part
from pipeline.workspace.demonstrations import NAMED_BY, Intake, demonstration
from pipeline.workspace.plausibility import require_one
from pipeline.workspace.project import Project

LONGEST_LINE = 4000  # characters
BAG_INDEX = "serialized_metadata"  # all of a bag's metadata.yaml, which rosbag2 writes into MCAP, too
LISTED = 200  # topics and metadata records
PLAIN = Ingest(waypoints=41, idle_rad=0.01, on_rejected="stop")  # where there is no project
Row = dict[str, Any]


@dataclass(frozen=True)
class Checked:
    """What was found of one recording, or of a file that is none.

    Attributes:
        source: where it is.
        reason, detail: why it cannot be used, or both None.
        aside: whether it is no recording and stops nothing.
        lines: what is said of it.
        data: the same for programs.
    """

    source: str
    reason: str | None
    detail: str | None
    aside: bool = False
    lines: tuple[str, ...] = ()
    data: Row = field(default_factory=dict)

    @property
    def usable(self) -> bool:
        """Whether nothing stands in the way of using it."""
        return self.reason is None or self.aside

    def text(self) -> list[str]:
        """Lines for a person."""
        if self.aside:
            verdict = f"set aside, {self.reason}: {self.detail}"
        else:
            verdict = "usable" if self.reason is None else f"cannot be used, {self.reason}: {self.detail}"
        return [plain(line, LONGEST_LINE) for line in (f"{self.source}: {verdict}", *self.lines)]

    def as_json(self) -> Row:
        """The same for a program."""
        return {
            "recording": self.source, "usable": self.reason is None, "reason": self.reason, "detail": self.detail,
            **self.data,
        }  # fmt: skip


def report(path: Path, project: Project | None, task: str | None) -> tuple[list[str], bool]:
    """Lines that describe what is at a path, and whether all of it can be used (for `task`, if one is given)."""
    found = list(checked(path, project, task))
    return [line for one in found for line in one.text()], all(one.usable for one in found)


def checked(path: Path, project: Project | None, task: str | None) -> Iterator[Checked]:
    """Each recording at a path: a file, a folder of recordings, or a dataset.

    Args:
        path: of it.
        project: whose settings of ingest are used, or None.
        task: of the project, for which the recordings are judged as ingest will.
    """
    intake = Intake.of(project, task) if project and task else None
    settings = project.params.ingest if project else None
    columns = intake.columns if intake else None
    try:
        bags = bags_of(path, columns)
    except RecordingError as error:
        bags = (Bag(path.stem, (path,)),) if path.suffix.lower() == ".mcap" and not path.is_dir() else ()
        if not bags:
            yield Checked(str(path), error.reason, error.detail)
    for bag in bags:
        yield _checked(path, bag, intake, settings)
    if not path.is_dir() or (bags and bags[0].files[0].parent == path and bags[0].listed and len(bags) == 1):
        return
    unused = read_folder(path, columns).unused
    for one in unused:
        yield Checked(str(path / one.source), one.reason, one.detail, one.reason in SET_ASIDE)
    if not bags and not any(one.reason not in SET_ASIDE for one in unused):
        yield Checked(
            str(path), "unreadable", "There is no recording in this folder; docs/recordings.md says what is read."
        )


def _checked(path: Path, bag: Bag, intake: Intake | None, settings: Ingest | None) -> Checked:
    asked = path if path in bag.files else None
    found = inspect(
        bag,
        settings.topic if settings else None,
        intake.recorded_joints if intake else None,
        intake.columns if intake else None,
        clock=settings.clock if settings else None,
        file=asked,
    )
    row: Row | None = None
    wrong = None if found.usable else _unusable(found)
    if intake and (wrong is None or intake.settings.salvage):
        row, wrong = _row(bag, intake)
    elif found.recording:
        wrong = _more_than_one(found.recording, settings or PLAIN)
    if asked is not None and not bag.entry:
        source = str(path)
    else:
        source = str((path if path.is_dir() else path.parent) / bag.source)
    lines = (
        *_salvage(found, bag, intake),
        *(_demonstration(row) if row else _recording(found.recording)),
        *_contents(found),
    )
    reason, detail = (wrong.reason, wrong.detail) if wrong else (None, None)
    return Checked(source, reason, detail, lines=lines, data=_data(found, row))


def _data(found: RecordingReport, row: Row | None) -> Row:
    """What a program may want to know of a recording."""
    recording = found.recording
    poses = None
    if recording is not None:
        poses = {
            "topic": recording.topic, "poses": len(recording.time_ns), "joints": list(recording.names),
            "clock": recording.clock, "dropped": recording.dropped, "remarks": list(recording.remarks),
            "duration_s": int(recording.time_ns[-1] - recording.time_ns[0]) / 1e9,
        }  # fmt: skip
    told = None if row is None else {key: value for key, value in row.items() if key not in ("waypoints", NAMED_BY)}
    return {
        "files": [str(found.path)], "profile": found.profile, "library": found.library, "poses": poses,
        "demonstration": told, "participant_by": row[NAMED_BY] or None if row else None,
        "topics": [asdict(topic) for topic in found.topics[:LISTED]],
        "metadata": dict(list(found.metadata.items())[:LISTED]),
    }  # fmt: skip


def _more_than_one(recording: JointRecording, settings: Ingest) -> RecordingError | None:
    """Whether a recording holds several motions, as far as that can be said without a scene."""
    time_s = (recording.time_ns - recording.time_ns[0]) / 1e9
    anywhere = np.ones(len(recording.names), dtype=bool)  # a joint with limits does not jump by a turn
    try:
        require_one(moving_part(time_s, recording.positions, anywhere, settings.idle_rad), settings, [])
    except RecordingError as error:
        return error
    return None


def _unusable(found: RecordingReport) -> RecordingError:
    other = unread(found.path) if found.reason == "not-mcap" else None
    return other or RecordingError(str(found.reason), str(found.detail))


def _row(bag: Bag, intake: Intake) -> tuple[Row | None, RecordingError | None]:
    """The demonstration that a recording is, or why it is none."""
    try:
        return demonstration(bag, intake), None
    except RecordingError as error:
        return None, error


def _salvage(found: RecordingReport, bag: Bag, intake: Intake | None) -> list[str]:
    """Of a recording that is cut off: what ingest.salvage takes of it."""
    part = found.salvageable
    if part is None:
        return ["  nothing in it can be salvaged"] if found.reason == "truncated" else []
    if intake is not None:
        try:
            demonstration(replace(bag, files=(found.path,)), intake.salvaging())
        except RecordingError as error:
            return [f"  nothing in it can be salvaged: {error.reason}: {error.detail}"]
    duration_s = (part.time_ns[-1] - part.time_ns[0]) / 1e9
    verb = "is" if intake and intake.settings.salvage else "can be"
    return [
        f"  {verb} salvaged with ingest.salvage: {len(part.time_ns):,} poses on {part.topic}, {duration_s:.2f} s; "
        f"lost: {part.lost}"
    ]


def _demonstration(row: Row) -> list[str]:
    """What ingest finds of a recording for a task."""
    ends = [
        f"{word} {row[f'{end}_apart']:.3g} (joint), {row[f'{end}_apart_m']:.3g} m (end effector)"
        for end, word in (("start", "to the start"), ("goal", "to the goal"))
        if row[f"{end}_apart"] is not None
    ]
    parts = f", in {row['files']} files" if row["files"] > 1 else ""
    by = f" (by {row[NAMED_BY]})" if row[NAMED_BY] else ""
    return [
        f"  demonstration {row['demonstration_id']} of {row['participant']}{by}{parts}: {row['duration_s']:.2f} s",
        f"  {row['clock']} times, {row['rate_hz']:.4g} Hz, {row['dropped']} samples dropped, longest gap "
        f"{row['longest_gap_s']:.3g} s, greatest speed {row['greatest_speed']:.3g} ({row['fastest_joint']})",
        *([f"  distance {'; '.join(ends)}"] if ends else []),
        *(f"  remark: {remark}" for remark in (row["remarks"] or "").split("; ") if remark),
    ]


def _recording(found: JointRecording | None) -> list[str]:
    """What can be said of a recording without a task; which joints turn without end is not known."""
    if found is None:
        return []
    time_s = (found.time_ns - found.time_ns[0]) / 1e9
    fastest = max(greatest_speeds(time_s, found.positions), key=lambda speed: speed.size)
    return [
        f"  {found.clock} times, {rate_hz(time_s):.4g} Hz, {found.dropped} samples dropped, longest gap "
        f"{longest_gap(time_s).size:.3g} s, greatest speed {fastest.size:.3g} ({found.names[fastest.joint]})",
        *(
            [
                "  remark: too fast for rad or m; if a table is in degrees or millimetres, give new-task "
                "--reading unit=deg or --reading unit=mm"
            ]
            if fastest.size > PLAIN.fastest_rad_s
            else []
        ),
        *(f"  remark: {remark}" for remark in found.remarks),
    ]


def _contents(found: RecordingReport) -> list[str]:
    lines = []
    for topic in found.topics[:LISTED]:
        rate = f", {topic.rate_hz:.1f} Hz" if topic.rate_hz else ""
        kind = f"{topic.schema} in {topic.encoding}"
        lines.append(f"  {topic.topic}: {kind}, {topic.messages:,} messages, {topic.duration_s:.2f} s{rate}")
        if topic.joints:
            lines.append(f"    joints: {', '.join(topic.joints)}")
    if len(found.topics) > LISTED:
        lines.append(f"  and {len(found.topics) - LISTED:,} more topics")
    for name, record in list(found.metadata.items())[:LISTED]:
        told = [f"{key} = {value}" for key, value in record.items() if key != BAG_INDEX]
        lines += [f"  {name}: {', '.join(told)}"] if told else []
    return lines
