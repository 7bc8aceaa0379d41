"""Recorded demonstrations: joint states in MCAP, as a ROS 2 driver's bag holds them.

What is read from other forms becomes a `JointRecording` by the same `joint_recording`, from the `Contents` that its
reader filled (see `pipeline.formats.recordings`). The contract of the channel is `schemas/joint_state.ros2msg`; the
codes of `RecordingError.reason` are in `rejection_reasons.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError, RecordingError
from pipeline.formats.mcap.channels import ChannelContents, Contents, DecodingOf, LoggedBlock
from pipeline.formats.mcap.container import CutOff
from pipeline.formats.mcap.limits import Limits
from pipeline.formats.mcap.poses import listed, poses, without_replaced
from pipeline.formats.mcap.rejection_reasons import REASONS, Reason, rejection
from pipeline.formats.mcap.topics import Choice, choose_topic, joint_names
from pipeline.formats.mcap.writer import write_joint_states
from pipeline.vocabulary import Clock

__all__ = [
    "REASONS",
    "JointRecording",
    "Limits",
    "Reason",
    "RecordingReport",
    "TopicReport",
    "inspect_recording",
    "joined",
    "read_joint_states",
    "write_joint_states",
]


@dataclass(frozen=True)
class JointRecording:
    """The poses of one recording, in order of time.

    Attributes:
        path: the file, or the first of several that are parts of one recording.
        topic: where the poses were published.
        time_ns: (M,) strictly increasing, M >= 2.
        names: the K joints.
        positions: (M, K) finite, rad for revolute joints and m for prismatic ones, as recorded (not unwrapped).
        metadata: the file's metadata records, name -> key -> text.
        clock: what `time_ns` is: the first of header stamps, publish times and log times that runs (see
            `clocks.timed`).
        dropped: how many poses were left out because that clock had no time of their own for them.
        remarks: what is odd about the recording, or was chosen in reading it, a phrase each.
        hashes: of the bytes that were read, SHA-256, by file.
        lost: None for a whole file; of one that is cut off, a sentence that says what is missing.
        called: what it is called in tables, if not by the name of its file.
    """

    path: Path
    topic: str
    time_ns: IntArray
    names: tuple[str, ...]
    positions: FloatArray
    metadata: dict[str, dict[str, str]]
    clock: Clock
    dropped: int
    remarks: tuple[str, ...]
    hashes: Mapping[Path, str]
    lost: str | None = None
    called: str = ""

    @property
    def source(self) -> str:
        """What it is called in tables."""
        return self.called or self.path.name


@dataclass(frozen=True)
class TopicReport:
    """What one topic of a recording holds; duration and rate are by log time, rate None below two messages."""

    topic: str
    schema: str
    encoding: str
    messages: int
    joints: tuple[str, ...]
    duration_s: float
    rate_hz: float | None


@dataclass(frozen=True)
class RecordingReport:
    """What a file holds as far as it can be read, and whether it can be used.

    Attributes:
        path: the file.
        profile: of the MCAP header, `ros2` for a ROS 2 bag.
        library: what wrote the file.
        topics: all topics, by name.
        metadata: the file's metadata records.
        recording: the poses, or None if the file cannot be used.
        reason: why it cannot be used, or None.
        detail: the same as a sentence, or None.
        salvageable: of a file that is cut off: the poses before that place, if `salvage` would take them.
    """

    path: Path
    profile: str
    library: str
    topics: tuple[TopicReport, ...]
    metadata: dict[str, dict[str, str]]
    recording: JointRecording | None
    reason: str | None
    detail: str | None
    salvageable: JointRecording | None = None

    @property
    def usable(self) -> bool:
        """Whether `read_joint_states` accepts the file with the same arguments."""
        return self.reason is None


def read_joint_states(
    path: Path | str,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    limits: Limits | None = None,
    *,
    clock: Clock | None = None,
    salvage: bool = False,
    least: int = 2,
    decoding_of: DecodingOf | None = None,
) -> JointRecording:
    """Read the poses of one MCAP file.

    Messages are taken in the order in which the file has them: a recorder writes one topic as it comes, so a time that
    goes back means that a clock was set or that the file was put together, and either makes the motion a guess. Skipped
    are messages without positions (they carry no pose), messages naming none of the joints (another device on the same
    topic), and exact repeats: the same pose at the same time. Poses whose time repeats or is a little late are left out
    and counted. Anything else that is out of order is an error.

    Args:
        path: an MCAP file.
        topic: which JointState topic; None for the only one that has all of `joints`, or see `choose_topic`.
        joints: the joints needed, which become the columns in this order; None for those of the first message.
        limits: what reading may cost.
        clock: which times to use; None for the first clock that runs.
        salvage: of a file that is cut off, use the whole records before that place instead of refusing it. Only a cut
            is salvaged: what fails a checksum or contradicts itself is refused all the same.
        least: how many poses are needed, 2 unless it is a part of a recording.
        decoding_of: how channels are read that are no JointState of ROS.

    Raises:
        ArgumentError: `joints` is empty or names a joint twice.
        RecordingError: the recording cannot be used; its reason is one of `REASONS` except does-not-move.
    """
    _check_joints(joints)
    contents = Contents(decoding_of)
    try:
        contents.read(Path(path), limits or Limits())
    except CutOff:
        if not salvage:
            raise
    return joint_recording(Path(path), contents, topic, joints, clock, least)


def joined(parts: Sequence[JointRecording]) -> JointRecording:
    """One recording from the parts in which it was written, in order, one or more.

    Raises:
        RecordingError: time-not-increasing, or the parts have poses of different joints, topics or clocks.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    for before, after in pairwise(parts):
        if (before.topic, before.names, before.clock) != (after.topic, after.names, after.clock):
            raise rejection(
                "incomplete-bag",
                f"{before.path.name} and {after.path.name} are parts of one recording, but of topic {before.topic} by "
                f"{before.clock} time and of {after.topic} by {after.clock} time; name ingest.topic and ingest.clock.",
            )
        if after.time_ns[0] <= before.time_ns[-1]:
            raise rejection(
                "time-not-increasing",
                f"{after.path.name} begins before {before.path.name} ends, and both are parts of one recording; move "
                "files that are recordings of their own into another folder.",
            )
    time_ns, positions = (
        np.concatenate([getattr(part, field) for part in parts]) for field in ("time_ns", "positions")
    )
    time_ns.flags.writeable = positions.flags.writeable = False
    names = listed([part.path.name for part in parts])
    said = dict.fromkeys(remark for part in parts for remark in part.remarks)
    return replace(
        first,
        time_ns=time_ns,
        positions=positions,
        metadata={name: record for part in reversed(parts) for name, record in part.metadata.items()},
        dropped=sum(part.dropped for part in parts),
        remarks=(f"put together from its {len(parts)} parts {names}", *said),
        hashes={file: value for part in parts for file, value in part.hashes.items()},
        lost=next((part.lost for part in parts if part.lost is not None), None),
    )


