"""What a recording holds and whether it can be used, in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import RecordingError
from pipeline.formats.mcap.bags import Bag, bag_of, unread
from pipeline.formats.mcap.joint_states import JointRecording, RecordingReport, inspect_recording
from pipeline.params import Ingest
from pipeline.terminal import plain
from pipeline.trajectories.motion import greatest_speeds, longest_gap, rate_hz
from pipeline.trajectories.timebase import moving_part
from pipeline.workspace.demonstrations import Intake, demonstration
from pipeline.workspace.plausibility import require_one
from pipeline.workspace.project import Project

LONGEST_LINE = 4000  # characters
LISTED = 200  # topics and metadata records
PLAIN = Ingest(waypoints=41, idle_rad=0.01, on_rejected="stop")  # where there is no project
Row = dict[str, Any]


def report(path: Path, project: Project | None, task: str | None) -> tuple[list[str], bool]:
    """Lines that describe the file, and whether it can be used (for `task`, if one is given)."""
    intake = Intake.of(project, task) if project and task else None
    settings = project.params.ingest if project else None
    found = inspect_recording(
        path,
        settings.topic if settings else None,
        intake.recorded_joints if intake else None,
        clock=settings.clock if settings else None,
    )
    row: Row | None = None
    verdict = None if found.usable else _unusable(found)
    if intake and (verdict is None or intake.settings.salvage):
        row, verdict = _row(path, intake)
    elif found.recording:
        verdict = _more_than_one(found.recording, settings or PLAIN)
    lines = [
        f"{path}: {'usable' if verdict is None else f'cannot be used, {verdict}'}",
        *_salvage(found, intake),
        *(_demonstration(row) if row else _recording(found.recording)),
        *_contents(found),
    ]
    return [plain(line, LONGEST_LINE) for line in lines], verdict is None


def _more_than_one(recording: JointRecording, settings: Ingest) -> str | None:
    """Whether a recording holds several motions, as far as that can be said without a scene."""
    time_s = (recording.time_ns - recording.time_ns[0]) / 1e9
    anywhere = np.ones(len(recording.names), dtype=bool)  # a joint with limits does not jump by a turn
    try:
        require_one(moving_part(time_s, recording.positions, anywhere, settings.idle_rad), settings, [])
    except RecordingError as error:
        return f"{error.reason}: {error.detail}"
    return None


def _unusable(found: RecordingReport) -> str:
    other = unread(found.path) if found.reason == "not-mcap" else None
    return f"{other.reason}: {other.detail}" if other else f"{found.reason}: {found.detail}"


def _row(path: Path, intake: Intake) -> tuple[Row | None, str | None]:
    """The demonstration that a file is, or is a part of, or why it is none."""
    try:
        return demonstration(bag_of(path), intake), None
    except RecordingError as error:
        return None, f"{error.reason}: {error.detail}"


def _salvage(found: RecordingReport, intake: Intake | None) -> list[str]:
    """Of a recording that is cut off: what ingest.salvage takes of it."""
    part = found.salvageable
    if part is None:
        return ["  nothing in it can be salvaged"] if found.reason == "truncated" else []
    if intake is not None:
        try:
            demonstration(Bag(found.path.stem, (found.path,)), intake.salvaging())
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
    return [
        f"  demonstration {row['demonstration_id']} of {row['participant']}{parts}: {row['duration_s']:.2f} s",
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
        lines.append(f"  {name}: " + ", ".join(f"{key} = {value}" for key, value in record.items()))
    return lines
