"""An open table: its file is opened once, each part is read once, and what is kept of it has a bound."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import TableError
from pipeline.formats.parquet.checked import kept_columns
from pipeline.formats.parquet.checked.open_table import OpenTable, Piece
from pipeline.formats.parquet.tables import table_writer, write_table
from pipeline.formats.parquet.task_tables import TaskTables

PARTS, ROWS = 4, 30


def features(part: int) -> pl.DataFrame:
    first = part * ROWS
    places = np.arange(first, first + ROWS)
    return pl.DataFrame(
        {
            "kind": "alternative", "id": [f"task/120/working/{place:06d}" for place in places], "anchor": "task",
            "set_size": PARTS * ROWS, "set_id": "working", "a": places / 7, "b": -places / 3,
        }
    )  # fmt: skip


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A table of features in four parts."""
    with table_writer(tmp_path / "features.parquet", "features", {"seed": 3}) as writer:
        for part in range(PARTS):
            writer.write(features(part))
    return tmp_path / "features.parquet"


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, tuple[str, ...]]]:
    """What is read from files from now on: numbers of parts and names of columns."""
    found: list[tuple[int, tuple[str, ...]]] = []
    read: Callable[..., object] = OpenTable._raw

    def noted(table: OpenTable, number: int, names: tuple[str, ...]) -> object:
        found.append((number, tuple(names)))
        return read(table, number, names)

    monkeypatch.setattr(OpenTable, "_raw", noted)
    return found


def test_rows_come_by_part_piece_number_and_condition(path: Path) -> None:
    whole = pl.concat([features(part) for part in range(PARTS)])
    with OpenTable(path, "features") as table:
        assert (table.parts, table.rows, table.provenance) == ((ROWS,) * PARTS, PARTS * ROWS, {"seed": 3})
        assert table.part(2).equals(features(2))
        assert table.part(1, ["b", "id"]).equals(features(1).select("b", "id"))
        assert table.read().equals(whole)
        assert table.read(["a"], where=pl.col("b") < -20).equals(whole.filter(pl.col("b") < -20).select("a"))
        assert table.read(["a", "id"], where=pl.col("a") > 1e9).equals(whole.clear().select("a", "id"))
        pieces = [Piece(0, 28, 2), Piece(1, 0, 3), Piece(3, 29, 1)]
        places = [28, 29, 30, 31, 32, 119]
        assert pl.concat(table.pieces(pieces, ["id"])).equals(whole.select("id")[places])
        assert table.at(places, ["id", "a"]).equals(whole.select("id", "a")[places])
        numbers = table.numbers(pieces, ["b", "a"])
        np.testing.assert_array_equal(numbers, whole.select("b", "a")[places].to_numpy())
        assert numbers.flags.f_contiguous  # as polars makes them, so that sums over features round alike
        assert pl.DataFrame(pa.Table.from_batches(table.batches(), table.arrow_schema)).equals(whole)


def test_a_column_of_a_part_is_read_once(path: Path, reads: list[tuple[int, tuple[str, ...]]]) -> None:
    with OpenTable(path, "features") as table:
        for _ in range(3):
            table.read(["id", "a"])
            table.numbers([Piece(1, 0, 9), Piece(2, 3, 4)], ["a", "b"])
    assert reads == [*((part, ("id", "a")) for part in range(PARTS)), (1, ("b",)), (2, ("b",))]


def test_of_parts_without_such_rows_only_the_condition_is_read(
    path: Path, reads: list[tuple[int, tuple[str, ...]]]
) -> None:
    with OpenTable(path, "features") as table:
        assert table.read(where=pl.col("a") > 13).height == 28
    assert {part for part, names in reads if "b" in names} == {3}


def test_what_is_kept_has_a_bound_and_is_read_again_beyond_it(
    path: Path, reads: list[tuple[int, tuple[str, ...]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_columns, "KEPT_BYTES", 3 * 8 * ROWS)  # three columns of doubles of one part
    with OpenTable(path, "features") as table:
        for _ in range(2):
            assert table.read(["a", "b"]).equals(pl.concat([features(part).select("a", "b") for part in range(PARTS)]))
            assert len(kept_columns.kept._columns) <= 3
    assert len(reads) == 2 * PARTS
    assert kept_columns.kept._bytes == 0


def test_threads_share_a_table(path: Path, reads: list[tuple[int, tuple[str, ...]]]) -> None:
    expected = pl.concat([features(part) for part in range(PARTS)])
    with OpenTable(path, "features") as table, ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: table.read(), range(40)))
    assert all(one.equals(expected) for one in found)
    assert len(reads) == PARTS


def test_each_value_and_key_is_checked_when_it_is_first_read(path: Path) -> None:
    whole = pq.read_table(path)
    values = whole["a"].to_pylist()
    values[70] = float("nan")
    broken = whole.set_column(whole.schema.get_field_index("a"), "a", [values])
    pq.write_table(broken, path, row_group_size=ROWS)
    with OpenTable(path, "features") as table:
        assert table.read(["b"]).height == PARTS * ROWS
        with pytest.raises(TableError, match="'a' holds NaN in row 71"):
            table.read(["a"])
    with pq.ParquetWriter(path, whole.schema) as out:
        out.write_table(whole.slice(0, 30))
        out.write_table(whole.slice(5, 30))
    with OpenTable(path, "features") as table, pytest.raises(TableError, match="among those of another part"):
        table.read()


@pytest.mark.parametrize("folder", ["set[1]", "a*b?", "year=2020/month=1", "~x", "{a,b}", "a b#c%20d"])
def test_a_path_is_that_of_one_file_whatever_is_in_its_name(tmp_path: Path, folder: str) -> None:
    path = tmp_path / folder / "features.parquet"
    write_table(path, "features", features(0), {})
    decoys = [tmp_path / "set1", tmp_path / "axxbx", tmp_path / "a"]
    for decoy in decoys:
        write_table(decoy / "features.parquet", "features", features(1), {})
    with OpenTable(path, "features") as table:
        assert table.read().equals(features(0))


def test_a_file_without_a_single_row_group_is_a_table_without_rows(path: Path) -> None:
    with pq.ParquetWriter(path, pq.read_schema(path)):
        pass
    assert pq.read_metadata(path).num_row_groups == 0
    with TaskTables({"features": path}) as tables:
        tables.check()
        assert tables["features"].read().equals(features(0).clear())
        assert tables["features"].read(["a"], where=pl.col("b") > 0).columns == ["a"]
        assert tables.contents("features").sets == ()


def test_a_name_that_is_no_valid_text_can_be_opened(tmp_path: Path) -> None:
    path = tmp_path / "\udcff.parquet"
    write_table(path, "features", features(0), {})
    with OpenTable(path, "features") as table:
        assert table.rows == ROWS


def test_a_table_that_is_replaced_while_it_is_open_is_read_as_it_was(path: Path) -> None:
    with OpenTable(path, "features") as table:
        digest = table.digest
        write_table(path, "features", features(3), {"seed": 4})
        assert table.read().height == PARTS * ROWS
        with OpenTable(path, "features") as new:
            assert new.digest != digest
