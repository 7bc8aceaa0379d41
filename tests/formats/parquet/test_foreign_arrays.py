"""Arrays in Parquet files of others: bounded, hashed as read, and one sentence about anything else."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import StageError
from pipeline.formats.parquet import foreign_arrays as module
from pipeline.formats.parquet.foreign_arrays import foreign_arrays
from pipeline.formats.parquet.measured import Measured, measured


def saved(path: Path, column: Any, name: str = "waypoints") -> Path:
    pq.write_table(pa.table({name: column}), path, row_group_size=7)
    return path


def read(path: Path) -> np.ndarray:
    with foreign_arrays(path, "waypoints", "sample.given") as column:
        return np.concatenate([rows.values for rows in column.rows()])


LISTS = {
    "lists": lambda a: pa.array(a.reshape(len(a), -1).tolist()),
    "nested": lambda a: pa.array(a.tolist()),
    "large lists": lambda a: pa.array(a.tolist(), pa.large_list(pa.large_list(pa.float64()))),
    "fixed lists": lambda a: pa.array(a.tolist(), pa.list_(pa.list_(pa.float64(), a.shape[2]), a.shape[1])),
    "float32": lambda a: pa.array(a.astype(np.float32).tolist(), pa.list_(pa.list_(pa.float32()))),
    "integers": lambda a: pa.array(np.rint(a * 100).astype(int).tolist()),
}  # fmt: skip


@pytest.mark.parametrize("kind", LISTS)
@pytest.mark.parametrize("count", [1, 20])
def test_every_kind_of_list_is_read_as_it_is(tmp_path: Path, kind: str, count: int) -> None:
    numbers = np.random.default_rng(0).normal(size=(count, 5, 3))

    found = read(saved(tmp_path / "a.parquet", LISTS[kind](numbers)))

    wanted = {"float32": numbers.astype(np.float32), "integers": np.rint(numbers * 100)}.get(kind, numbers)
    np.testing.assert_array_equal(found.reshape(count, 5, 3), wanted)


def test_the_digest_is_of_the_bytes_that_are_read(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.parquet", pa.array([[1.0, 2.0]]))

    with foreign_arrays(path, "waypoints", "sample.given") as column:
        path.unlink()
        path.write_bytes(b"another file of that name")
        rows = list(column.rows())

    assert rows[0].values is not None
    assert column.digest != hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_file_that_is_written_to_meanwhile_is_noticed(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.parquet", pa.array([[1.0, 2.0]]))

    def read_beside_a_writer() -> None:
        with foreign_arrays(path, "waypoints", "sample.given") as column, path.open("ab") as stream:
            list(column.rows())
            stream.write(b"more")

    with pytest.raises(StageError, match=r"a\.parquet: was changed while it was read; run it again"):
        read_beside_a_writer()


@pytest.mark.parametrize(
    ("column", "said"),
    [
        (pa.array(["a", "b"]), "row 1: the column `waypoints` has cells of type string; lists of numbers are needed"),
        (pa.array([1.0, 2.0]), "cells of type double"),
        (pa.array([["a"]]), "cells of type list"),
        (pa.array([[[[1.0]]]]), "cells of type list"),
        (pa.array([{"x": [1.0]}]), "cells of type struct"),
        (pa.array([[True]]), "cells of type list"),
        (pa.array([[1]], pa.list_(pa.timestamp("ns"))), "cells of type list"),
        (pa.array([[1]], pa.list_(pa.decimal128(30, 2))), "cells of type list"),
        (pa.array([b"\x00" * 8]), "cells of type binary"),
    ],
)
def test_columns_of_something_else(tmp_path: Path, column: Any, said: str) -> None:
    with pytest.raises(StageError, match=said):
        read(saved(tmp_path / "a.parquet", column))


@pytest.mark.parametrize("cells", [[[1.0], None], [[1.0, None]], [[[1.0], [1.0, 2.0]]], [[[1.0], None]]])
def test_irregular_rows_are_told_one_by_one(tmp_path: Path, cells: Any) -> None:
    with foreign_arrays(saved(tmp_path / "a.parquet", pa.array(cells)), "waypoints", "sample.given") as column:
        assert None in [rows.values for rows in column.rows()]


def test_a_named_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.parquet")

    with pytest.raises(StageError, match=r"is not a regular file; sample\.given names a Parquet file"):
        read(tmp_path / "a.parquet")


def test_a_small_file_with_endless_zeros_is_refused_before_they_are_decoded(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    zeros = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(30_000_000, dtype=np.int8)), 3_000_000)
    with pq.ParquetWriter(path, pa.schema([("waypoints", zeros.type)]), compression="zstd") as writer:
        for _ in range(11):
            writer.write_table(pa.table({"waypoints": zeros}))
    assert path.stat().st_size < 1_000_000

    before = pa.total_allocated_bytes()
    with pytest.raises(StageError, match=r"says that it holds 110 rows with 330,000,000 numbers in .* give fewer"):
        read(path)
    assert pa.total_allocated_bytes() == before


def test_too_many_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_COLUMNS", 3)
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({f"c{number}": [1] for number in range(4)}), path)

    with pytest.raises(StageError, match="has 4 columns and 1 row groups; at most 3"):
        read(path)


def test_what_a_file_states_is_found_in_a_process_of_its_own(tmp_path: Path) -> None:
    """The library ends the process at some damages, such as of the counts of its levels (found by fuzzing)."""
    path = saved(tmp_path / "a.parquet", LISTS["nested"](np.ones((20, 5, 3))))
    whole = path.read_bytes()
    found = []
    for data in (whole, whole[:-20] + b"x" * 12 + whole[-8:], b"none"):
        path.write_bytes(data)
        with path.open("rb") as stream:
            found.append(measured(stream.fileno(), "waypoints"))

    assert found[0] is not None
    assert found[0].numbers == 20 * 5 * 3
    assert found[1:] == [None, None]


def test_an_end_that_is_damaged_beyond_what_can_be_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "measured", lambda *_: None)
    with pytest.raises(StageError, match=r"cannot be read as Parquet \(its end is damaged\); sample\.given names"):
        read(saved(tmp_path / "a.parquet", pa.array([[1.0, 2.0]])))


def test_damage_anywhere_ends_in_one_sentence_or_in_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "measured", lambda *_: Measured(0, 0))  # the process of its own, for speed
    whole = saved(
        tmp_path / "a.parquet", LISTS["nested"](np.random.default_rng(0).normal(size=(20, 5, 3)))
    ).read_bytes()
    rng = np.random.default_rng(1)
    outcomes = set()
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
        path = tmp_path / "b.parquet"
        path.write_bytes(damaged)
        try:
            outcomes.add(read(path).shape[0])
        except StageError as error:
            outcomes.add("sentence" if "\n" not in str(error) else "lines")
        except (TypeError, AttributeError):
            outcomes.add("irregular")  # None among the rows, which this helper cannot join
    assert {"sentence", 20} <= outcomes <= {"sentence", "irregular", *range(21)}
