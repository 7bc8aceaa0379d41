"""Datasets of LeRobot on disk, versions 2.1 and 3.0: an episode is a demonstration.

Read are `meta/info.json` (version, rate, names of `observation.state`) and the Parquet files under `data/chunk-*`: of
version 2.1 one for each episode, of version 3.0 files with many. Where the files are is known from the version; the
pattern that info.json states is not used, as it may lead anywhere. Videos are not looked at.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import IntArray
from pipeline.errors import few_of
from pipeline.formats.mcap.channels import Contents
from pipeline.formats.mcap.joint_state_cdr import MAX_JOINTS
from pipeline.formats.mcap.limits import Limits, Meter
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.parquet.foreign_tables import ForeignTable, foreign_tables, read_columns
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.forms import INFO
from pipeline.formats.recordings.opening import require_regular

STATE = "observation.state"
EPISODE, TIME, FRAME = "episode_index", "timestamp", "frame_index"
LARGEST_INFO = 1 << 20  # bytes
MOST_FILES, MOST_EPISODES = 10_000, 100_000
REMEDY = "keep fewer episodes in a dataset"
_SINGLE = re.compile(r"episode_(\d{1,9})\.parquet")
_VERSION = re.compile(r"v(\d+)\.(\d+)")


@dataclass(frozen=True)
class Episode:
    """An episode and the file that has it."""

    number: int
    file: Path


@dataclass(frozen=True)
class Info:
    """What a dataset says of itself.

    Attributes:
        version: of its layout, 2 or 3.
        fps: frames per second.
        episodes: how many it has, or None.
        names: of the numbers of `observation.state`.
        said: remarks.
    """

    version: int
    fps: float
    episodes: int | None
    names: tuple[str, ...]


def info_of(folder: Path) -> Info:
    """Read meta/info.json.

    Raises:
        RecordingError: bad-metadata or not-read.
    """
    path = folder / INFO
    about = require_regular(path, Limits())
    return _info_of(path, about.st_size, about.st_mtime_ns)


@lru_cache(maxsize=16)
def _info_of(path: Path, size: int, _: int) -> Info:
    if size > LARGEST_INFO:
        raise rejection("bad-metadata", f"{INFO} has more than {LARGEST_INFO} bytes.")
    try:
        content: Any = json.loads(path.read_bytes())
        version = _VERSION.match(content["codebase_version"])
        fps = float(content["fps"])
        state = content["features"][STATE]
        width = int(state["shape"][0]) if len(state["shape"]) == 1 else 0
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
        raise rejection(
            "bad-metadata",
            f"{INFO} is not what LeRobot writes: it lacks codebase_version, fps or {STATE} with a shape.",
        ) from error
    if version is None or (int(version[1]), int(version[2])) not in ((2, 0), (2, 1), (3, 0)):
        raise rejection(
            "not-read",
            f"{INFO} states the version {str(content['codebase_version'])[:40]!r}; read are v2.1 and v3.0, convert the "
            "dataset with LeRobot's own scripts.",
        )
    if not 0 < fps < 1e6 or not 0 < width <= MAX_JOINTS:
        raise rejection("bad-metadata", f"{INFO} states fps {fps:g} and {width} numbers in {STATE}.")
    total = content.get("total_episodes")
    names = _names(state.get("names"), width)
    return Info(int(version[1]), fps, total if type(total) is int else None, names)


def _names(stated: Any, width: int) -> tuple[str, ...]:
    """The names of a state's numbers: a list, or lists by kind such as `motors`; numbered if there are none."""
    lists = list(stated.values()) if isinstance(stated, dict) else [stated]
    if len(lists) == 1 and isinstance(lists[0], dict):
        lists = [list(lists[0])]
    flat = [name for one in lists if isinstance(one, list) for name in one]
    if len(flat) != width or len(set(map(str, flat))) != width:
        return tuple(f"state_{place}" for place in range(width))
    return tuple(str(name) for name in flat)


