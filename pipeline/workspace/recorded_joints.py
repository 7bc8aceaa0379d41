"""Which joints recordings have, before it is known which of them are wanted."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.folders import Bag, read_folder
from pipeline.formats.recordings.readers import inspect
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


def recorded_joints(folder: Path, columns: ColumnMap | None = None) -> RecordedJoints:
    """What the recordings in a folder name; those that cannot be read are passed over here, and said by ingest.

    Args:
        folder: of recordings, or a dataset.
        columns: what the columns of tables mean.
    """
    bags = read_folder(folder, columns).bags[:MOST]
    return shared_by(_named(bag, columns) for bag in tracked(list(bags), "recordings"))


def shared_by(names: Iterable[Iterable[str]]) -> RecordedJoints:
    """The names that all of several recordings have, in the order of the first; recordings without any do not count."""
    sets = [dict.fromkeys(one) for one in names]
    sets = [one for one in sets if one]
    every = list(dict.fromkeys(name for one in sets for name in one))
    shared = tuple(name for name in every if all(name in one for one in sets))
    return RecordedJoints(len(sets), shared, tuple(name for name in every if name not in shared))


def _named(bag: Bag, columns: ColumnMap | None) -> list[str]:
    """Names on all topics of a recording."""
    return [joint for topic in inspect(bag, columns=columns).topics for joint in topic.joints]
