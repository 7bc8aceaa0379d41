"""Answers come as they are found, and are not longer than their process; little memory is nobody's question's fault."""

from __future__ import annotations

import itertools
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import duckdb
import pytest

from pipeline import machine_memory as memory
from pipeline.errors import QueryError
from pipeline.formats.duckdb import query_process, questions
from pipeline.formats.duckdb.questions import ask, asked


@pytest.fixture(scope="module")
def catalog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("asked") / "catalog.duckdb"
    with duckdb.connect(path) as con:
        con.execute("create table t as select range as id, [range, 2] as pair from range(100000)")
    return path


def processes() -> set[int]:
    """The children of this process."""
    listed = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
    return set(map(int, listed.read_text().split())) if listed.exists() else set()


def test_an_answer_without_end_begins_at_once_and_ends_when_it_is_left(catalog: Path) -> None:
    before = processes()
    with asked(catalog, "from range(1000000000000)") as answer:
        frames = list(itertools.islice(answer.frames(), 4))
    assert frames[0].is_empty()
    assert [frame.row(0) for frame in frames[1:]] == [(0,), (10_000,), (20_000,)]
    assert processes() <= before


def test_a_clock_runs_only_while_it_is_let() -> None:
    stopped: list[bool] = []
    clock = query_process.Clock(1000.0, lambda: stopped.append(True))
    with clock.running():
        pass
    assert 999 < clock._left <= 1000
    assert not clock.over
    clock = query_process.Clock(0.01, lambda: stopped.append(True))
    with clock.running():
        while not clock.over:
            pass
    assert stopped == [True]


def taken(catalog: Path, sql: str, limit_s: float = 60.0, at_each: Callable[[], None] = lambda: None) -> int:
    """How many rows come."""
    rows = 0
    with asked(catalog, sql, limit_s) as answer:
        for batch in answer.batches():
            rows += batch.num_rows
            at_each()
    return rows


@pytest.mark.parametrize(
    ("sql", "said"),
    [
        ("select case when id = 99999 then error('at the end') else id end as id from t", "at the end"),
        ("select id, repeat('x', 1000 * (id // 100)) as long from t", "more (memory|than 2 s)"),
        ("select count(*) over (order by id, b.range) as n from t, range(100000) b", "more (memory|than 2 s)"),
    ],
)
def test_a_question_that_fails_on_the_way_is_not_an_answer(catalog: Path, sql: str, said: str) -> None:
    with pytest.raises(QueryError, match=said):
        taken(catalog, sql, 2.0)


def test_a_process_that_is_ended_is_not_an_answer(catalog: Path) -> None:
    before = processes()

    def end() -> None:
        for child in processes() - before:
            os.kill(child, signal.SIGKILL)  # as the system does when memory is scarce

    with pytest.raises(QueryError, match="too little memory here"):
        taken(catalog, "from range(1000000000)", at_each=end)


def test_the_folder_that_a_question_is_asked_in_holds_no_modules_for_it(
    catalog: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("duckdb", "pyarrow", "pipeline", "json", "threading", "sitecustomize"):
        (tmp_path / f"{module}.py").write_text("open('ran', 'w')\nraise SystemExit(9)\n")
    monkeypatch.chdir(tmp_path)
    assert ask(catalog, "select count(*) as n from t").item() == 100_000
    assert not (tmp_path / "ran").exists()


LITTLE = """
import sys
from pathlib import Path
from pipeline.errors import QueryError
from pipeline.formats.duckdb.questions import ask
try:
    print(ask(Path(sys.argv[1]), sys.argv[2]).item())
except QueryError as error:
    print(error)
"""


@pytest.mark.parametrize("megabytes", [300, 1500, 2400])
def test_little_memory_is_not_the_fault_of_the_question(catalog: Path, megabytes: int) -> None:
    size = megabytes << 20
    done = subprocess.run(
        [sys.executable, "-c", LITTLE, catalog, "select 1"], capture_output=True, text=True, timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert f"(the limit on the memory of a program (`ulimit -v`) is {megabytes:,} MB, and" in done.stdout
    assert "the question took" not in done.stdout


@pytest.mark.parametrize(
    ("limit", "free", "left", "said"),
    [
        (None, None, None, None),
        (8 << 30, 8 << 30, 8 << 30, None),
        (1 << 30, 8 << 30, 8 << 30, "ulimit -v"),
        (8 << 30, 1 << 29, 8 << 30, "free on this machine"),
        (8 << 30, 8 << 30, 1 << 29, "left to this container"),
    ],
)
def test_what_is_lacking_is_named(
    monkeypatch: pytest.MonkeyPatch, limit: int | None, free: int | None, left: int | None, said: str | None
) -> None:
    for name, value in (("_limit", limit), ("_free", free), ("_left_to_container", left)):
        monkeypatch.setattr(memory, name, lambda value=value: value)
    found = memory.too_little(4 << 30, 1 << 30, "a question")
    assert found is None if said is None else said in str(found)


@pytest.mark.parametrize("status", [query_process.OUT_OF_MEMORY, -signal.SIGABRT, 1])
def test_whose_fault_it_is_depends_on_what_there_was(monkeypatch: pytest.MonkeyPatch, status: int) -> None:
    monkeypatch.setattr(questions, "too_little", lambda *_: None)
    assert "the question took more memory" in questions._without_memory(status)
    monkeypatch.setattr(questions, "too_little", lambda *_: "what is free on this machine is 10 MB")
    assert "the question" not in questions._without_memory(status)