def inspect_recording(
    path: Path | str,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    limits: Limits | None = None,
    *,
    clock: Clock | None = None,
    decoding_of: DecodingOf | None = None,
) -> RecordingReport:
    """Say what an MCAP file holds and whether `read_joint_states` would accept it; arguments as there.

    Raises:
        ArgumentError: `joints` is empty or names a joint twice.
    """
    contents = Contents(decoding_of)
    return report_of(Path(path), contents, lambda: contents.read(Path(path), limits or Limits()), topic, joints, clock)


def report_of(
    path: Path,
    contents: Contents,
    read: Callable[[], None],
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    clock: Clock | None = None,
) -> RecordingReport:
    """What `contents` hold once `read` has filled them, and whether `joint_recording` accepts them.

    Raises:
        ArgumentError: `joints` is empty or names a joint twice.
    """
    _check_joints(joints)
    recording, salvageable, reason, detail = None, None, None, None
    try:
        read()
        recording = joint_recording(path, contents, topic, joints, clock)
    except RecordingError as error:
        reason, detail = error.reason, error.detail
    if contents.cut is not None:
        with suppress(RecordingError):
            salvageable = joint_recording(path, contents, topic, joints, clock)
    channels = sorted(contents.channels.values(), key=lambda channel: channel.topic)
    return RecordingReport(
        path=path,
        profile=contents.profile,
        library=contents.library,
        topics=tuple(_topic_report(channel) for channel in channels),
        metadata=contents.metadata,
        recording=recording,
        reason=reason,
        detail=detail,
        salvageable=salvageable,
    )


