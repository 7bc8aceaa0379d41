"""Which joints recordings have, before it is known which of them are wanted."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pipeline.formats.mcap.bags import read_folder
from pipeline.formats.mcap.joint_states import inspect_recording
from pipeline.workspace.progress import tracked

MOST = 50  # recordings that are looked at; more would tell the same


@dataclass(frozen=True)
class RecordedJoints:
    """What recordings name.

    Attributes:
        recordings: how many have joint states, of those that were looked at.
        shared: names of the joints that all of these have.
        some: names that only some of them have.
    """

    recordings: int
    shared: tuple[str, ...]
    some: tuple[str, ...]


def recorded_joints(folder: Path) -> RecordedJoints:
    """What the recordings in a folder name; those that cannot be read are passed over here, and said by ingest."""
    bags = read_folder(folder).bags[:MOST]
    return shared_by(_named(bag.files[0]) for bag in tracked(list(bags), "recordings"))


def shared_by(names: Iterable[Iterable[str]]) -> RecordedJoints:
    """The names that all of several recordings have, in the order of the first; recordings without any do not count."""
    sets = [dict.fromkeys(one) for one in names]
    sets = [one for one in sets if one]
    every = list(dict.fromkeys(name for one in sets for name in one))
    shared = tuple(name for name in every if all(name in one for one in sets))
    return RecordedJoints(len(sets), shared, tuple(name for name in every if name not in shared))


def _named(file: Path) -> list[str]:
    """Names on all topics of a recording."""
    return [joint for topic in inspect_recording(file).topics for joint in topic.joints]
