"""Motions as CSV and Parquet, read back by pandas, pyarrow and the csv module."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from pipeline.errors import StageError
from pipeline.formats.motions.named_motions import MotionSet, NamedMotion
from pipeline.formats.motions.tables import write_csv, write_parquet

NAMES = ["demonstration_id", "participant", "time_s", "rail", 'swing, "joint"']


def two() -> MotionSet:
    rng = np.random.default_rng(1)
    motions = tuple(
        NamedMotion(name, who, 5, np.arange(count) * 33_333_333, rng.normal(size=(count, 2)))
        for name, who, count in (("a,1", "Zoë", 4), ("b", "=1+1", 3))
    )
    return MotionSet("pour", ("rail", 'swing, "joint"'), (True, False), motions)


def test_csv_gives_the_same_numbers_to_the_last_bit(tmp_path: Path) -> None:
    motions = two()
    write_csv(tmp_path, motions)
    with (tmp_path / "motions.csv").open(newline="", encoding="utf-8") as stream:
        head, *rows = csv.reader(stream)
    assert head == NAMES
    assert [row[0] for row in rows] == ["a,1"] * 4 + ["b"] * 3
    assert [row[1] for row in rows] == ["Zoë"] * 4 + ["=1+1"] * 3
    numbers = np.array([[float(value) for value in row[2:]] for row in rows])
    np.testing.assert_array_equal(numbers[:, 1:], np.concatenate([one.positions for one in motions.motions]))
    np.testing.assert_array_equal(numbers[:4, 0], motions.motions[0].time_s)


def test_parquet_gives_the_same_numbers_and_says_their_units(tmp_path: Path) -> None:
    motions = two()
    write_parquet(tmp_path, motions)
    table = pd.read_parquet(tmp_path / "motions.parquet")
    assert list(table.columns) == NAMES
    np.testing.assert_array_equal(table[NAMES[3:]], np.concatenate([one.positions for one in motions.motions]))
    np.testing.assert_array_equal(table["time_s"][4:], motions.motions[1].time_s)
    columns = pq.read_schema(tmp_path / "motions.parquet")
    assert [(columns.field(name).metadata or {}).get(b"unit") for name in NAMES] == [None, None, b"s", b"m", b"rad"]


@pytest.mark.parametrize("write", [write_csv, write_parquet])
def test_the_columns_are_described_beside(tmp_path: Path, write: object) -> None:
    write(tmp_path, two())  # type: ignore[operator]
    about = json.loads((tmp_path / "columns.json").read_text(encoding="utf-8"))
    assert about["task"] == "pour"
    assert [(one["name"], one["type"], one["unit"]) for one in about["columns"]] == list(
        zip(NAMES, ["string", "string", "double", "double", "double"], [None, None, "s", "m", "rad"], strict=True)
    )
    assert all(one["description"] for one in about["columns"])


def test_a_joint_called_as_a_column_is_refused(tmp_path: Path) -> None:
    motions = replace(two(), joints=("rail", "time_s"))
    with pytest.raises(StageError, match="joint 'time_s' is called as a column"):
        write_csv(tmp_path, motions)
