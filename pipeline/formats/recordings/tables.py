"""Tables: CSV, Parquet and npz, of one demonstration, or of several with a column of ids.

Which columns mean what, a task says in `reading`; what it does not say is taken from their names: a column called
`time`, `timestamp`, `t` and the like says when, and all other columns of numbers may be joints.
"""

from __future__ import annotations

import csv
import io
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.arrays import IntArray
from pipeline.errors import RecordingError, few_of
from pipeline.formats.mcap.channels import Contents
from pipeline.formats.mcap.limits import Limits, Meter
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.mcap.writer import METADATA
from pipeline.formats.parquet.foreign_tables import foreign_tables, read_columns
from pipeline.formats.recordings.columns import TIME_UNITS, ColumnMap
from pipeline.formats.recordings.opening import require_regular

TIMES = (
    "time", "timestamp", "t", "stamp", "times", "timestamps", "sec", "secs", "seconds", "elapsed", "%time", "__time",
)  # fmt: skip
"""What a column that says when is called, without its unit."""
JOINTS = ("joint_names", "joints", "names", "name")
"""What an array of an npz file is called that names the columns of another."""
SEPARATORS = ",;\t"
LARGEST_CSV = 256 << 20  # bytes
MOST_COLUMNS = 4096
MOST_IDS = 100_000
LONGEST_TEXT = 200  # characters of an id or a name
REMEDY = "split it into fewer recordings"
_HEAD_BYTES = 1 << 20
_NO_COLUMNS = ColumnMap()
_DAMAGED = (
    ValueError, OSError, EOFError, LookupError, OverflowError, NotImplementedError, RuntimeError, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip
_EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # since 1970, whatever the unit: numbers this large are that


@dataclass(frozen=True)
class Column:
    """A column before its values are read: its kind (`number`, `text`, `time`, `array` or `other`), its width, and of a
    time its unit in ns."""

    kind: str
    width: int = 1
    ns: int = 1


@dataclass(frozen=True)
class Meaning:
    """What the columns of one file mean.

    Attributes:
        time: the column that says when, or None.
        joints: columns of positions; empty if they are in an array.
        array: the array of positions.
        remarks: what was taken from names.
    """

    time: str | None
    joints: tuple[str, ...]
    array: str | None


def recordings_in_table(path: Path, columns: ColumnMap | None) -> list[str]:
    """The ids of the recordings in a file; one empty text if it is one recording.

    Raises:
        RecordingError: the file cannot be read, or its columns do not say when and what.
    """
    said = columns or _NO_COLUMNS
    meaning_of(path, said)
    if said.id is None:
        return [""]
    ids = _ids(path, said.id)
    found = list(dict.fromkeys(ids.tolist()))
    if len(found) > MOST_IDS:
        raise rejection("too-large", f"{path.name} has more than {MOST_IDS} ids in its column {said.id!r}; {REMEDY}.")
    return found


def fill_from_table(
    contents: Contents, path: Path, entry: str, columns: ColumnMap | None, wanted: Sequence[str] | None, limits: Limits
) -> None:
    """Read the positions of one recording.

    Args:
        contents: to fill.
        path: of the file.
        entry: the id of the recording, empty if the file is one.
        columns: what the columns mean.
        wanted: joints that are needed; None: all columns that may be joints.
        limits: what reading may cost.

    Raises:
        RecordingError: joints-missing, corrupt, too-large, not-finite, out-of-range or not-read.
    """
    said = columns or _NO_COLUMNS
    meaning = meaning_of(path, said)
    names = list(meaning.joints) if meaning.array is None else _array_names(path, meaning.array, said)
    if missing := [name for name in wanted or () if name not in names]:
        raise rejection(
            "joints-missing",
            f"{path.name} has no column {few_of([repr(name) for name in missing])}; its columns of numbers are "
            f"{few_of(names, 20) or 'none'}. Say in the task's joint_names which column is which joint "
            "(column: joint).",
        )
    joints = [name for name in names if wanted is None or name in wanted]
    rest = [name for name in (meaning.time, said.id, said.participant) if name is not None]
    values = _loaded(path, (*(joints if meaning.array is None else [meaning.array]), *rest), limits)
    if meaning.array is not None:
        values = values | {name: values[meaning.array][:, place] for place, name in enumerate(names)}
    rows = np.flatnonzero(_texts(values[said.id]) == entry) if said.id is not None and entry else slice(None)
    states = {name: values[name][rows].astype(np.float64) * said.scale(name) for name in joints}
    count = len(next(iter(states.values()))) if states else 0
    if not count:
        raise rejection("too-few-messages", f"{path.name} has no row; 2 or more are needed.")
    time_ns = _times(path, meaning.time, None if meaning.time is None else values[meaning.time][rows], said, count)
    if said.participant is not None:
        people = list(dict.fromkeys(_texts(values[said.participant][rows]).tolist()))
        if len(people) > 1:
            raise rejection(
                "bad-metadata",
                f"{path.name} names {few_of([repr(one) for one in people])} in its column {said.participant!r} for one "
                "recording; name the column that tells recordings apart in the task's reading.id.",
            )
        contents.metadata[METADATA] = {"participant": people[0]}
    contents.library = path.suffix.lower().removeprefix(".")
    contents.add_poses(path.name, contents.library, time_ns, states)


def meaning_of(path: Path, said: ColumnMap) -> Meaning:
    """Which columns say when and which may be joints.

    Raises:
        RecordingError: not-read, if there is none that says when, or a column that the task names is not there.
    """
    there = _header(path)
    for parameter in ("time", "id", "participant", "array"):
        name = getattr(said, parameter)
        if name is not None and name not in there:
            raise rejection(
                "not-read",
                f"{path.name} has no column {name!r}, which reading.{parameter} of the task names; it has "
                f"{few_of(list(there), 20)}.",
            )
    time = said.time
    if time is None and said.rate_hz is None:
        time = next((name for name in there if _is_time(name)), None)
        if time is None:
            raise rejection(
                "not-read",
                f"{path.name} has the columns {few_of(list(there), 20)}, and none is called as a time is; if it is a "
                "recording, name the one that says when in the task's reading.time, or give its rate in "
                "reading.rate_hz; else move it out of the folder.",
            )
    others = {name: column for name, column in there.items() if name not in (time, said.id, said.participant)}
    arrays = [name for name, column in others.items() if column.kind == "array"]
    array = said.array or (arrays[0] if len(arrays) == 1 else None)
    numbers = [name for name, column in others.items() if column.kind == "number"]
    if said.array is None and (numbers and (not said.joints or set(said.joints) <= set(numbers))):
        array = None
    if array is not None:
        return Meaning(time, (), array)
    if missing := [name for name in said.joints if name not in numbers]:
        raise rejection(
            "not-read",
            f"{path.name} has no column of numbers {missing[0]!r}, which reading.joints of the task names; it has "
            f"{few_of(numbers, 20) or 'none'}.",
        )
    return Meaning(time, said.joints or tuple(numbers), None)


def _array_names(path: Path, array: str, said: ColumnMap) -> list[str]:
    """What the columns of an array of positions are called: as the task says, as the file says, or by number."""
    width = _header(path)[array].width
    names = list(said.joints) or _named_inside(path, width) or [f"{array}_{place}" for place in range(width)]
    if len(names) != width:
        raise rejection(
            "not-read",
            f"{path.name} has {width} numbers in each row of {array!r}, and reading.joints of the task names "
            f"{len(names)}.",
        )
    return names


def _is_time(name: str) -> bool:
    plain = name.strip().lower()
    stem, _, unit = plain.rpartition("_")
    return plain in TIMES or (unit in TIME_UNITS and stem in TIMES)


def _times(path: Path, name: str | None, values: NDArray[Any] | None, said: ColumnMap, count: int) -> IntArray:
    """When the rows are, (M,) ns.

    Raises:
        RecordingError: not-finite or out-of-range.
    """
    if name is None or values is None:
        assert said.rate_hz is not None
        steps: IntArray = np.rint(np.arange(count) * (1e9 / said.rate_hz)).astype(np.int64)
        return steps
    column = _header(path)[name]
    if not np.isfinite(values.astype(np.float64)).all():
        row = int((~np.isfinite(values.astype(np.float64))).argmax())
        raise rejection("not-finite", f"Row {row + 1} of {path.name} has no time in its column {name!r}.")
    scale = column.ns if column.kind == "time" else TIME_UNITS[said.time_unit or _unit(name, values)]
    limit = np.iinfo(np.int64).max / scale
    if (np.abs(values.astype(np.float64)) >= limit).any():
        raise rejection("out-of-range", f"{path.name} has times beyond the year 2262 in its column {name!r}.")
    whole = np.issubdtype(values.dtype, np.integer)
    time_ns: IntArray = (values * scale if whole else np.rint(values * float(scale))).astype(np.int64)
    begin = min(int(time_ns.min()), 0)
    return time_ns if begin == 0 else time_ns - begin


def _unit(name: str, values: NDArray[Any]) -> str:
    """The unit of times, by the end of the column's name, by their size if they count from 1970, else seconds."""
    unit = name.strip().lower().rpartition("_")[2]
    if unit in TIME_UNITS:
        return unit
    largest = float(np.abs(values).max()) if len(values) else 0.0
    return next((unit for least, unit in _EPOCHS if largest >= least), "s")


def _ids(path: Path, name: str) -> NDArray[Any]:
    return _texts(_loaded(path, (name,), Limits())[name])


def _texts(values: NDArray[Any]) -> NDArray[Any]:
    """Ids as texts, whole numbers without a point."""
    found = values.tolist()
    if np.issubdtype(values.dtype, np.floating):
        found = [int(one) if np.isfinite(one) and one == int(one) else one for one in found]
    return np.array(["" if one is None else str(one).strip() for one in found], dtype=object)


def _state(path: Path) -> tuple[int, ...]:
    about = require_regular(path, Limits())
    return about.st_size, about.st_mtime_ns, about.st_ino


def _header(path: Path) -> dict[str, Column]:
    """The columns of a file by name.

    Raises:
        RecordingError: unreadable, corrupt or too-large.
    """
    return _header_of(path, _state(path))


@lru_cache(maxsize=64)
def _header_of(path: Path, _: tuple[int, ...]) -> dict[str, Column]:
    ending = path.suffix.lower()
    found = (
        _npz_header(path) if ending == ".npz" else _parquet_header(path) if ending == ".parquet" else _csv_header(path)
    )
    if len(found) > MOST_COLUMNS:
        raise rejection("too-large", f"{path.name} has {len(found)} columns; at most {MOST_COLUMNS} are read.")
    return found


def _loaded(path: Path, names: tuple[str, ...], limits: Limits) -> dict[str, NDArray[Any]]:
    return _loaded_of(path, _state(path), tuple(dict.fromkeys(names)), limits)


@lru_cache(maxsize=1)
def _loaded_of(path: Path, _: tuple[int, ...], names: tuple[str, ...], limits: Limits) -> dict[str, NDArray[Any]]:
    """Values of columns by name, (M,) or of an array (M, width); the last ones are kept, as ids are read one by one."""
    ending = path.suffix.lower()
    read = _npz if ending == ".npz" else _parquet if ending == ".parquet" else _csv
    found = read(path, names, limits)
    lengths = {len(values) for values in found.values()}
    if len(lengths) > 1:
        raise rejection("corrupt", f"{path.name} has columns of {few_of(sorted(str(one) for one in lengths))} rows.")
    meter = Meter(limits, REMEDY)
    meter.hold(sum(values.size for values in found.values()))
    return found


# CSV


def _csv_head(path: Path) -> tuple[list[str], list[str], str]:
    """The first row, the second, and what separates their cells."""
    if path.stat().st_size > LARGEST_CSV:
        raise rejection("too-large", f"{path.name} has more than {LARGEST_CSV >> 20} MB; {REMEDY}.")
    with path.open("rb") as stream:
        data = stream.read(_HEAD_BYTES)
    try:
        text = data.decode("utf-8-sig", "strict" if len(data) < _HEAD_BYTES else "ignore")
    except UnicodeDecodeError as error:
        raise rejection("corrupt", f"{path.name} is no text in UTF-8 (byte {error.start}).") from error
    first = text.partition("\n")[0]
    separator = max(SEPARATORS, key=first.count)
    try:
        rows = csv.reader(io.StringIO(text), delimiter=separator)
        names, second = next(rows, []), next(rows, [])
    except csv.Error as error:
        raise rejection("corrupt", f"{path.name} is no table: {error}.") from error
    return [name.strip() for name in names], second, separator


def _csv_header(path: Path) -> dict[str, Column]:
    names, second, _ = _csv_head(path)
    if not any(names):
        raise rejection("corrupt", f"{path.name} is empty; its first row must name the columns.")
    if repeated := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise rejection("corrupt", f"{path.name} names the column {repeated[0]!r} twice; keep one.")
    if all(_is_number(name) for name in names):
        raise rejection("not-read", f"{path.name} begins with numbers; its first row must name the columns.")
    cells = [*second, *[""] * len(names)]
    return {name: Column("number" if _is_number(cell) else "text") for name, cell in zip(names, cells, strict=False)}


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _csv(path: Path, names: tuple[str, ...], limits: Limits) -> dict[str, NDArray[Any]]:
    columns, _, separator = _csv_head(path)
    ordered = sorted(names, key=columns.index)  # in their order in the file, in which they come in any case
    try:
        table = pl.read_csv(
            path.read_bytes(), has_header=False, skip_rows=1, separator=separator, infer_schema=False,
            columns=[columns.index(name) for name in ordered], truncate_ragged_lines=False,
            n_rows=min(limits.joint_states, limits.joint_values // max(len(ordered), 1)) + 1,
        )  # fmt: skip
        found = dict(zip(ordered, table.get_columns(), strict=True))
        return {name: _cells(path, name, found[name]) for name in names}
    except pl.exceptions.NoDataError:
        return {name: np.empty(0) for name in names}
    except (pl.exceptions.PolarsError, ValueError) as error:
        raise rejection(
            "corrupt", f"{path.name} cannot be read as CSV ({' '.join(str(error).split())[:200]})."
        ) from error


def _cells(path: Path, name: str, cells: pl.Series) -> NDArray[Any]:
    """Cells as whole numbers, numbers or times in ns, whichever all of them are; else as texts."""
    cells = cells.str.strip_chars()
    for kind in (pl.Int64, pl.Float64):
        found = cells.cast(kind, strict=False)
        if found.null_count() == cells.null_count():
            return found.to_numpy() if not found.null_count() else found.cast(pl.Float64).to_numpy()
    if _header(path)[name].kind == "number":
        row = int((cells.cast(pl.Float64, strict=False).is_null() & cells.is_not_null()).arg_max() or 0)
        raise rejection(
            "corrupt", f"Row {row + 1} of {path.name} has {cells[row]!r} in its column {name!r}, no number."
        )
    if _is_time(name):
        found = cells.str.to_datetime(time_unit="ns", strict=False)
        if not found.null_count():
            return found.dt.replace_time_zone(None).cast(pl.Int64).to_numpy()
    return np.array(cells.to_list(), dtype=object)


# Parquet


def _parquet_header(path: Path) -> dict[str, Column]:
    (found,) = foreign_tables([path])
    if found is None:
        raise rejection("corrupt", f"{path.name} cannot be read as Parquet; its end is damaged.")
    return {
        name: Column(column.kind, column.values // max(found.rows, 1), column.ns)
        for name, column in found.columns.items()
    }


def _parquet(path: Path, names: tuple[str, ...], limits: Limits) -> dict[str, NDArray[Any]]:
    (found,) = foreign_tables([path])
    assert found is not None
    meter = Meter(limits, REMEDY)
    if found.rows > limits.joint_states:
        raise rejection("too-large", f"{path.name} has {found.rows} rows; at most {limits.joint_states} are read.")
    for name in names:
        meter.hold(found.columns[name].values)
        meter.inflate(found.columns[name].size)
    return read_columns(path, names)


# npz


def _npz_header(path: Path) -> dict[str, Column]:
    found = {}
    with _archive(path) as archive:
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            shape, dtype = _array_header(path, archive, info)
            if dtype.kind in "fiu" and 1 <= len(shape) <= 2:
                found[name] = Column("number") if len(shape) == 1 else Column("array", int(shape[1]))
            elif dtype.kind == "U" and len(shape) == 1 and dtype.itemsize <= 4 * LONGEST_TEXT:
                found[name] = Column("text")
            else:
                found[name] = Column("other")
    return found


def _npz(path: Path, names: tuple[str, ...], limits: Limits) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {}
    meter = Meter(limits, REMEDY)
    with _archive(path) as archive:
        for name in names:
            info = archive.getinfo(f"{name}.npy")
            shape, dtype = _array_header(path, archive, info)
            meter.inflate(info.file_size)
            meter.hold(info.file_size // max(dtype.itemsize, 1))
            if shape and shape[0] > limits.joint_states:
                raise rejection(
                    "too-large", f"{path.name} has {shape[0]} rows; at most {limits.joint_states} are read."
                )
            try:
                with archive.open(info) as stream:
                    found[name] = np.lib.format.read_array(stream, allow_pickle=False)
            except _DAMAGED as error:
                raise rejection("corrupt", f"{path.name} has an array {name!r} that cannot be read.") from error
            if dtype.kind == "u":
                found[name] = found[name].astype(np.float64)
    return found


def _named_inside(path: Path, width: int) -> list[str]:
    """The names of the columns of an array, where a file has them beside it."""
    if path.suffix.lower() != ".npz":
        return []
    there = _header(path)
    for name in JOINTS:
        if name in there and there[name].kind == "text":
            texts = [str(one) for one in _npz(path, (name,), Limits())[name].tolist()]
            if len(texts) == width and len(set(texts)) == width:
                return texts
    return []


def _archive(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except _DAMAGED as error:
        raise rejection("corrupt", f"{path.name} cannot be read as npz: it is no zip archive.") from error


def _array_header(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array, which must be those of as many bytes as the archive states."""

    def wrong(said: str) -> RecordingError:
        return rejection("corrupt", f"{path.name} has a member {info.filename!r} {said}.")

    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or info.flag_bits & 1:
        raise wrong("that is compressed or encrypted as NumPy does not do it")
    try:
        with archive.open(info) as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(stream)
            at = stream.tell()
    except (*_DAMAGED, TypeError, SyntaxError, RecursionError, tokenize.TokenError) as error:
        raise wrong("that is no array of NumPy") from error
    if dtype.hasobject:
        raise wrong("of Python objects, which are not read, as they may be programs; save numbers and texts")
    size = dtype.itemsize * int(np.prod([int(one) for one in shape], dtype=object))
    if size != info.file_size - at:
        raise wrong(f"that states {size} bytes and has {info.file_size - at}")
    return shape, dtype
