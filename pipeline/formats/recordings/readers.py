"""The one way to read a recording, whatever form it is in, and to say what it holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pipeline.errors import RecordingError
from pipeline.formats.mcap.channels import Contents
from pipeline.formats.mcap.container import CutOff
from pipeline.formats.mcap.joint_states import JointRecording, RecordingReport, joined, joint_recording, report_of
from pipeline.formats.mcap.limits import Limits
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.decoding import decoding_of
from pipeline.formats.recordings.folders import Bag
from pipeline.formats.recordings.forms import COMPRESSED
from pipeline.formats.recordings.hdf5 import fill_from_hdf5
from pipeline.formats.recordings.lerobot import fill_from_lerobot
from pipeline.formats.recordings.opening import hash_of, inflated, require_regular
from pipeline.formats.recordings.ros1_bag import fill_from_ros1_bag
from pipeline.formats.recordings.sqlite_bag import fill_from_sqlite
from pipeline.formats.recordings.tables import fill_from_table
from pipeline.vocabulary import Clock

_LIMITS = Limits()
_WITH_TOPICS = ("mcap", "sqlite", "ros1")


def read_recording(
    bag: Bag,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    columns: ColumnMap | None = None,
    *,
    clock: Clock | None = None,
    salvage: bool = False,
    limits: Limits = _LIMITS,
) -> JointRecording:
    """The poses of a recording, in one file or in several that follow each other.

    Args:
        bag: what and where it is.
        topic: of a bag: which topic; None as for `pipeline.formats.mcap.joint_states.read_joint_states`.
        joints: those that are needed, in order; None for all.
        columns: of a table or dataset: what its columns mean.
        clock, salvage, limits: as for `read_joint_states`.

    Raises:
        RecordingError: it cannot be used; see `read_joint_states`.
    """
    parts, empty = list[JointRecording](), list[str]()
    least = 2 if len(bag.files) == 1 else 1
    for file in bag.files:
        contents = Contents(decoding_of)
        try:
            try:
                _fill(contents, bag, file, joints, columns, limits)
            except CutOff:
                if not salvage:
                    raise
            asked = topic if bag.form in _WITH_TOPICS else None
            parts.append(joint_recording(file, contents, asked, joints, clock, least))
        except RecordingError as error:
            if len(bag.files) == 1:
                raise
            if error.reason not in ("too-few-messages", "no-joint-states"):
                raise rejection(error.reason, f"{file.name}, a part of {bag.name}: {error.detail}") from error  # type: ignore[arg-type]
            empty.append(file.name)
    if not parts:
        raise rejection("no-joint-states", f"No part of {bag.name} has poses of {', '.join(joints or ())}.")
    whole = joined(parts)
    if len(whole.time_ns) < 2:
        raise rejection("too-few-messages", f"{bag.name} has 1 pose; 2 or more are needed.")
    metadata = whole.metadata | {name: dict(record) for name, record in bag.metadata.items()}
    return replace(whole, called=bag.called, metadata=metadata)


def inspect(
    bag: Bag,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    columns: ColumnMap | None = None,
    *,
    clock: Clock | None = None,
    file: Path | None = None,
) -> RecordingReport:
    """What a file of a recording holds, its first unless another is named, and whether it can be used.

    Arguments are those of `read_recording`.
    """
    path = file or bag.files[0]
    contents = Contents(decoding_of)
    asked = topic if bag.form in _WITH_TOPICS else None
    found = report_of(
        path, contents, lambda: _fill(contents, bag, path, joints, columns, _LIMITS), asked, joints, clock
    )
    return replace(found, metadata=found.metadata | {name: dict(record) for name, record in bag.metadata.items()})


def _fill(
    contents: Contents,
    bag: Bag,
    file: Path,
    joints: Sequence[str] | None,
    columns: ColumnMap | None,
    limits: Limits,
) -> None:
    """Read one file with the reader that is for it."""
    if bag.form == "mcap" and file.suffix.lower() not in COMPRESSED:
        contents.read(file, limits)
        return
    require_regular(file, limits)
    contents.sha256 = hash_of(file)
    if bag.form == "table":
        fill_from_table(contents, file, bag.entry, columns, joints, limits)
    elif bag.form == "lerobot":
        fill_from_lerobot(contents, file, int(bag.entry), columns, joints)
    elif bag.form == "hdf5":
        fill_from_hdf5(contents, file, bag.entry, columns, joints, limits)
    elif bag.form == "ros1":
        fill_from_ros1_bag(contents, file, limits)
    else:
        with inflated(file, limits) as plain:
            if bag.form == "sqlite":
                fill_from_sqlite(contents, plain, limits)
            else:
                stored = contents.sha256
                contents.read(plain, limits)
                contents.sha256 = stored
