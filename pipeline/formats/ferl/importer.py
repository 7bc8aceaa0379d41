"""Demonstrations as the FERL and jaco_learning repositories publish them (Python 2 pickles), turned into recordings."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError, RecordingError
from pipeline.formats.ferl.python2_pickle import Array, Trajectory, load
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.mcap.writer import write_joint_states

MAX_BYTES = 1 << 25
MAX_VALUES = MAX_BYTES // 8  # more a file of that size cannot spell, only repeat
MAX_DEMONSTRATIONS = 1000
MAX_TIME_S = 1e6
NAMES = "demo_{participant}_{condition}.p"
_START_NS = 1_000_000_000  # not 0, which in a ROS header means no time


@dataclass(frozen=True)
class _Poses:
    """One demonstration: positions (T, J) in rad, and its own times (T,) in s if it has any."""

    positions: FloatArray
    time_s: FloatArray | None = None


@dataclass(frozen=True)
class _About:
    """Who shows what in a pickle, as its name says, and where its recordings go; nothing if its name is not read."""

    folder: Path
    stem: str
    stated: Mapping[str, str]


def import_ferl(
    source: Path, folder: Path, joints: Sequence[str], topic: str, rate_hz: float, names: str = NAMES
) -> list[Path]:
    """Write each demonstration in a pickle, or in every pickle of a folder, as an MCAP recording of its own.

    A pickle holds one demonstration (poses of one arm as an array (T, J), a list of arrays (J,), or an object
    `utils.trajectory.Trajectory` with `waypts` and `waypts_time`) or a list of arrays (T, J), one per demonstration. It
    is read as data (see `python2_pickle`): nothing in it is executed. All of it is checked before anything is written.

    The names of the pickles in a folder say who shows what: each condition gets a folder of its own in `folder`, in
    which the recordings are called by their participants.

    Args:
        source: the pickle, or a folder of pickles `*.p`.
        folder: gets `<name of pickle>.mcap`, or `<name of pickle>_00.mcap` and so on for a list of demonstrations; of
            a folder of pickles `<condition>/<participant>.mcap` and so on. Recordings of these names are replaced.
        joints: what the J columns are called, in order.
        topic: of the recordings.
        rate_hz: nominal rate of poses that have no times.
        names: what pickles in a folder are called, with `{participant}` and `{condition}` where these stand.

    Returns:
        the recordings written.

    Raises:
        ArgumentError: `joints`, `topic`, `rate_hz`, `names` or `folder` is outside what is allowed, a folder has no
            pickles, or one in it is called otherwise.
        RecordingError: a pickle cannot be read, or holds something else.
    """
    if not joints or not all(joints) or len(set(joints)) < len(joints):
        raise ArgumentError(f"joints must be one or more different names, got {', '.join(joints) or 'none'}.")
    if not 0.1 <= rate_hz <= 1e6:
        raise ArgumentError(f"rate_hz must be between 0.1 and 1,000,000, got {rate_hz:g}.")
    if folder.exists() and not folder.is_dir():
        raise ArgumentError(f"{folder} is a file; give the folder that the recordings go into.")
    named = source.is_dir()
    files = _named(source, folder, names) if named else {source: _About(folder, source.stem, {})}
    contents = {file: _read(file, joints, named=named) for file in files}
    written = []
    for file, (demonstrations, several) in contents.items():
        about = files[file]
        digits = max(2, len(str(len(demonstrations) - 1)))
        for number, poses in enumerate(demonstrations):
            path = about.folder / (f"{about.stem}_{number:0{digits}}.mcap" if several else f"{about.stem}.mcap")
            place = {"place": f"{number + 1} of {len(demonstrations)}"} if several else {}
            time_ns, time_base = _times(poses, rate_hz)
            stated = {"demonstration": {**about.stated, "source": file.name, **place, "time_base": time_base}}
            write_joint_states(path, time_ns, joints, poses.positions, topic=topic, metadata=stated)
            written.append(path)
    return written


def _named(source: Path, folder: Path, names: str) -> dict[Path, _About]:
    """What the names of the pickles in a folder say, in the order of conditions and participants."""
    parts = re.split(r"(\{participant\}|\{condition\})", names)
    if sorted(parts[1::2]) != ["{condition}", "{participant}"] or (len(parts) == 5 and not parts[2]):
        raise ArgumentError(
            f"names is {names!r}; it needs {{participant}} and {{condition}}, once each and with something between, "
            f"such as {NAMES}."
        )
    word = "(?P<{}>[A-Za-z0-9][A-Za-z0-9-]*)"
    pattern = re.compile("".join(word.format(p[1:-1]) if i % 2 else re.escape(p) for i, p in enumerate(parts)))
    files = sorted(file for file in source.iterdir() if file.suffix == ".p")
    if not files:
        raise ArgumentError(f"{source} has no pickles; they end in .p.")
    found = dict[Path, dict[str, str]]()
    for file in files:
        match = pattern.fullmatch(file.name)
        if match is None:
            raise ArgumentError(
                f"{file.name} in {source} is not called {names}; say with --names what the pickles are called, or "
                "move it elsewhere."
            )
        found[file] = match.groupdict()
    digits = max((len(one["participant"]) for one in found.values() if one["participant"].isdigit()), default=0)
    about = dict[Path, _About]()
    for file, one in found.items():
        who = one["participant"]
        person = f"ID{int(who):0{max(digits, 2)}}" if who.isdigit() else who
        stated = {"participant": person, "task": one["condition"]}
        about[file] = _About(folder / one["condition"], person, stated)
    taken = dict[Path, Path]()
    for file, one_about in about.items():
        first = taken.setdefault(one_about.folder / one_about.stem, file)
        if first is not file:
            raise ArgumentError(f"{first.name} and {file.name} are of the same participant and condition; keep one.")
    return dict(sorted(about.items(), key=lambda item: (item[1].folder, item[1].stem)))


def _read(file: Path, joints: Sequence[str], *, named: bool) -> tuple[list[_Poses], bool]:
    """The demonstrations of a pickle, all checked, and whether it is a list of them."""
    try:
        content = load(_content(file))
        demonstrations = _demonstrations(content)
        for poses in demonstrations:
            _check(poses, joints)
    except RecordingError as error:
        if not named:
            raise
        raise RecordingError(error.reason, f"{file.name}: {error.detail}") from error
    # a list of one array is how the lab saved a single demonstration
    return demonstrations, isinstance(content, list) and _axes(content) == {2} and not (named and len(content) == 1)


def _content(file: Path) -> bytes:
    if file.exists() and not file.is_file():
        raise rejection("unreadable", f"{file} is not a regular file; give a pickle.")
    try:
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > MAX_BYTES:
                raise rejection("too-large", f"{file} has {size:,} bytes; {MAX_BYTES:,} is the most for a pickle.")
            return stream.read(size)
    except OSError as error:
        raise rejection("unreadable", f"{file} cannot be read: {error.strerror or error}.") from error


def _demonstrations(content: object) -> list[_Poses]:
    if isinstance(content, Trajectory):
        return [_trajectory(content)]
    if isinstance(content, Array):
        return [_Poses(_values(content))]
    if isinstance(content, list) and _axes(content) in ({1}, {2}):
        arrays = [_values(item) for item in content]
        if sum(array.size for array in arrays) > MAX_VALUES:
            raise rejection("too-large", f"The pickle repeats its arrays to more than {MAX_VALUES:,} numbers.")
        if arrays[0].ndim == 1:
            return [_Poses(_stacked(arrays))]
        if len(arrays) > MAX_DEMONSTRATIONS:
            raise rejection(
                "too-large", f"The pickle has {len(arrays):,} demonstrations; {MAX_DEMONSTRATIONS:,} is the most."
            )
        return [_Poses(array) for array in arrays]
    held = f"a list of {len(content)} items" if isinstance(content, list) else f"one {type(content).__name__}"
    raise rejection(
        "unsupported-encoding",
        f"The pickle holds {held}; needed are arrays of joint positions (poses by joints), a list of them, or a "
        "Trajectory.",
    )


def _trajectory(content: Trajectory) -> _Poses:
    positions, times = content.attributes.get("waypts"), content.attributes.get("waypts_time")
    if isinstance(times, Array):
        time_s = _values(times)
    elif isinstance(times, list) and all(type(time) in (float, int) for time in times):
        time_s = np.array(times, dtype=np.float64)
    else:
        raise rejection("corrupt", "The trajectory has no `waypts_time`, a list of times in seconds.")
    poses = _values(positions)
    if poses.ndim != 2 or time_s.shape != poses.shape[:1]:
        raise rejection("corrupt", f"The trajectory has poses of shape {poses.shape} and times of {time_s.shape}.")
    return _Poses(poses, time_s)


def _axes(items: list[object]) -> set[int]:
    """How many axes the arrays of a list have; 0 stands for what is no array."""
    return {item.values.ndim if isinstance(item, Array) and item.values is not None else 0 for item in items}


def _values(item: object) -> FloatArray:
    if not isinstance(item, Array) or item.values is None:
        raise rejection("corrupt", "The pickle lacks an array of joint positions, or its content.")
    return item.values


def _stacked(poses: list[FloatArray]) -> FloatArray:
    lengths = {len(pose) for pose in poses}
    if len(lengths) > 1:
        raise rejection("corrupt", f"The pickle has poses of {min(lengths)} and of {max(lengths)} joints in one list.")
    return np.stack(poses)


def _check(poses: _Poses, joints: Sequence[str]) -> None:
    if poses.positions.ndim != 2 or poses.positions.shape[1] != len(joints):
        raise rejection(
            "joints-missing",
            f"The pickle has poses of shape {poses.positions.shape} where {len(joints)} columns are named: "
            f"{', '.join(joints)}.",
        )
    if len(poses.positions) < 2:
        raise rejection("too-few-messages", "A demonstration has one pose; 2 or more are needed.")
    if not np.isfinite(poses.positions).all():
        row, column = np.argwhere(~np.isfinite(poses.positions))[0]
        raise rejection("not-finite", f"Pose {row + 1} has {joints[column]} at {poses.positions[row, column]}.")
    if poses.time_s is None:
        return
    if not (np.abs(poses.time_s) <= MAX_TIME_S).all():  # also NaN
        raise rejection("corrupt", f"The trajectory has times beyond {MAX_TIME_S:,.0f} s or that are no numbers.")
    if not (np.diff(poses.time_s) >= 1e-6).all():
        raise rejection("time-not-increasing", "The trajectory's times do not increase from each pose to the next.")


def _times(poses: _Poses, rate_hz: float) -> tuple[IntArray, str]:
    if poses.time_s is None:
        time_s = np.arange(len(poses.positions)) / rate_hz
        return _nanoseconds(time_s), f"nominal {rate_hz:g} Hz; the source has no time stamps"
    return _nanoseconds(poses.time_s - poses.time_s[0]), "as recorded, from the first pose; the source has no date"


def _nanoseconds(time_s: FloatArray) -> IntArray:
    return np.round(time_s * 1e9).astype(np.int64) + _START_NS