def episodes(folder: Path) -> list[Episode]:
    """The episodes of a dataset in their order.

    Raises:
        RecordingError: bad-metadata, not-read, corrupt, too-large, or incomplete-bag where fewer are there than stated.
    """
    info = info_of(folder)
    files = sorted((folder / "data").glob("chunk-*/*.parquet"))
    if len(files) > MOST_FILES:
        raise rejection("too-large", f"{folder.name} has more than {MOST_FILES} files; {REMEDY}.")
    for file in files:
        require_regular(file, Limits())
    stated = foreign_tables(files)
    found: dict[int, Path] = {}
    for file, table in zip(files, stated, strict=True):
        single = _SINGLE.fullmatch(file.name)
        numbers = [int(single[1])] if info.version == 2 and single else _numbers(file, table)
        for number in numbers:
            if number in found:
                raise rejection("corrupt", f"{file.name} and {found[number].name} both have episode {number}.")
            found[number] = file
    if len(found) > MOST_EPISODES:
        raise rejection("too-large", f"{folder.name} has more than {MOST_EPISODES} episodes; {REMEDY}.")
    if info.episodes is not None and len(found) < info.episodes:
        raise rejection(
            "incomplete-bag",
            f"{INFO} states {info.episodes} episodes, and the files in data have {len(found)}; download the others.",
        )
    return [Episode(number, found[number]) for number in sorted(found)]


def _numbers(file: Path, table: ForeignTable | None) -> list[int]:
    numbers: IntArray = _column(file, table, EPISODE)
    return [int(number) for number in np.unique(numbers)]


def _column(file: Path, table: ForeignTable | None, name: str) -> Any:
    _require(file, table, (name,))
    return _read(file, file.stat().st_mtime_ns, (name,))[name]


def _require(file: Path, table: ForeignTable | None, names: Sequence[str]) -> None:
    if table is None:
        raise rejection("corrupt", f"{file.name} cannot be read as Parquet; its end is damaged.")
    limits = Limits()
    meter = Meter(limits, REMEDY)
    for name in names:
        if name not in table.columns:
            raise rejection("corrupt", f"{file.name} has no column {name!r}; it has {few_of(list(table.columns), 20)}.")
        meter.hold(table.columns[name].values)
        meter.inflate(table.columns[name].size)


@lru_cache(maxsize=1)
def _read(file: Path, _: int, names: tuple[str, ...]) -> dict[str, Any]:
    """Columns of the last file, which has many episodes one after another."""
    return read_columns(file, names)


def fill_from_lerobot(
    contents: Contents, file: Path, number: int, columns: ColumnMap | None, wanted: Sequence[str] | None
) -> None:
    """Read the positions of one episode.

    Times are its `timestamp`, or its frames at the dataset's rate; positions are taken to be rad or m, unless the
    task's columns name another unit, as a dataset does not say.

    Args:
        contents: to fill.
        file: that has the episode.
        number: of the episode.
        columns: what the task says of units, names and times.
        wanted: joints that are needed, or None.

    Raises:
        RecordingError: joints-missing, corrupt, too-large, bad-metadata or not-finite.
    """
    said, info = columns or ColumnMap(), info_of(file.parents[2])
    names = said.joints or info.names
    if len(names) != len(info.names):
        raise rejection(
            "not-read",
            f"The dataset has {len(info.names)} numbers in {STATE}, and reading.joints of the task names {len(names)}.",
        )
    if missing := [name for name in wanted or () if name not in names]:
        raise rejection(
            "joints-missing",
            f"The dataset names in {STATE} no {few_of(missing)}; it has {few_of(list(names), 20)}. Say in the task's "
            "joint_names which is which (name in the dataset: joint).",
        )
    (table,) = foreign_tables([file])
    time = said.time or (TIME if table and TIME in table.columns else FRAME)
    wished = (EPISODE, time, STATE)
    _require(file, table, wished)
    values = _read(file, file.stat().st_mtime_ns, wished)
    rows = values[EPISODE] == number
    states, times = values[STATE][rows], values[time][rows].astype(np.float64)
    if states.ndim != 2 or states.shape[1] != len(names):
        raise rejection(
            "corrupt", f"{file.name} has rows of {STATE} that are not {len(names)} numbers, as {INFO} says."
        )
    if not np.isfinite(times).all() or (np.abs(times) > 1e9).any():
        raise rejection("not-finite", f"Episode {number} has a frame without a time in {time!r}.")
    seconds = times / info.fps if time == FRAME else times
    if not len(states):
        raise rejection("too-few-messages", f"Episode {number} has no frame; 2 or more are needed.")
    contents.library = f"LeRobot, version {info.version}"
    scaled = {name: states[:, place] * said.scale(name) for place, name in enumerate(names)}
    contents.add_poses(STATE, "LeRobot", np.rint(seconds * 1e9).astype(np.int64), scaled)
