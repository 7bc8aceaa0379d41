"""A database is the file of its name: no log beside it and no character of its folders' names changes that."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import duckdb
import pytest

from pipeline.errors import StageError
from pipeline.formats.duckdb.database_file import new_database, readable_database
from pipeline.formats.duckdb.questions import ask

KILLED = """
import duckdb, os, sys
con = duckdb.connect(sys.argv[1])
con.execute("create table of_somebody_else as select 1")
os._exit(1)
"""


def make(path: Path, value: int) -> None:
    with new_database(path) as partial, duckdb.connect(partial, config={"enable_external_access": False}) as con:
        con.execute(f"create table t as select {value} as v")


def leave_a_log(path: Path) -> Path:
    """What a program leaves beside its database when it is killed."""
    done = subprocess.run([sys.executable, "-c", KILLED, path], timeout=60)
    assert done.returncode == 1
    return path.with_name(f"{path.name}.wal")


@pytest.fixture(params=["of another database", "of the one before", "rubbish", "empty"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A `.wal` beside the catalog."""
    path = tmp_path / "catalog.duckdb"
    left = path.with_name(f"{path.name}.wal")
    if request.param == "of another database":
        leave_a_log(tmp_path / "other.duckdb").replace(left)
    elif request.param == "of the one before":
        make(path, 1)
        leave_a_log(path)
    else:
        left.write_bytes(b"rubbish" * 100 if request.param == "rubbish" else b"")
    return left


def test_a_stale_log_never_blocks_the_next_database(log: Path) -> None:
    path = log.with_suffix("")
    make(path, 2)
    assert not log.exists()
    with duckdb.connect(path, read_only=True) as con:
        assert con.execute("from t").fetchall() == [(2,)]
        assert len(con.execute("show tables").fetchall()) == 1


def test_a_log_that_comes_later_is_not_read(log: Path, tmp_path: Path) -> None:
    path, content = log.with_suffix(""), log.read_bytes()
    make(path, 3)
    log.write_bytes(content)
    before = sorted(tmp_path.iterdir())
    assert ask(path, "from t").item() == 3
    assert ask(path, "show tables").height == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("folder", ["a?b", "*", "run[1]", "beta=10", "it's", "{a,b}", "a b", "http:", "\x1b"])
def test_a_folder_is_a_folder_whatever_it_is_called(tmp_path: Path, folder: str) -> None:
    path = tmp_path / folder / "deeper" / "catalog.duckdb"
    make(path, 4)
    assert ask(path, "from t").item() == 4
    assert ask(path, "select current_database()").item() == "catalog"
    assert list(path.parent.iterdir()) == [path]


def test_what_was_there_stays_if_it_fails(tmp_path: Path) -> None:
    path = tmp_path / "a?b" / "catalog.duckdb"
    make(path, 5)
    with pytest.raises(StageError, match="cannot be written"), new_database(path):
        raise OSError(28, "No space left on device")
    assert ask(path, "from t").item() == 5
    assert list(path.parent.iterdir()) == [path]


def test_it_is_read_in_place_where_it_can_be(tmp_path: Path) -> None:
    make(tmp_path / "catalog.duckdb", 6)
    with readable_database(tmp_path / "catalog.duckdb") as path:
        assert path == (tmp_path / "catalog.duckdb").resolve()
