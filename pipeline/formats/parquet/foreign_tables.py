"""Columns of Parquet files of other programs, which follow no schema and are not trusted.

The library ends the whole process when some fields of a file's end are damaged, so what is not trusted is looked at
first in a process of its own, with bounded memory and time: many files in one. Only then are columns decoded here.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.errors import RecordingError

if TYPE_CHECKING:
    from numpy.typing import NDArray

ADDRESS_SPACE_BYTES = 4 << 30
PATIENCE_S = 120
MOST_COLUMNS, MOST_GROUPS = 10_000, 100_000
LONGEST_TEXT = 1_000  # bytes
MOST_DAMAGED = 20  # files at which the look at many is given up
_TOGETHER = 500  # files


@dataclass(frozen=True)
class ForeignColumn:
    """A column as the end of a file states it.

    Attributes:
        kind: `number`, `time`, `text`, `array` (a list of numbers in each row) or `other`.
        values: over all rows.
        size: bytes, inflated.
        ns: of a time: its unit in ns.
    """

    kind: str
    values: int
    size: int
    ns: int = 1


@dataclass(frozen=True)
class ForeignTable:
    """What the end of a file states."""

    rows: int
    columns: dict[str, ForeignColumn]


def foreign_tables(paths: Sequence[Path]) -> list[ForeignTable | None]:
    """What files state of themselves; None for one that cannot be read as Parquet."""
    states = [(path, (about := path.stat()).st_size, about.st_mtime_ns, about.st_ino) for path in paths]
    missing = [state for state in dict.fromkeys(states) if state not in _KNOWN]
    if len(_KNOWN) + len(missing) > _MOST_KNOWN:
        _KNOWN.clear()
        missing = list(dict.fromkeys(states))
    damaged = 0
    while missing:
        together = missing[:_TOGETHER]
        found = _looked_at([path for path, *_ in together])
        _KNOWN.update(zip(together, found, strict=False))
        missing = missing[len(found) :]
        if len(found) < len(together):  # the process ended at the next
            damaged += 1
            _KNOWN[missing.pop(0)] = None
            if damaged == MOST_DAMAGED:
                _KNOWN.update(dict.fromkeys(missing))
                break
    return [_KNOWN[state] for state in states]


_KNOWN: dict[tuple[Any, ...], ForeignTable | None] = {}
_MOST_KNOWN = 10_000


def read_columns(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Columns of a file that `foreign_tables` could read, by name.

    Numbers are float64 or int64, with NaN for those that are missing (which are then float64); times int64 in their
    unit; texts objects, None where missing; arrays (rows, width) float64.

    Raises:
        RecordingError: corrupt; a column cannot be decoded, has missing times or rows of different widths.
    """
    import numpy as np
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    def wrong(said: str) -> RecordingError:
        return RecordingError("corrupt", f"{path.name} cannot be read as Parquet: {said}.")

    found: dict[str, NDArray[Any]] = {}
    try:
        # texts as a dictionary: one long text may stand for millions of rows
        with pq.ParquetFile(path) as file:
            texts = [name for name in names if _kind(file.schema_arrow.field(name).type) == "text"]
        with pq.ParquetFile(path, read_dictionary=texts) as file:
            table = file.read(columns=list(names), use_threads=False)
        for name in names:
            column = table.column(name).combine_chunks()
            column = pa.concat_arrays(column.chunks) if isinstance(column, pa.ChunkedArray) else column
            kind = _kind(column.type)
            if pa.types.is_dictionary(column.type):
                if kind == "text" and (pc.max(pc.binary_length(column.dictionary)).as_py() or 0) > LONGEST_TEXT:
                    raise wrong(f"the column {name!r} has texts of more than {LONGEST_TEXT} bytes")
                column = column.dictionary_decode() if kind != "text" else column
            if kind == "array":
                inner = column.flatten()
                width = len(inner) // max(len(column), 1)
                if (
                    column.null_count
                    or inner.null_count
                    or (
                        not pa.types.is_fixed_size_list(column.type)
                        and not (np.diff(column.offsets.to_numpy()) == width).all()
                    )
                ):
                    raise wrong(f"the lists of the column {name!r} have gaps or are not of one length")
                found[name] = inner.to_numpy(zero_copy_only=False).astype(np.float64).reshape(len(column), width)
            elif kind == "text":
                found[name] = np.array(column.to_pylist(), dtype=object)
            elif kind == "time":
                if column.null_count:
                    raise wrong(f"the column {name!r} has missing times")
                found[name] = column.cast(pa.int64()).to_numpy(zero_copy_only=False)
            elif kind == "number":
                whole = pa.types.is_integer(column.type) and not column.null_count
                values = column.to_numpy(zero_copy_only=False)
                found[name] = values.astype(np.int64 if whole else np.float64)
            else:
                raise wrong(f"the column {name!r} has values of type {str(column.type)[:100]}")
    except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
        raise wrong(" ".join(str(error).split())[:300]) from error
    return found


