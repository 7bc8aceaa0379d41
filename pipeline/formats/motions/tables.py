"""Motions as one table, CSV or Parquet: a row for each pose, a column for each joint, named as in the scene."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import StageError
from pipeline.formats.motions.named_motions import MotionSet

if TYPE_CHECKING:
    import polars as pl

STEM, COLUMNS = "motions", "columns.json"
LEADING = {
    "demonstration_id": ("string", None, "which motion"),
    "participant": ("string", None, "who moved the arm"),
    "time_s": ("double", "s", "since the motion began; its poses are in order"),
}


def write_csv(folder: Path, motions: MotionSet) -> None:
    """Write motions.csv and, with units and a description of each column, columns.json.

    Raises:
        StageError: a joint is called as a column that is there already.
    """
    table = motion_table(motions)
    with (folder / f"{STEM}.csv").open("wb") as stream:
        table.write_csv(stream)
    _write_columns(folder, motions)


def write_parquet(folder: Path, motions: MotionSet) -> None:
    """Write motions.parquet, whose columns carry `unit` and `description` as metadata, and columns.json.

    Raises:
        StageError: a joint is called as a column that is there already.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = motion_table(motions).to_arrow()
    columns = [
        pa.field(one["name"], pa.string() if one["type"] == "string" else pa.float64(), nullable=False).with_metadata(
            {key: one[key] for key in ("unit", "description") if one[key]}
        )
        for one in columns_of(motions)
    ]
    with (folder / f"{STEM}.parquet").open("wb") as stream:
        pq.write_table(
            table.cast(pa.schema(columns, {"lessbench": json.dumps({"task": motions.task})})), stream,
            compression="zstd",
        )  # fmt: skip
    _write_columns(folder, motions)


def motion_table(motions: MotionSet) -> pl.DataFrame:
    """All poses, motion after motion."""
    import polars as pl

    same = [joint for joint in motions.joints if joint in LEADING]
    if same:
        raise StageError(
            f"joint {same[0]!r} is called as a column of the table, which has {', '.join(LEADING)}; export to mcap or "
            "lerobot, or give the joint another name in the scene"
        )
    lengths = [len(motion.time_ns) for motion in motions.motions]
    positions = np.concatenate([motion.positions for motion in motions.motions])
    return pl.DataFrame(
        {
            "demonstration_id": np.repeat([motion.name for motion in motions.motions], lengths),
            "participant": np.repeat([motion.participant for motion in motions.motions], lengths),
            "time_s": np.concatenate([motion.time_s for motion in motions.motions]),
        }
        | {joint: np.ascontiguousarray(positions[:, place]) for place, joint in enumerate(motions.joints)}
    )


def columns_of(motions: MotionSet) -> list[dict[str, str | None]]:
    """Name, type, unit and description of each column, in order."""
    leading: list[dict[str, str | None]] = [
        {"name": name, "type": kind, "unit": unit, "description": text} for name, (kind, unit, text) in LEADING.items()
    ]
    joints: list[dict[str, str | None]] = [
        {
            "name": joint,
            "type": "double",
            "unit": unit,
            "description": "position of the joint of this name in the scene",
        }
        for joint, unit in zip(motions.joints, motions.units, strict=True)
    ]
    return [*leading, *joints]


def _write_columns(folder: Path, motions: MotionSet) -> None:
    about = {"task": motions.task, "columns": columns_of(motions)}
    (folder / COLUMNS).write_text(json.dumps(about, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
