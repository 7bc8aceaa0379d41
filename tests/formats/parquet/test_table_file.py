"""The record that a job finds its table by: opened once in each process, and only the file that the stage opened."""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Iterator
from pathlib import Path

import polars as pl
import pytest

from pipeline.errors import TableError
from pipeline.formats.parquet import table_file
from pipeline.formats.parquet.checked import open_table
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.table_file import TableFile
from pipeline.formats.parquet.tables import write_table
from pipeline.formats.parquet.task_tables import TaskTables


def units(count: int) -> pl.DataFrame:
    about = {"kind": "height", "unit": "m", "direction": "cost", "over_time": "sum"}
    return pl.DataFrame({"feature": [f"f{number}" for number in range(count)], **about})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A small table."""
    write_table(tmp_path / "feature_units.parquet", "feature_units", units(3), {})
    return tmp_path / "feature_units.parquet"


@pytest.fixture(autouse=True)
def nothing_open() -> Iterator[None]:
    """No table is left open for jobs, before and after."""
    assert not table_file._open
    yield
    table_file._open.clear()


def on_a_worker(pickled: bytes) -> tuple[int, int]:
    """What a worker does, several jobs after each other: rows that it reads, and how often it opens a file."""
    opened = 0
    plain = open_table._open

    def counted(path: Path) -> object:
        nonlocal opened
        opened += 1
        return plain(path)

    open_table._open = counted  # type: ignore[assignment]
    rows = sum(pickle.loads(pickled).table().read().height for _ in range(5))
    return rows, opened


def test_in_the_process_of_the_stage_it_is_the_table_that_is_open(path: Path) -> None:
    with TaskTables({"feature_units": path}) as tables:
        file = tables.for_jobs("feature_units")
        assert file.table() is tables["feature_units"]
        assert pickle.loads(pickle.dumps(file)).table() is tables["feature_units"]
    assert not table_file._open


def test_a_worker_opens_a_table_once_for_all_jobs(path: Path) -> None:
    with TaskTables({"feature_units": path}) as tables:
        pickled = pickle.dumps(tables.for_jobs("feature_units"))
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            assert pool.apply(on_a_worker, (pickled,)) == (15, 1)


def test_a_file_that_was_replaced_is_not_taken_for_the_one_that_was_opened(path: Path) -> None:
    with OpenTable(path, "feature_units") as table:
        file = TableFile(path, "feature_units", table.digest)
    assert file.table().rows == 3
    write_table(path, "feature_units", units(4), {})
    assert file.table().rows == 3  # the one that is open
    table_file._open.clear()
    with pytest.raises(TableError, match="has changed since the stage began to read it; run the stage again"):
        file.table()


def test_few_tables_are_kept_open(tmp_path: Path) -> None:
    files = []
    for number in range(table_file.OPEN_AT_ONCE + 3):
        path = tmp_path / f"{number}.parquet"
        write_table(path, "feature_units", units(number + 1), {})
        with OpenTable(path, "feature_units") as table:
            files.append(TableFile(path, "feature_units", table.digest))
    first = files[0].table()
    assert [file.table().rows for file in files] == [number + 1 for number, _ in enumerate(files)]
    assert list(table_file._open) == files[3:]
    assert first.read().height == 1  # whoever still reads a table that was let go of can go on