def _kind(type_: Any) -> str:
    from pyarrow import types

    if types.is_dictionary(type_):
        type_ = type_.value_type
    if types.is_floating(type_) or types.is_integer(type_):
        return "number"
    if types.is_timestamp(type_):
        return "time"
    if types.is_string(type_) or types.is_large_string(type_):
        return "text"
    lists = types.is_list(type_) or types.is_large_list(type_) or types.is_fixed_size_list(type_)
    if lists and (types.is_floating(type_.value_type) or types.is_integer(type_.value_type)):
        return "array"
    return "other"


def _looked_at(paths: Sequence[Path]) -> list[ForeignTable | None]:
    """What a process of its own says of the files; fewer if it ended before the last."""
    root = str(Path(__file__).parents[3])
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}
    command = [sys.executable, "-P", "-m", __name__]
    try:
        done = subprocess.run(  # noqa: S603, this program itself
            command, input="\0".join(str(path.absolute()) for path in paths).encode(), env=environment,
            capture_output=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        answer = done.stdout
    except subprocess.TimeoutExpired as late:
        answer = late.stdout or b""
    found = list[ForeignTable | None]()
    for line in answer.splitlines():
        about = json.loads(line)
        columns = {name: ForeignColumn(*column) for name, column in (about or {"columns": {}})["columns"].items()}
        found.append(None if about is None else ForeignTable(about["rows"], columns))
    return found


def main() -> None:
    """Print a line for each of the files that the standard input names."""
    import pyarrow as pa

    resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE_S, PATIENCE_S))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))
    for name in sys.stdin.buffer.read().decode().split("\0"):
        try:
            said: object = _about(name)
        except (pa.ArrowException, OSError, ValueError, OverflowError, KeyError, MemoryError):
            said = None
        sys.stdout.write(json.dumps(said) + "\n")
        sys.stdout.flush()


def _about(name: str) -> object:
    import pyarrow.parquet as pq

    units = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
    with pq.ParquetFile(name) as file:
        about, schema = file.metadata, file.schema_arrow
        if about.num_columns > MOST_COLUMNS or about.num_row_groups > MOST_GROUPS:
            return None
        stated: dict[str, list[int]] = {}
        leaves = [(at, file.schema.column(at).path.split(".")[0]) for at in range(about.num_columns)]
        for group in range(about.num_row_groups):
            row_group = about.row_group(group)
            for at, column in leaves:
                part, total = row_group.column(at), stated.setdefault(column, [0, 0])
                total[0] += part.num_values
                total[1] += part.total_uncompressed_size
        if len(set(schema.names)) < len(schema.names):
            return None
        columns = {}
        for field in schema:
            kind = _kind(field.type)
            unit = units[field.type.unit] if kind == "time" else 1
            columns[field.name] = (kind, *stated.get(field.name, [0, 0]), unit)
        return {"rows": about.num_rows, "columns": columns}


if __name__ == "__main__":
    main()
