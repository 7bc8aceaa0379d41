"""Times of reading and writing tables, which a stage does alone for every row: `python -m benchmarks.tables`.

The tables hold a million alternatives of seven joints and 41 waypoints, with three features and densities. They are
written in parts of 50,000 rows, and their keys are read again as the stages do.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.explained import explain
from benchmarks.measuring import clustered, measured, record, show, timed
from pipeline.formats.parquet.tables import table_writer
from pipeline.formats.parquet.task_tables import TaskTables

PARTS, PARTITION = 20, 50_000
JOINTS, WAYPOINTS = 7, 41
COUNT = PARTS * PARTITION


def ids(part: int) -> list[str]:
    first = part * PARTITION
    return [f"task/{COUNT}/working/{place:06d}" for place in range(first, first + PARTITION)]


def alternatives(part: int) -> pl.DataFrame:
    rng = np.random.default_rng(part)
    waypoints = rng.normal(size=(PARTITION, JOINTS, WAYPOINTS)).cumsum(axis=2).astype(np.float32)
    return pl.DataFrame(
        {
            "alternative_id": ids(part), "anchor": "task", "sampler": "deformation", "set_size": COUNT,
            "set_id": "working", "waypoints": waypoints,
        }
    )  # fmt: skip


def features(part: int) -> pl.DataFrame:
    values = clustered(PARTITION, seed=part)
    columns = dict(zip(("efficiency", "table", "laptop"), values.T, strict=True))
    return pl.DataFrame(
        {"kind": "alternative", "id": ids(part), "anchor": "task", "set_size": COUNT, "set_id": "working", **columns}
    )


def densities(part: int) -> pl.DataFrame:
    return pl.DataFrame(
        {
            "anchor": "task", "set_size": COUNT, "set_id": "working", "alternative_id": ids(part), "bandwidth": 0.02,
            "rows_scored": 4000, "bandwidth_error": 0.001, "engine": "spectral",
            "log_density": np.random.default_rng(part).normal(size=PARTITION),
        }
    )  # fmt: skip


def written(name: str, make: Callable[[int], pl.DataFrame]) -> tuple[float, tuple[float, float]]:
    """Seconds to write a table, its size in bytes, and seconds to read its keys."""
    with tempfile.TemporaryDirectory() as folder:
        path, writing_s = Path(folder) / f"{name}.parquet", 0.0
        with table_writer(path, name, {}) as writer:
            for part in range(PARTS):
                rows = make(part)
                writing_s += timed(writer.write, rows)[0]
        return writing_s, (path.stat().st_size, timed(checked, path, name)[0])


def checked(path: Path, name: str) -> int:
    """Check the keys in one pass, as every stage does first, and return the number of sets."""
    with TaskTables({name: path}) as tables:
        tables.check()
        return len(tables.contents(name).sets)


def main() -> None:
    costs, rows = {}, []
    for name, make in (("alternatives", alternatives), ("features", features), ("densities", densities)):
        run = measured(written, name, make, times=3)
        size, reading_s = run.result
        costs |= {
            f"{name}, written, us per row": run.seconds / COUNT * 1e6,
            f"{name}, keys read, us per row": reading_s / COUNT * 1e6,
            f"{name}, bytes per row": size / COUNT,
        }
        units = ("written, us per row", "keys read, us per row", "bytes per row")
        rows.append((name, *(f"{costs[f'{name}, {unit}']:.3g}" for unit in units)))
    show("Tables of a million alternatives", ("table", "written, us a row", "keys read, us a row", "bytes a row"), rows)
    record("tables", costs)


if __name__ == "__main__":
    explain(__doc__)
    main()