def _topic_report(channel: ChannelContents) -> TopicReport:
    duration_s = (channel.last_log_ns - channel.first_log_ns) / 1e9
    return TopicReport(
        topic=channel.topic,
        schema=channel.schema,
        encoding=channel.encoding,
        messages=channel.messages,
        joints=joint_names(channel.blocks),
        duration_s=duration_s,
        rate_hz=(channel.messages - 1) / duration_s if duration_s > 0 else None,
    )


def _check_joints(joints: Sequence[str] | None) -> None:
    if joints is not None and (isinstance(joints, str) or not joints or len(set(joints)) < len(joints)):
        raise ArgumentError(f"joints must be one or more different names or None, got {joints!r}.")


def joint_recording(
    path: Path,
    contents: Contents,
    topic: str | None,
    joints: Sequence[str] | None,
    clock: Clock | None = None,
    least: int = 2,
) -> JointRecording:
    """The poses of `joints` in what was read of a file; arguments as of `read_joint_states`.

    Of a file that has measured states and plans, the states are taken, unless `topic` names a plan.

    Raises:
        RecordingError: see `read_joint_states`.
    """
    by_topic: dict[str, list[LoggedBlock]] = {}
    readable = [channel for channel in contents.channels.values() if channel.has_joint_states]
    measured = [channel for channel in readable if not channel.planned]
    for channel in (measured or readable) if topic is None else readable:
        blocks = without_replaced(channel.blocks) if channel.planned else channel.blocks
        by_topic.setdefault(channel.topic, []).extend(blocks)
    if not by_topic or (topic is not None and topic not in by_topic):
        refused = [channel.refused for channel in contents.channels.values() if topic in (None, channel.topic)]
        raise next(filter(None, refused), None) or _no_joint_states(contents, topic)
    choice = choose_topic(by_topic, joints) if topic is None else Choice(topic)
    blocks = [block for block in by_topic[choice.topic] if block.states.names]
    if not blocks:
        raise rejection(
            "too-few-messages",
            f"No message on {choice.topic} has positions; at least {least} pose{'s are' if least > 1 else ' is'} "
            "needed.",
        )
    names = tuple(joints or min(blocks, key=lambda block: block.log_ns.min()).states.names)
    found = poses(choice.topic, blocks, names, clock, least)
    found.time_ns.flags.writeable = found.positions.flags.writeable = False
    return JointRecording(
        path=path,
        topic=choice.topic,
        time_ns=found.time_ns,
        names=names,
        positions=found.positions,
        metadata=contents.metadata,
        clock=found.clock,
        dropped=found.dropped,
        remarks=(*([choice.remark] if choice.remark else []), *_of_schemas(contents, choice.topic), *found.remarks),
        hashes={path: contents.sha256},
        lost=_lost(contents),
    )


def _of_schemas(contents: Contents, topic: str) -> list[str]:
    """What is to be said of the schemas of a topic's channels."""
    said = [channel.said for channel in contents.channels.values() if channel.topic == topic]
    return list(dict.fromkeys(filter(None, said)))


def _no_joint_states(contents: Contents, topic: str | None) -> RecordingError:
    wanted = "sensor_msgs/msg/JointState in CDR or ROS 1" + (f" on {topic}" if topic else "")
    others = ", nor another message with names and positions of joints" if contents.decoding_of else ""
    return rejection("no-joint-states", f"There is no {wanted}{others}; the file has {_listing(contents)}.")


def _lost(contents: Contents) -> str | None:
    """What a file that breaks off has lost, as far as that can be known."""
    cut = contents.cut
    if cut is None:
        return None
    if not cut.in_data:
        return "No message: the file breaks off after the last of them."
    trust = f", {cut.unchecked} of their bytes covered by no checksum" if cut.unchecked else ""
    return (
        f"{cut.left} bytes from byte {cut.at} on and whatever was never written; used are the {contents.messages} "
        f"messages before{trust}."
    )


def _listing(contents: Contents) -> str:
    channels = sorted({(c.topic, c.schema or "no schema", c.encoding) for c in contents.channels.values()})
    return listed([f"{topic} ({schema}, {encoding})" for topic, schema, encoding in channels]) or "no topics"
