"""HDF5 files of robomimic and robosuite: `data/demo_*/obs/robot0_joint_pos`, read by h5py in a process of its own."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import RecordingError, few_of
from pipeline.formats.mcap.channels import Contents
from pipeline.formats.mcap.limits import Limits
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.mcap.writer import METADATA
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.extras import needed
from pipeline.formats.recordings.opening import require_regular

PATIENCE_S = 120
_PROCESS = "pipeline.formats.recordings.hdf5_process"
_SUFFIX = "_joint_pos"


@dataclass(frozen=True)
class _Demonstration:
    """Arrays of joint positions, (M, J) by name, with steps per second; or why there are none."""

    arrays: Mapping[str, FloatArray]
    rate_hz: float
    about: Mapping[str, str]
    refused: RecordingError | None = None


def groups(path: Path, columns: ColumnMap | None = None) -> list[str]:
    """The names of the demonstrations in a file, `demo_2` before `demo_10`.

    Raises:
        RecordingError: not-read, unreadable, corrupt or too-large.
    """
    return list(_read(path, columns or ColumnMap(), Limits()))


def fill_from_hdf5(
    contents: Contents, path: Path, entry: str, columns: ColumnMap | None, wanted: Sequence[str] | None, limits: Limits
) -> None:
    """Read the positions of one demonstration.

    robomimic stores no names of joints: those of `robot0_joint_pos` are called `robot0_joint1` and so on, as robosuite
    does, unless the task's `reading` names them. Times are the steps at the `control_freq` of `env_args`, or at
    `reading.rate_hz`.

    Args:
        contents: to fill.
        path: of the file.
        entry: the group in `data`.
        columns: what the task says.
        wanted: joints that are needed, or None.
        limits: what reading may cost.

    Raises:
        RecordingError: not-read, joints-missing, corrupt, too-large or bad-metadata.
    """
    said = columns or ColumnMap()
    demo = _read(path, said, limits)[entry]
    if demo.refused is not None:
        raise demo.refused
    states: dict[str, FloatArray] = {}
    for name, values in demo.arrays.items():
        prefix = name.removesuffix(_SUFFIX)
        states |= {f"{prefix}_joint{place + 1}": values[:, place] for place in range(values.shape[1])}
    if said.joints:
        if len(said.joints) != len(states):
            raise rejection(
                "not-read",
                f"{path.name} has {len(states)} joints, and reading.joints of the task names {len(said.joints)}.",
            )
        states = dict(zip(said.joints, states.values(), strict=True))
    if missing := [name for name in wanted or () if name not in states]:
        raise rejection(
            "joints-missing",
            f"{path.name} stores joints without names, called {few_of(list(states), 20)} here, and no "
            f"{few_of(missing)}. List the joints in order in the task's reading.joints.",
        )
    lengths = {len(values) for values in states.values()}
    if len(lengths) != 1 or not min(lengths):
        raise rejection("corrupt", f"{entry} in {path.name} has no steps, or robots of different numbers of steps.")
    if demo.about:
        contents.metadata[METADATA] = dict(demo.about)
    time_ns: IntArray = np.rint(np.arange(min(lengths)) * (1e9 / demo.rate_hz)).astype(np.int64)
    contents.library = "HDF5"
    contents.add_poses(entry, "HDF5", time_ns, {name: values * said.scale(name) for name, values in states.items()})


def _read(path: Path, said: ColumnMap, limits: Limits) -> dict[str, _Demonstration]:
    needed("h5py", f"{path.name} is in HDF5, which is read")
    about = require_regular(path, limits)
    return _read_whole(path, (about.st_size, about.st_mtime_ns, about.st_ino), said.array, said.rate_hz, limits)


@lru_cache(maxsize=1)
def _read_whole(
    path: Path, _: tuple[int, ...], array: str | None, rate_hz: float | None, limits: Limits
) -> dict[str, _Demonstration]:
    """All demonstrations of the last file, since a process takes longer to begin than to read one."""
    root = str(Path(__file__).parents[3])
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}
    asked = {"path": str(path.absolute()), "array": array, "rate_hz": rate_hz, "limits": asdict(limits)}
    try:
        done = subprocess.run(  # noqa: S603, this program itself
            [sys.executable, "-P", "-m", _PROCESS], input=json.dumps(asked).encode(), env=environment,
            capture_output=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise rejection("too-large", f"{path.name} takes more than {PATIENCE_S} s to read; it is damaged.") from error
    return _answered(path, io.BytesIO(done.stdout))


def _answered(path: Path, stream: io.BytesIO) -> dict[str, _Demonstration]:
    found: dict[str, _Demonstration] = {}
    while line := stream.readline():
        told = json.loads(line)
        refused = None if told["reason"] is None else RecordingError(told["reason"], told["detail"])
        if told["entry"] is None:
            if refused is not None:
                raise refused
            return found
        arrays = {}
        for name, rows, width in told.get("arrays", ()):
            values = np.frombuffer(stream.read(8 * rows * width), "<f8").astype(np.float64)
            arrays[name] = values.reshape(rows, width)
        found[told["entry"]] = _Demonstration(arrays, told.get("rate_hz", 1.0), told.get("about", {}), refused)
    raise rejection("corrupt", f"{path.name} cannot be read as HDF5; it is damaged so that the library gives up.")
