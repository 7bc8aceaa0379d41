"""HDF5 files of robomimic and robosuite: `data/demo_*/obs/robot0_joint_pos`, with h5py.

The library follows links into other files and loads filters from elsewhere if a file asks for it; here, only what lies
in the file itself is read, and only filters that h5py has built in.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import RecordingError, few_of
from pipeline.formats.mcap.channels import Contents
from pipeline.formats.mcap.joint_state_cdr import MAX_JOINTS
from pipeline.formats.mcap.limits import Limits, Meter
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.mcap.writer import METADATA
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.extras import needed
from pipeline.formats.recordings.opening import require_regular

DATA, OBSERVED = "data", "obs"
POSITIONS = re.compile(r"robot(\d)_joint_pos")
RATE = "control_freq"
LARGEST_TEXT = 1 << 20  # bytes
MOST_GROUPS = 100_000
DEFLATE, LZF = 1, 32000
FILTERS = {DEFLATE: "gzip", 2: "shuffle", 3: "fletcher32", LZF: "lzf"}
REMEDY = "split it into files of fewer demonstrations"
_NUMBERS = re.compile(r"(\d+)")


def groups(path: Path) -> list[str]:
    """The names of the demonstrations in a file, `demo_2` before `demo_10`.

    Raises:
        RecordingError: not-read, unreadable, corrupt or too-large.
    """
    with _opened(path) as file:
        data = _group(path, file, DATA)
        if len(data) > MOST_GROUPS:
            raise rejection("too-large", f"{path.name} has more than {MOST_GROUPS} groups; {REMEDY}.")
        return sorted(
            data, key=lambda name: [int(part) if part.isdigit() else part for part in _NUMBERS.split(name)[1::2]] or [0]
        )


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
    with _opened(path) as file:
        data = _group(path, file, DATA)
        demo = _group(path, data, entry)
        rate_hz = said.rate_hz or _rate(path, data)
        states: dict[str, FloatArray] = {}
        meter = Meter(limits, REMEDY)
        for name, dataset in _positions(path, demo, said):
            values = _values(path, entry, name, dataset, meter)
            prefix = name.removesuffix("_joint_pos")
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
        if len(lengths) > 1 or not min(lengths):
            raise rejection("corrupt", f"{entry} in {path.name} has no steps, or robots of different numbers of steps.")
        for key in ("participant", "task"):
            text = _text_attribute(path, demo, key)
            if text is not None:
                contents.metadata.setdefault(METADATA, {})[key] = text
    time_ns = np.rint(np.arange(min(lengths)) * (1e9 / rate_hz)).astype(np.int64)
    contents.library = "HDF5"
    contents.add_poses(
        entry, "robomimic", time_ns, {name: values * said.scale(name) for name, values in states.items()}
    )


def joint_names(path: Path, columns: ColumnMap | None) -> list[str]:
    """The joints of the first demonstration in a file, as `fill_from_hdf5` calls them."""
    contents = Contents()
    fill_from_hdf5(contents, path, groups(path)[0], columns, None, Limits())
    return [name for channel in contents.channels.values() for block in channel.blocks for name in block.states.names]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    h5py = needed("h5py", f"{path.name} is in HDF5, which is read")
    require_regular(path, Limits())
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except RecordingError:
        raise
    except Exception as error:  # of a damaged file the library raises errors of many kinds
        said = " ".join(str(error).split())[:200]
        raise rejection("corrupt", f"{path.name} cannot be read as HDF5 ({said}).") from error


def _member(path: Path, group: Any, name: str) -> Any:
    """What a group itself has under a name, or None.

    Raises:
        RecordingError: corrupt; it is a link to elsewhere.
    """
    if "/" in name or name in (".", ".."):
        raise rejection("corrupt", f"{path.name} has a member called {name[:60]!r}.")
    link = group.get(name, getlink=True)
    if link is None:
        return None
    if type(link).__name__ != "HardLink":
        raise rejection(
            "corrupt", f"{path.name} has a link {name!r} to another place or file, which is not followed; copy it in."
        )
    return group.get(name)


def _group(path: Path, group: Any, name: str) -> Any:
    found = _member(path, group, name)
    if found is None or not hasattr(found, "keys"):
        where = name if group.name == "/" else f"{group.name.strip('/')}/{name}"
        raise rejection("not-read", f"{path.name} has no group {where!r}; read are files of robomimic, {DATA}/demo_*.")
    return found


def _positions(path: Path, demo: Any, said: ColumnMap) -> list[tuple[str, Any]]:
    """The arrays of joint positions of a demonstration, robot after robot."""
    if _member(path, demo, OBSERVED) is None and said.array is None:
        raise rejection(
            "not-read",
            f"{path.name} has no observations ({OBSERVED}) in {demo.name.strip('/')}, only the simulator's states; "
            f"make "
            "them with robomimic's dataset_states_to_obs.py.",
        )
    where = demo if said.array and _member(path, demo, said.array) is not None else _group(path, demo, OBSERVED)
    names = [said.array] if said.array else sorted(name for name in where if POSITIONS.fullmatch(name))
    found = [(name, _member(path, where, name)) for name in names]
    if not found or any(not hasattr(dataset, "shape") for _, dataset in found):
        raise rejection(
            "joints-missing",
            f"{where.name.strip('/')} in {path.name} has no {said.array or 'robot0_joint_pos'}; it has "
            f"{few_of(list(where), 20)}. Name the array of joint positions in the task's reading.array.",
        )
    return found


def _values(path: Path, entry: str, name: str, dataset: Any, meter: Meter) -> FloatArray:
    """The positions (M, J), once shape, type, filters and place are such that reading is bounded."""
    where = f"{entry}, {name}, in {path.name}"
    if dataset.ndim != 2 or dataset.dtype.kind not in "fiu" or dataset.dtype.itemsize > 8:
        raise rejection("corrupt", f"{where} is no table of numbers.")
    rows, width = (int(size) for size in dataset.shape)
    if rows > meter.limits.joint_states or width > MAX_JOINTS:
        raise rejection("too-large", f"{where} has {rows} rows of {width} numbers; {REMEDY}.")
    meter.hold(rows * width)
    if dataset.external or dataset.is_virtual:
        raise rejection("corrupt", f"{where} is stored in another file, which is not opened; copy it in.")
    if dataset.chunks and np.prod(dataset.chunks, dtype=float) * dataset.dtype.itemsize > meter.limits.chunk_bytes:
        raise rejection("too-large", f"{where} is stored in chunks of more than {meter.limits.chunk_bytes} bytes.")
    plist = dataset.id.get_create_plist()
    filters = [plist.get_filter(place)[0] for place in range(plist.get_nfilters())]
    if len(set(filters) & {DEFLATE, LZF}) > 1 or len(set(filters)) < len(filters):
        raise rejection("unsupported-compression", f"{where} is compressed more than once.")
    if unknown := [number for number in filters if number not in FILTERS]:
        raise rejection(
            "unsupported-compression",
            f"{where} is compressed by the filter {unknown[0]}; read are {', '.join(FILTERS.values())}.",
        )
    if DEFLATE in filters:
        _check_deflated(where, dataset, filters.index(DEFLATE))
    values: FloatArray = dataset[()].astype(np.float64)
    return values


def _check_deflated(where: str, dataset: Any, place: int) -> None:
    """Refuse chunks that inflate to more than a chunk, which the library would inflate to whatever size."""
    most = int(np.prod(dataset.chunks)) * dataset.dtype.itemsize + 4  # and a checksum
    for number in range(dataset.id.get_num_chunks()):
        about = dataset.id.get_chunk_info(number)
        if about.filter_mask & (1 << place):
            continue
        if about.size > 2 * most + 1024:
            raise rejection("corrupt", f"{where} has a chunk of {about.size} bytes for {most}.")
        _, data = dataset.id.read_direct_chunk(about.chunk_offset)
        if len(zlib.decompressobj().decompress(data, most + 1)) > most:
            raise rejection("too-large", f"{where} has a chunk that inflates to more than its {most} bytes.")


def _rate(path: Path, data: Any) -> float:
    """Steps per second, from `env_args`.

    Raises:
        RecordingError: not-read or bad-metadata.
    """
    text = _text_attribute(path, data, "env_args")
    try:
        arguments = json.loads(text) if text is not None else {}
        rate = (arguments.get("env_kwargs") or {}).get(RATE, arguments.get(RATE))
    except (ValueError, RecursionError, AttributeError) as error:
        raise rejection("bad-metadata", f"{path.name} has env_args that are not what robomimic writes.") from error
    if not isinstance(rate, int | float) or isinstance(rate, bool) or not 0 < rate < 1e6:
        raise rejection(
            "not-read",
            f"{path.name} does not say in env_args how many steps a second has ({RATE}); give it in the task's "
            "reading.rate_hz.",
        )
    return float(rate)


def _text_attribute(path: Path, holder: Any, name: str) -> str | None:
    """A text that a group has, or None."""
    if name not in holder.attrs:
        return None
    about = holder.attrs.get_id(name)
    if about.get_storage_size() > LARGEST_TEXT or about.shape not in ((), (1,)):
        raise rejection("bad-metadata", f"{path.name} has an attribute {name!r} that is no short text.")
    value = holder.attrs[name]
    value = value[0] if about.shape == (1,) else value
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    if not isinstance(text, str) or len(text) > LARGEST_TEXT:
        raise rejection("bad-metadata", f"{path.name} has an attribute {name!r} that is no short text.")
    return str(text)
