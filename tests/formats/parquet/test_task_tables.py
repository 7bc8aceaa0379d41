"""The tables of a stage: one pass checks keys, sets and what refers to what, in tables of any number of parts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pipeline.errors import TableError
from pipeline.formats.parquet.checked.open_table import OpenTable, Piece
from pipeline.formats.parquet.tables import table_writer
from pipeline.formats.parquet.task_tables import TaskTables
from schemas import schema

SIZE = 40


def ids(first: int, count: int) -> list[str]:
    return [f"task/{SIZE}/working/{place:06d}" for place in range(first, first + count)]


def features(first: int, count: int) -> pl.DataFrame:
    values = np.arange(first, first + count, dtype=float)
    columns = {"kind": "alternative", "id": ids(first, count), "anchor": "task", "set_size": SIZE, "set_id": "working"}
    return pl.DataFrame(columns | {"f": values}, schema_overrides={"set_size": pl.Int64})


def demonstrations() -> pl.DataFrame:
    rows = pl.DataFrame({"kind": "demonstration", "id": ["ana", "bea"], "f": [0.5, 0.7]})
    return pl.concat([features(0, 1).clear(), rows], how="diagonal")


def densities(first: int, count: int) -> pl.DataFrame:
    values = np.arange(first, first + count, dtype=float)
    return pl.DataFrame(
        {
            "anchor": "task", "set_size": SIZE, "set_id": "working", "alternative_id": ids(first, count),
            "bandwidth": 0.1,
            "rows_scored": None, "bandwidth_error": None, "engine": "exact", "log_density": values,
        },
        schema_overrides={"rows_scored": pl.Int64, "bandwidth_error": pl.Float64},
    )  # fmt: skip


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., dict[str, Path]]:
    """Write tables in parts."""

    def write(**tables: list[pl.DataFrame]) -> dict[str, Path]:
        for name, parts in tables.items():
            with table_writer(tmp_path / f"{name}.parquet", name, {}) as writer:
                for part in parts:
                    writer.write(part)
        return {name: tmp_path / f"{name}.parquet" for name in tables}

    return write


def test_sets_are_found_across_parts_of_other_lengths(write: Callable[..., dict[str, Path]]) -> None:
    paths = write(
        features=[pl.concat([demonstrations(), features(0, 15)]), features(15, 25)],
        densities=[densities(0, 30), densities(30, 10)],
    )
    with TaskTables(paths) as tables:
        tables.check()
        (own,), (other,) = tables.contents("features").sets, tables.contents("densities").sets
        assert own.key == other.key == ("task", SIZE, "working")
        assert own.pieces == (Piece(0, 2, 15), Piece(1, 0, 25))
        assert other.between(29, 31) == (Piece(0, 29, 1), Piece(1, 0, 1))
        assert tables.contents("features").others == (Piece(0, 0, 2),)


def test_one_pass_reads_each_column_that_is_needed_once(
    write: Callable[..., dict[str, Path]], monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = write(features=[features(0, 20), features(20, 20)], densities=[densities(0, SIZE)])
    read: list[tuple[str, int, tuple[str, ...]]] = []
    plain: Callable[..., object] = OpenTable._raw

    def noted(table: OpenTable, number: int, names: tuple[str, ...]) -> object:
        read.append((table.contract.name, number, tuple(names)))
        return plain(table, number, names)

    monkeypatch.setattr(OpenTable, "_raw", noted)
    with TaskTables(paths) as tables:
        tables.check(whole=["densities"])
        keys = ("kind", "id", "anchor", "set_size", "set_id")
        assert read == [
            ("features", 0, keys), ("features", 1, keys),
            ("densities", 0, tuple(column.name for column in schema("densities").columns)),
        ]  # fmt: skip
        tables["densities"].read()
        assert len(read) == 3


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            [densities(0, 20), densities(20, 19)],
            r"features\.parquet: row 40 has id 'task/40/working/000039', .*densities",
        ),
        (
            [densities(0, 20), densities(20, 21)],
            r"densities\.parquet: row 41 has alternative_id 'task/40/working/000040'",
        ),
        (
            [densities(0, 20), densities(20, 20).with_columns(set_id=pl.lit("other"))],
            "row 21 has alternative_id 'task/40/working/000020', anchor 'task', set_size 40, set_id 'other', for which",
        ),
    ],
)  # fmt: skip
def test_a_row_without_its_counterpart_is_named(
    write: Callable[..., dict[str, Path]], parts: list[pl.DataFrame], message: str
) -> None:
    with TaskTables(write(features=[features(0, SIZE)], densities=parts)) as tables:
        with pytest.raises(TableError, match=message) as caught:
            tables.check()
        assert "make them again with `dvc repro`" in str(caught.value)


def test_the_order_of_rows_and_parts_does_not_matter(write: Callable[..., dict[str, Path]]) -> None:
    parts = [densities(30, 10).reverse(), densities(0, 30)]
    with TaskTables(write(features=[features(0, SIZE)], densities=parts)) as tables:
        tables.check()


def test_a_table_that_is_not_there_says_so_when_it_is_asked_for(tmp_path: Path) -> None:
    with TaskTables({"features": tmp_path / "features.parquet"}) as tables:
        assert list(tables) == ["features"]
        with pytest.raises(TableError, match="there is no such file; run the stage that makes it"):
            tables.check()
