"""Hostile tables, parameters, names and questions by number, beside the recordings of `fuzz`.

    python -m tests.hostile.fuzz_files --cases 10000
    python -m tests.hostile.fuzz_files --first 1234 --cases 1      # one of them again

Each case is made from its number alone, is given to the code that meets such a thing, and must end as that code
promises: in what it is for, or in one sentence. What ends otherwise, takes more than 5 s of processor time, or leaves a
file where none belongs, is a failure.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
import traceback
import unittest.mock
from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from ruamel.yaml import YAML

from pipeline.errors import WorkbenchError
from pipeline.formats.duckdb.catalog import build_catalog
from pipeline.formats.duckdb.quoting import identifier, literal
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.foreign_arrays import foreign_arrays
from pipeline.formats.parquet.measured import Measured
from pipeline.formats.parquet.tables import write_table
from pipeline.params import load, parse
from pipeline.terminal import plain
from pipeline.yaml_text import plain_yaml

SEED = 20_261_126
SECONDS = 5.0
ROOT = Path(__file__).resolve().parents[2]
Rng = np.random.Generator
HARM = (
    'x"; drop table posteriors; --', "x') from read_text('/etc/passwd'); --", "beta=10", "model=less", "..",
    "a\x1b]52;c;eA==\x07", "a\nb", "\u202etxt", "", " ", "'", '"', "`", "\\", "$(id)", "{{task}}", "${key}", "null",
    "a" * 5_000, "\ud800", "\u2603", "*", "?", "task", "rowid", "select", "file://x", "-rf", "~", "NaN",
)  # fmt: skip
LARGE = (10**12, 2**63, 2**64, -1, 0, 1e308, float("nan"), float("inf"), -0.0, True, None, "1e9", [], {}, [10**9] * 3)


@dataclass
class Outcomes:
    """How the cases ended, by kind, and what failed."""

    by_kind: dict[str, Counter[str]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    longest: float = 0.0


def run(numbers: range) -> Outcomes:
    """Make the cases and see how each ends."""
    found = Outcomes()
    for number in numbers:
        kind = list(KINDS)[number % len(KINDS)]
        with tempfile.TemporaryDirectory() as folder:
            began = time.process_time()
            ending = _ended(KINDS[kind], np.random.default_rng([SEED, number]), Path(folder))
            took = time.process_time() - began
        found.longest = max(found.longest, took)
        if took > SECONDS:
            ending = f"FAILED: took {took:.1f} s of processor time"
        if ending.startswith("FAILED"):
            found.failures.append(f"case {number} ({kind}): {ending}")
        found.by_kind.setdefault(kind, Counter())[ending.partition(":")[0]] += 1
    return found


def _ended(kind: Callable[[Rng, Path], str], rng: Rng, folder: Path) -> str:
    try:
        return kind(rng, folder)
    except WorkbenchError as error:
        # what a name brings along is made plain where it is printed
        several = "\n" in str(error).replace(str(folder), "").replace("a\nb", "")
        return f"FAILED: several lines: {error}" if several else "one sentence"
    except Exception:
        return f"FAILED: {traceback.format_exc(limit=-3)}"


# Tables


def _posteriors(count: int = 6) -> pl.DataFrame:
    return pl.DataFrame(
        {
            "task": "a", "demonstration_id": "d", "participant": "p", "model": "less", "set_size": 10, "set_id": "00",
            "theta_id": range(count), "theta": pl.Series(np.eye(count, 3)), "beta": 1.0,
            "log_posterior": np.log(np.full(count, 1 / count)), "posterior": 1 / count,
        }
    )  # fmt: skip


@cache
def _sound_table() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "posteriors.parquet"
        write_table(path, "posteriors", _posteriors(), {"program": "test"})
        return path.read_bytes()


def table_with_bytes_turned(rng: Rng, folder: Path) -> str:
    """Bits of a table, its footer and its provenance."""
    data = bytearray(_sound_table())
    for _ in range(int(rng.integers(1, 4))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return _read(folder, bytes(data))


def table_cut_or_padded(rng: Rng, folder: Path) -> str:
    data = _sound_table()
    at = int(rng.integers(len(data)))
    return _read(
        folder, [data[:at], data[at:], data[:at] + bytes(99) + data[at:], data + data[:at]][int(rng.integers(4))]
    )


def table_with_other_columns(rng: Rng, folder: Path) -> str:
    """Columns named to do harm, of other types, more or fewer, on the way to the catalog."""
    table = pq.read_table(pa.BufferReader(_sound_table()))
    names = list(table.column_names)
    for _ in range(int(rng.integers(1, 3))):
        at = int(rng.integers(len(names)))
        match int(rng.integers(4)):
            case 0:
                names[at] = _writable(rng)
            case 1:
                other = _writable(rng)
                table, names = table.append_column(other, pa.array(["x"] * table.num_rows)), [*names, other]
            case 2 if len(names) > 1:
                table = table.remove_column(at)
                del names[at]
            case _:
                values = [None, "x", 2.8e180, -1.0, b"x", [1], {"a": 1}][int(rng.integers(7))]
                table = table.set_column(at, names[at], pa.array([values] * table.num_rows))
    path = folder / "posteriors.parquet"
    pq.write_table(table.rename_columns(names), path)
    return _in_catalog(folder, path)


def given_trajectories(rng: Rng, folder: Path) -> str:
    """A file of somebody's trajectories, with bits turned or of another type."""
    cells: Any = rng.normal(size=(5, 4, 3)).tolist()
    match int(rng.integers(5)):
        case 0:
            cells[int(rng.integers(5))] = None
        case 1:
            cells[int(rng.integers(5))] = [[1.0]] * int(rng.integers(9))
        case 2:
            cells = [_writable(rng)] * 5
        case _:
            pass
    path = folder / "given.parquet"
    pq.write_table(pa.table({"waypoints": pa.array(cells)}), path)
    data = bytearray(path.read_bytes())
    for _ in range(int(rng.integers(0, 3))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    path.write_bytes(data)
    if rng.integers(8):  # the look from a process of its own takes the time of all the rest
        with unittest.mock.patch("pipeline.formats.parquet.foreign_arrays.measured", return_value=Measured(0, 0)):
            return _counted(path)
    return _counted(path)


def _counted(path: Path) -> str:
    with foreign_arrays(path, "waypoints", "sample.given") as column:
        return f"read: {sum(1 for _ in column.rows())}"


def _read(folder: Path, data: bytes) -> str:
    path = folder / "posteriors.parquet"
    path.write_bytes(data)
    with OpenTable(path, "posteriors") as table:
        same = table.read().equals(_posteriors().select(table.columns).cast(dict(table.read().schema)))
    return "read as it was" if same else "FAILED: other values were read in silence"


def _in_catalog(folder: Path, path: Path) -> str:
    with OpenTable(path, "posteriors") as table:
        build_catalog(folder / "catalog.duckdb", {"posteriors": [("a", table)]})
    left = {file.name for file in folder.iterdir()}
    return "in the catalog" if left == {path.name, "catalog.duckdb"} else f"FAILED: {left} are there"


# Names and questions


def names_in_sql(rng: Rng, folder: Path) -> str:
    """Any text as the name of a table and column and as a value, quoted in the one place for it."""
    name, value = (_text(rng).replace("\0", "") or "x" for _ in range(2))
    with duckdb.connect() as con:
        con.execute(f"create table {identifier(name)} ({identifier(name + 'c')} varchar)")
        con.execute(f"insert into {identifier(name)} values ({literal(value)})")
        found = con.execute(f"select {identifier(name + 'c')} from {identifier(name)}").fetchall()
        tables = con.execute("select table_name from duckdb_tables()").fetchall()
    return "as it was" if (found, tables) == ([(value,)], [(name,)]) else f"FAILED: {found} in {tables}"


def folder_names(rng: Rng, folder: Path) -> str:
    """A table below folders whose names look like data, or like orders."""
    place = folder
    for _ in range(int(rng.integers(1, 4))):
        part = _harm(rng).replace("/", "_").replace("\0", "")[:100]
        place = place / (part if part not in ("", ".", "..") else f"beta={rng.integers(99)}")
    try:
        place.mkdir(parents=True)
    except (OSError, UnicodeEncodeError):
        return "no such folder can be"
    path = place / "posteriors.parquet"
    path.write_bytes(_sound_table())
    with OpenTable(path, "posteriors") as table:
        build_catalog(place / "catalog.duckdb", {"posteriors": [("a", table)]})
    (place / "catalog.duckdb").rename(
        folder / "catalog.duckdb"
    )  # where DuckDB's own rules for paths have nothing to read
    with duckdb.connect(folder / "catalog.duckdb", read_only=True) as con:
        rows = con.execute("select distinct beta, model, participant, task from posteriors").fetchall()
    return "values as they were" if rows == [(1.0, "less", "p", "a")] else f"FAILED: {rows}"


def text_on_a_terminal(rng: Rng, folder: Path) -> str:
    """Any text, made plain."""
    shown = plain(_text(rng), 200)
    return "plain" if shown.isprintable() and len(shown) <= 200 else f"FAILED: {shown!r}"


# Parameters


@cache
def _parameters() -> str:
    return (ROOT / "params.yaml").read_text()


@cache
def _document() -> dict[str, Any]:
    loaded: dict[str, Any] = YAML(typ="safe", pure=True).load(_parameters())
    return loaded


def parameters_with_other_values(rng: Rng, folder: Path) -> str:
    """A value of params.yaml replaced by one that is too large, no number, or of another type."""
    document = deepcopy(_document())
    node, keys = document, [*document]
    while True:
        key = keys[int(rng.integers(len(keys)))]
        inner = node[key]
        if not isinstance(inner, dict | list) or not inner or rng.integers(6) == 0:
            break
        node, keys = inner, list(inner) if isinstance(inner, dict) else list(range(len(inner)))
    node[key] = LARGE[int(rng.integers(len(LARGE)))] if rng.integers(3) else _harm(rng)
    parse(document)
    return "accepted"


def parameters_with_other_keys(rng: Rng, folder: Path) -> str:
    """A key of params.yaml under another name."""
    document = deepcopy(_document())
    section = document[str(rng.choice(list(document)))]
    target = section if isinstance(section, dict) and section else document
    target[_harm(rng)] = target.pop(str(rng.choice(list(target))))
    parse(document)
    return "accepted"


def overlay_of_noise(rng: Rng, folder: Path) -> str:
    """An overlay whose lines were moved, cut, or replaced by what YAML has for doing harm."""
    lines = _parameters().splitlines()
    begin = int(rng.integers(len(lines)))
    lines = lines[begin : begin + int(rng.integers(1, 30))]
    harm = [
        "a: &a [*a]", "!!python/object/apply:os.system [id]", "<<: *x", "- - - - -", "? : ?", "a: !!binary x",
        "%YAML 9", "x: &x {a: 1}", "compute: {scheduler: 'tcp://1.2.3.4:1'}", "\t", "---", "...",
        "a: 0x" + "f" * 400, "[" * 200, "&",
    ]  # fmt: skip
    for _ in range(int(rng.integers(0, 3))):
        lines.insert(int(rng.integers(len(lines) + 1)), harm[int(rng.integers(len(harm)))])
    overlay = folder / "overlay.yaml"
    overlay.write_bytes("\n".join(lines).encode("utf-8", "surrogateescape") + rng.bytes(int(rng.integers(0, 3))))
    load(ROOT / "params.yaml", overlay)
    return "accepted"


def yaml_that_grows(rng: Rng, folder: Path) -> str:
    """Aliases and merges of each other."""
    width, depth = int(rng.integers(2, 12)), int(rng.integers(2, 12))
    rows = ["a0: &a0 [1, 2, 3]"] if rng.integers(2) else ["a0: &a0 {k: 1}"]
    merge = rng.integers(2)
    for level in range(1, depth):
        inner = ", ".join([f"*a{level - 1}"] * width)
        rows.append(f"a{level}: &a{level} " + (f"{{<<: [{inner}], k{level}: 1}}" if merge else f"[{inner}]"))
    plain_yaml("\n".join(rows))
    return "accepted"


def _harm(rng: Rng) -> str:
    return HARM[int(rng.integers(len(HARM)))]


def _writable(rng: Rng) -> str:
    """One that a file can hold."""
    return _harm(rng).encode("utf-8", "replace").decode("utf-8")


def _text(rng: Rng) -> str:
    pieces = [_harm(rng), chr(int(rng.integers(1, 0xD7FF))), rng.bytes(4).decode("latin-1")]
    text = "".join(pieces[int(rng.integers(3))] for _ in range(int(rng.integers(1, 6))))
    return text.encode("utf-8", "replace").decode("utf-8")


KINDS: dict[str, Callable[[Rng, Path], str]] = {
    kind.__name__: kind
    for kind in (
        table_with_bytes_turned, table_cut_or_padded, table_with_other_columns, given_trajectories, names_in_sql,
        folder_names, text_on_a_terminal, parameters_with_other_values, parameters_with_other_keys, overlay_of_noise,
        yaml_that_grows,
    )
}  # fmt: skip


def main() -> int:
    """Run the cases and print the table; 1 if any case failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.fuzz_files", description="Hostile files by number.")
    parser.add_argument("--cases", type=int, default=10_000, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    given = parser.parse_args()
    found = run(range(given.first, given.first + given.cases))
    print(f"{given.cases:,} cases of {len(KINDS)} kinds; longest {found.longest:.2f} s of processor time")
    for kind, endings in found.by_kind.items():
        print(f"  {kind}: " + ", ".join(f"{ending} {count:,}" for ending, count in sorted(endings.items())))
    print(json.dumps(found.failures[:20], indent=1) if found.failures else "failures: 0")
    return bool(found.failures)


if __name__ == "__main__":
    os.environ.setdefault("POLARS_MAX_THREADS", "1")
    sys.exit(main())
