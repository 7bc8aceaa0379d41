"""Demonstrations as the FERL and jaco_learning repositories publish them (Python 2 pickles), turned into recordings."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError
from pipeline.formats.ferl.python2_pickle import Array, Trajectory, load
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.mcap.writer import write_joint_states

MAX_BYTES = 1 << 25
MAX_VALUES = MAX_BYTES // 8  # more a file of that size cannot spell, only repeat
MAX_DEMONSTRATIONS = 1000
MAX_TIME_S = 1e6
_START_NS = 1_000_000_000  # not 0, which in a ROS header means no time


@dataclass(frozen=True)
class _Poses:
    """One demonstration: positions (T, J) in rad, and its own times (T,) in s if it has any."""

    positions: FloatArray
    time_s: FloatArray | None = None


def import_ferl(file: Path, folder: Path, joints: Sequence[str], topic: str, rate_hz: float) -> list[Path]:
    """Write each demonstration in the pickle `file` as an MCAP recording of its own into `folder`.

    A pickle holds one demonstration (poses of one arm as an array (T, J), a list of arrays (J,), or an object
    `utils.trajectory.Trajectory` with `waypts` and `waypts_time`) or a list of arrays (T, J), one per demonstration. It
    is read as data (see `py2_pickle`): nothing in it is executed. All of it is checked before anything is written.

    Args:
        file: the pickle.
        folder: gets `<name of file>.mcap`, or `<name of file>_00.mcap` and so on for a list of demonstrations;
            recordings of these names are replaced.
        joints: what the J columns are called, in order.
        topic: of the recordings.
        rate_hz: nominal rate of poses that have no times.

    Returns:
        the recordings written.

    Raises:
        ArgumentError: `joints`, `topic`, `rate_hz` or `folder` is outside what is allowed.
        RecordingError: the file cannot be read, or holds something else.
    """
    if not joints or not all(joints) or len(set(joints)) < len(joints):
        raise ArgumentError(f"joints must be one or more different names, got {', '.join(joints) or 'none'}.")
    if not 0.1 <= rate_hz <= 1e6:
        raise ArgumentError(f"rate_hz must be between 0.1 and 1,000,000, got {rate_hz:g}.")
    if folder.exists() and not folder.is_dir():
        raise ArgumentError(f"{folder} is a file; give the folder that the recordings go into.")
    content = load(_content(file))
    several = isinstance(content, list) and _axes(content) == {2}
    demonstrations = _demonstrations(content)
    for poses in demonstrations:
        _check(poses, joints)
    digits = max(2, len(str(len(demonstrations) - 1)))
    written = []
    for number, poses in enumerate(demonstrations):
        path = folder / (f"{file.stem}_{number:0{digits}}.mcap" if several else f"{file.stem}.mcap")
        place = {"place": f"{number + 1} of {len(demonstrations)}"} if several else {}
        time_ns, time_base = _times(poses, rate_hz)
        about = {"demonstration": {"source": file.name, **place, "time_base": time_base}}
        write_joint_states(path, time_ns, joints, poses.positions, topic=topic, metadata=about)
        written.append(path)
    return written


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
