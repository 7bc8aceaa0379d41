"""What files and folders hold: recordings, each with the reader that is for it, and what is no recording.

A file may be one recording (a bag, a table) or hold several (HDF5, a table with a column of ids); a folder may be one,
a bag of ROS 2, or hold several, a dataset of LeRobot.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any

from pipeline.errors import RecordingError
from pipeline.formats.mcap.container import ENDING
from pipeline.formats.mcap.rejection_reasons import Reason, rejection
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.forms import (
    BAG_ENDINGS,
    INDEX,
    INFO,
    Form,
    form_of_file,
    is_dataset,
)  # fmt: skip
from pipeline.formats.recordings.hdf5 import groups
from pipeline.formats.recordings.lerobot import episodes
from pipeline.formats.recordings.tables import recordings_in_table
from pipeline.yaml_text import YamlError, plain_yaml

PARTICIPANTS = "participants.csv"  # says who made which recording, see `pipeline.workspace.participants`
LARGEST_INDEX = 1 << 20  # bytes
MOST_ENTRIES = 100_000  # recordings in a folder
_NUMBERED = re.compile(r"(.+)_(\d{1,9})")
_CONVERTED = {
    ".active": "its recorder has not finished it; wait, or mend it with `rosbag reindex {name}`",
    ".zstd": "it is compressed as a whole; unpack it with `zstd -d {name} -o {stem}`",
    ".zst": "it is compressed as a whole; unpack it with `zstd -d {name} -o {stem}`",
    ".gz": "it is compressed as a whole; unpack it with `gzip -dk {name}`",
    ".lz4": "it is compressed as a whole; unpack it with `lz4 -d {name} {stem}`",
    ".zip": "it is an archive; unpack it with `unzip {name}`",
    ".tar": "it is an archive; unpack it with `tar -xf {name}`",
    ".tgz": "it is an archive; unpack it with `tar -xf {name}`",
    ".npy": "it is one array without names; save it with its times as .npz",
    ".xlsx": "it is a workbook; save its sheet as .csv",
    ".pkl": "it is a pickle, which is a program and never run; save its arrays as .npz",
    ".pickle": "it is a pickle, which is a program and never run; save its arrays as .npz",
}


@dataclass(frozen=True)
class Bag:
    """One recording and where it is.

    Attributes:
        name: what the demonstration is called.
        files: in order of time; of a dataset, the one that has it.
        listed: whether it is known that they belong together and to nothing else; a single file may be a part.
        form: which reader is for it.
        entry: which of several recordings in the file it is, empty if it is the only one.
        called: what it is called in tables, if not by the name of its first file.
        metadata: what stands beside its files about it, record -> key -> text.
    """

    name: str
    files: tuple[Path, ...]
    listed: bool = False
    form: Form = "mcap"
    entry: str = ""
    called: str = ""
    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def source(self) -> str:
        """What it is called in tables and messages."""
        return self.called or self.files[0].name


@dataclass(frozen=True)
class Unused:
    """A file or folder that is not used as it is.

    Attributes:
        source: its name.
        reason, detail: why.
    """

    source: str
    reason: Reason
    detail: str


@dataclass(frozen=True)
class Folder:
    """What a folder holds, in the order of the names.

    Attributes:
        bags: the recordings.
        unused: everything else but the files that tell of recordings.
    """

    bags: tuple[Bag, ...]
    unused: tuple[Unused, ...]


def read_folder(folder: Path, columns: ColumnMap | None = None) -> Folder:
    """Sort the entries of a folder; a folder that is not there is empty.

    Args:
        folder: of recordings, or a dataset itself.
        columns: what the columns of tables mean.
    """
    if is_dataset(folder):
        return _gathered([_Inside(folder, folder, columns)])
    entries = sorted(folder.iterdir(), key=lambda path: path.name) if folder.is_dir() else []
    together, error = _together(folder, entries)
    beside = {INDEX, PARTICIPANTS} | ({file.name for file in together.files} if together else set())
    there = [_Inside(folder, path, columns) for path in entries if path.name not in beside]
    return _gathered(there, [together] if together else [], [error] if error else [])


def bags_of(path: Path, columns: ColumnMap | None = None) -> tuple[Bag, ...]:
    """The recordings that a file or folder is, holds, or is a part of.

    Raises:
        RecordingError: see `read_folder`; the metadata.yaml beside it is not what it should be, or it holds none.
    """
    if path.is_dir():
        if (bag := _bag_folder(path)) is not None:
            return (bag,)
        return read_folder(path, columns).bags
    if path.is_file() and (path.parent / INDEX).is_file():
        together = _indexed(path.parent)
        if together is not None and path in together.files:
            return (together,)
    return tuple(_in_file(path, columns))


def bag_of(file: Path) -> Bag:
    """The one recording that a file is or belongs to; errors as of `bags_of`."""
    return bags_of(file)[0]


@dataclass(frozen=True)
class _Inside:
    """An entry of a folder that is looked into."""

    folder: Path
    path: Path
    columns: ColumnMap | None

    def bags(self) -> Iterator[Bag]:
        """The recordings in it, called by where they are in the folder.

        Raises:
            RecordingError: it holds none, or cannot be looked into.
        """
        path = self.path
        if is_dataset(path):
            prefix = "" if path == self.folder else f"{path.name}_"
            for episode in episodes(path):
                within = episode.file.relative_to(self.folder)
                yield Bag(
                    f"{prefix}episode_{episode.number:06d}", (episode.file,), True, "lerobot", str(episode.number),
                    f"{within}: episode {episode.number}",
                )  # fmt: skip
        elif path.is_dir():
            bag = _bag_folder(path)
            if bag is None:
                raise _not_looked_into(path)
            yield replace(bag, called=f"{path.name}/{bag.files[0].name}")
        elif form_of_file(path) is not None:
            yield from _in_file(path, self.columns)
        else:
            raise unread(path) or rejection(
                "not-a-recording", "It has none of the endings of recordings, so it is not taken for one."
            )


def _gathered(there: Sequence[_Inside], bags: Sequence[Bag] = (), unused: Sequence[Unused] = ()) -> Folder:
    found, left = list(bags), list(unused)
    for one in there:
        try:
            for bag in one.bags():
                if len(found) == MOST_ENTRIES:
                    raise rejection("too-large", f"The folder holds more than {MOST_ENTRIES} recordings; split it.")
                found.append(bag)
        except RecordingError as error:
            left.append(Unused(one.path.name, error.reason, error.detail))  # type: ignore[arg-type]
    return Folder(tuple(sorted(found, key=lambda bag: bag.name)), tuple(left))


def _in_file(path: Path, columns: ColumnMap | None) -> Iterator[Bag]:
    """The recordings in a file; one that is not there, or of no known ending, is left to the reader of MCAP files."""
    form = form_of_file(path) or "mcap"
    if form == "hdf5":
        for name in groups(path, columns):
            yield Bag(f"{path.stem}_{name}", (path,), True, form, name, f"{path.name}: {name}")
    elif form == "table":
        for entry in recordings_in_table(path, columns):
            if entry:
                yield Bag(f"{path.stem}_{entry}", (path,), True, form, entry, f"{path.name}: {entry}")
            else:
                yield Bag(path.stem, (path,), form=form)
    else:
        yield Bag(_stem(path), (path,), form=form)


def _stem(path: Path) -> str:
    """The name without its ending, and without that of a file that was compressed."""
    inner = Path(path.stem)
    return inner.stem if inner.suffix.lower() in BAG_ENDINGS and path.suffix.lower() not in BAG_ENDINGS else path.stem


def sequences(bags: Sequence[Bag]) -> Iterator[tuple[Bag, ...]]:
    """The bags, those whose names are numbered as rosbag2 numbers the parts of one, `name_0`, `name_1`, together.

    Whether they are parts of one recording, their times and poses must say.
    """
    numbered: dict[str, list[tuple[int, Bag]]] = {}
    for bag in bags:
        found = None if bag.listed else _NUMBERED.fullmatch(bag.name)
        stem, number = (found[1], int(found[2])) if found else (f"{bag.name}/", 0)
        numbered.setdefault(stem, []).append((number, bag))
    for same in numbered.values():
        ordered = sorted(same, key=lambda one: (one[0], one[1].name))
        run = [ordered[0]]
        for one in ordered[1:]:
            if one[0] != run[-1][0] + 1:
                yield tuple(bag for _, bag in run)
                run = []
            run.append(one)
        yield tuple(bag for _, bag in run)


def stem_of(parts: Sequence[Bag]) -> str:
    """The name of a recording whose parts are numbered."""
    found = _NUMBERED.fullmatch(parts[0].name)
    return found[1] if found and len(parts) > 1 else parts[0].name


def unread(path: Path) -> RecordingError | None:
    """Why a file that may be a recording in another form is not read, with the command that converts it."""
    hint = _CONVERTED.get(path.suffix.lower())
    if hint is None:
        return None
    return rejection("not-read", f"{path.name} is not read: {hint.format(name=path.name, stem=path.stem)}.")


def _not_looked_into(path: Path) -> RecordingError:
    inside = sum(1 for file in path.rglob("*") if file.suffix.lower() == ENDING)
    if not inside:
        reason: Reason = "unreadable" if path.suffix.lower() == ENDING else "not-a-recording"
        return rejection(reason, "It is a folder, without MCAP files in it, and no dataset.")
    return rejection(
        "not-read",
        f"It is a folder with {inside} MCAP file{'s' * (inside != 1)}, and folders in the folder of recordings are "
        f"looked into only if they have the {INDEX} of a bag or the {INFO} of a dataset; move the files up, or give "
        f"them "
        "a task of their own.",
    )


def _together(folder: Path, entries: Sequence[Path]) -> tuple[Bag | None, Unused | None]:
    """The bag whose parts the metadata.yaml of a folder lists, or why that cannot be used."""
    if folder / INDEX not in entries:
        return None, None
    try:
        return _indexed(folder), None
    except RecordingError as error:
        return None, Unused(INDEX, error.reason, error.detail)  # type: ignore[arg-type]


def _bag_folder(folder: Path) -> Bag | None:
    """The bag that a folder is, as `ros2 bag record` writes it; None if it has no metadata.yaml.

    Raises:
        RecordingError: bad-metadata or incomplete-bag.
    """
    if not (folder / INDEX).is_file():
        return None
    found = _parts(folder)
    return None if found is None else replace(found, name=folder.name, listed=True)


def _indexed(folder: Path) -> Bag | None:
    """The bag that the metadata.yaml beside recordings lists; None if it lists no file of a bag, or only one.

    Raises:
        RecordingError: bad-metadata or incomplete-bag.
    """
    found = _parts(folder)
    return found if found is not None and len(found.files) > 1 else None


def _parts(folder: Path) -> Bag | None:
    """The bag of the files that the metadata.yaml of a folder lists; None if these are no bag.

    Raises:
        RecordingError: bad-metadata or incomplete-bag.
    """
    listed, custom = _listed(folder / INDEX)
    names = [PurePosixPath(name) for name in listed]
    files = [folder / name for name in names if form_of_file(Path(name)) in ("mcap", "sqlite")]
    if not files:
        return None
    for name in names:
        if len(name.parts) != 1 or not (folder / name).is_file():
            raise rejection(
                "incomplete-bag",
                f"{INDEX} lists the parts of one recording, and {name} is not in the folder; put it back, or remove "
                f"{INDEX} if the others are recordings of their own.",
            )
    found = _NUMBERED.fullmatch(_stem(files[0]))
    form = form_of_file(files[0])
    assert form is not None
    called = found[1] if found else _stem(files[0])
    return Bag(called, tuple(files), True, form, metadata={"demonstration": custom} if custom else {})


def _listed(path: Path) -> tuple[list[str], dict[str, str]]:
    """The entries relative_file_paths and custom_data of what rosbag2 wrote.

    Raises:
        RecordingError: bad-metadata.
    """
    try:
        with path.open("rb") as stream:
            text = stream.read(LARGEST_INDEX + 1)
        if len(text) > LARGEST_INDEX:
            raise rejection("bad-metadata", f"{INDEX} has more than {LARGEST_INDEX} bytes; remove it.")
        content: Any = plain_yaml(text.decode())
        information = content["rosbag2_bagfile_information"]
        found, custom = information["relative_file_paths"], information.get("custom_data") or {}
    except OSError as error:
        raise rejection("bad-metadata", f"{INDEX} cannot be read: {error.strerror or error}.") from error
    except (YamlError, UnicodeDecodeError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise rejection(
            "bad-metadata", f"{INDEX} is not what rosbag2 writes, and lists no relative_file_paths; remove it."
        ) from error
    if not isinstance(found, list) or not all(isinstance(name, str) and name for name in found):
        raise rejection("bad-metadata", f"{INDEX} lists relative_file_paths that are no names of files; remove it.")
    if not isinstance(custom, dict) or not all(isinstance(text, str) for item in custom.items() for text in item):
        raise rejection("bad-metadata", f"{INDEX} has custom_data that are no texts by text; mend it.")
    return found, custom
