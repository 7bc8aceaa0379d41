"""What runs in a process of its own to read an HDF5 file: the library ends its process on some damaged files.

The library follows links into other files and loads filters from elsewhere if a file asks for it; here, only what lies
in the file itself is read, and only filters that h5py has built in. Memory and time are bounded by the system besides.

It is asked on the standard input, in JSON, and answers with a line of JSON for each demonstration, behind which come
the numbers of its arrays as float64, row by row.
"""

from __future__ import annotations

import json
import re
import resource
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import RecordingError, few_of
from pipeline.formats.mcap.joint_state_cdr import MAX_JOINTS
from pipeline.formats.mcap.limits import Limits, Meter
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.recordings.extras import needed

DATA, OBSERVED = "data", "obs"
POSITIONS = re.compile(r"robot(\d)_joint_pos")
RATE = "control_freq"
KEYS = ("participant", "task")  # attributes of a demonstration
LARGEST_TEXT = 1 << 20  # bytes
MOST_GROUPS = 100_000
DEFLATE, LZF = 1, 32000
FILTERS = {DEFLATE: "gzip", 2: "shuffle", 3: "fletcher32", LZF: "lzf"}
REMEDY = "split it into files of fewer demonstrations"
ADDRESS_SPACE_BYTES = 4 << 30
PROCESSOR_S = 60
_NUMBERS = re.compile(r"(\d+)")


def main() -> None:
    """Answer what the standard input asks for."""
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    asked = json.load(sys.stdin)
    try:
        for answer, arrays in _answers(
            Path(asked["path"]), asked["array"], asked["rate_hz"], Limits(**asked["limits"])
        ):
            _say(answer, arrays)
    except RecordingError as error:
        _say({"entry": None, "reason": error.reason, "detail": error.detail}, [])
        return
    _say({"entry": None, "reason": None}, [])


def _say(answer: dict[str, Any], arrays: list[FloatArray]) -> None:
    sys.stdout.buffer.write(json.dumps(answer).encode() + b"\n")
    for values in arrays:
        sys.stdout.buffer.write(np.ascontiguousarray(values, "<f8").tobytes())


def _answers(
    path: Path, array: str | None, rate_hz: float | None, limits: Limits
) -> Iterator[tuple[dict[str, Any], list[FloatArray]]]:
    """What is in each demonstration of a file, or why it cannot be read."""
    with _opened(path) as file:
        data = _group(path, file, DATA)
        if len(data) > MOST_GROUPS:
            raise rejection("too-large", f"{path.name} has more than {MOST_GROUPS} groups; {REMEDY}.")
        meter = Meter(limits, REMEDY)
        for entry in sorted(data, key=_number):
            try:
                demo = _group(path, data, entry)
                found = [
                    (name, _values(path, entry, name, dataset, meter))
                    for name, dataset in _positions(path, demo, array)
                ]
                about = {key: text for key in KEYS if (text := _text_attribute(path, demo, key)) is not None}
                told = {
                    "entry": entry, "reason": None, "rate_hz": rate_hz or _rate(path, data), "about": about,
                    "arrays": [[name, *values.shape] for name, values in found],
                }  # fmt: skip
            except RecordingError as error:
                yield {"entry": entry, "reason": error.reason, "detail": error.detail}, []
            else:
                yield told, [values for _, values in found]


def _number(name: str) -> tuple[list[int], str]:
    """A key that puts `demo_2` before `demo_10`."""
    return [int(part) for part in _NUMBERS.findall(name)[:4]], name


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    h5py = needed("h5py", f"{path.name} is in HDF5, which is read")
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


def _positions(path: Path, demo: Any, array: str | None) -> list[tuple[str, Any]]:
    """The arrays of joint positions of a demonstration, robot after robot."""
    if _member(path, demo, OBSERVED) is None and array is None:
        raise rejection(
            "not-read",
            f"{path.name} has no observations ({OBSERVED}) in {demo.name.strip('/')}, only the simulator's states; "
            f"make "
            "them with robomimic's dataset_states_to_obs.py.",
        )
    where = demo if array and _member(path, demo, array) is not None else _group(path, demo, OBSERVED)
    names = [array] if array else sorted(name for name in where if POSITIONS.fullmatch(name))
    found = [(name, _member(path, where, name)) for name in names]
    if not found or any(not hasattr(dataset, "shape") for _, dataset in found):
        raise rejection(
            "joints-missing",
            f"{where.name.strip('/')} in {path.name} has no {array or 'robot0_joint_pos'}; it has "
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


if __name__ == "__main__":
    main()
