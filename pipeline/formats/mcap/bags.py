"""What a folder of recordings holds: single files, bags that were split into several, and what is no recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from pipeline.errors import RecordingError
from pipeline.formats.mcap.rejection_reasons import Reason, rejection
from pipeline.yaml_text import YamlError, plain_yaml

ENDING = ".mcap"
INDEX = "metadata.yaml"  # what rosbag2 writes beside the files of a bag
LARGEST_INDEX = 1 << 20  # bytes
_NUMBERED = re.compile(r"(.+)_(\d{1,9})")
_CONVERTED = {
    ".db3": "it is a ROS 2 bag in SQLite; convert it with `mcap convert {name} {stem}.mcap`",
    ".bag": "it is a ROS 1 bag; convert it with `mcap convert {name} {stem}.mcap`",
    ".active": "its recorder has not finished it; wait, or mend it with `rosbag reindex {name}`",
    ".zstd": "it is compressed as a whole; unpack it with `zstd -d {name} -o {stem}`",
    ".zst": "it is compressed as a whole; unpack it with `zstd -d {name} -o {stem}`",
    ".gz": "it is compressed as a whole; unpack it with `gzip -dk {name}`",
    ".lz4": "it is compressed as a whole; unpack it with `lz4 -d {name} {stem}`",
    ".zip": "it is an archive; unpack it with `unzip {name}`",
    ".tar": "it is an archive; unpack it with `tar -xf {name}`",
    ".tgz": "it is an archive; unpack it with `tar -xf {name}`",
    ".csv": "it is a table; only MCAP files with JointState messages are read",
    ".parquet": "it is a table; only MCAP files with JointState messages are read",
    ".h5": "it is an HDF5 file; only MCAP files with JointState messages are read",
    ".hdf5": "it is an HDF5 file; only MCAP files with JointState messages are read",
}


@dataclass(frozen=True)
class Bag:
    """The files of one recording.

    Attributes:
        name: what the demonstration is called.
        files: in order of time.
        listed: whether a metadata.yaml says that they belong together; a single file needs none.
    """

    name: str
    files: tuple[Path, ...]
    listed: bool = False


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
        unused: everything else but the metadata.yaml of a bag.
    """

    bags: tuple[Bag, ...]
    unused: tuple[Unused, ...]


def read_folder(folder: Path) -> Folder:
    """Sort the entries of a folder; a folder that is not there is empty."""
    entries = sorted(folder.iterdir(), key=lambda path: path.name) if folder.is_dir() else []
    files = [path for path in entries if is_recording(path) and not path.is_dir()]
    unused = [_unused(path) for path in entries if path not in files and path.name != INDEX]
    together: Bag | None = None
    if folder / INDEX in entries:
        try:
            together = _indexed(folder)
        except RecordingError as error:
            unused.append(Unused(INDEX, error.reason, error.detail))  # type: ignore[arg-type]
    bags = [Bag(file.stem, (file,)) for file in files if together is None or file not in together.files]
    if together is not None:
        bags.append(together)
    return Folder(tuple(sorted(bags, key=lambda bag: bag.name)), tuple(unused))


def is_recording(path: Path) -> bool:
    """Whether a file is taken for a recording: by its ending, in capitals or not."""
    return path.suffix.lower() == ENDING


def bag_of(file: Path) -> Bag:
    """The recording that a file belongs to.

    Raises:
        RecordingError: see `read_folder`; the metadata.yaml beside it is not what it should be.
    """
    if file.is_file() and (file.parent / INDEX).is_file():
        together = _indexed(file.parent)
        if together is not None and file in together.files:
            return together
    return Bag(file.stem, (file,))


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


def _unused(path: Path) -> Unused:
    if path.is_dir():
        inside = sum(1 for file in path.rglob("*") if file.suffix.lower() == ENDING)
        if not inside:
            reason: Reason = "unreadable" if path.suffix.lower() == ENDING else "not-a-recording"
            return Unused(path.name, reason, "It is a folder, without MCAP files in it.")
        return Unused(
            path.name,
            "not-read",
            f"It is a folder with {inside} MCAP file{'s' * (inside != 1)}, and folders in the folder of recordings are "
            "not looked into; move the files up, or give them a task of their own.",
        )
    error = unread(path)
    if error is not None:
        return Unused(path.name, "not-read", error.detail)
    return Unused(path.name, "not-a-recording", f"It does not end in {ENDING}, so it is not taken for a recording.")


def _indexed(folder: Path) -> Bag | None:
    """The bag that the metadata.yaml of a folder lists; None if it lists no MCAP file or only one.

    Raises:
        RecordingError: bad-metadata or incomplete-bag.
    """
    names = [PurePosixPath(name) for name in _listed(folder / INDEX)]
    files = [folder / name for name in names if name.suffix.lower() == ENDING]
    if len(files) < 2:
        return None
    for name, file in zip(names, files, strict=False):
        if len(name.parts) != 1 or not file.is_file():
            raise rejection(
                "incomplete-bag",
                f"{INDEX} lists the parts of one recording, and {name} is not in the folder; put it back, or remove "
                f"{INDEX} if the others are recordings of their own.",
            )
    found = _NUMBERED.fullmatch(files[0].stem)
    return Bag(found[1] if found else files[0].stem, tuple(files), listed=True)


def _listed(path: Path) -> list[str]:
    """The entry relative_file_paths of what rosbag2 wrote.

    Raises:
        RecordingError: bad-metadata.
    """
    try:
        with path.open("rb") as stream:
            text = stream.read(LARGEST_INDEX + 1)
        if len(text) > LARGEST_INDEX:
            raise rejection("bad-metadata", f"{INDEX} has more than {LARGEST_INDEX} bytes; remove it.")
        content: Any = plain_yaml(text.decode())
        found = content["rosbag2_bagfile_information"]["relative_file_paths"]
    except OSError as error:
        raise rejection("bad-metadata", f"{INDEX} cannot be read: {error.strerror or error}.") from error
    except (YamlError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        raise rejection(
            "bad-metadata", f"{INDEX} is not what rosbag2 writes, and lists no relative_file_paths; remove it."
        ) from error
    if not isinstance(found, list) or not all(isinstance(name, str) and name for name in found):
        raise rejection("bad-metadata", f"{INDEX} lists relative_file_paths that are no names of files; remove it.")
    return found
