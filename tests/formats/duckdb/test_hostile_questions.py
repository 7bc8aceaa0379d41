"""Questions that want to write, read files, reach the network, or take all time and memory: one sentence each."""

from __future__ import annotations

import hashlib
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import duckdb
import pytest

from pipeline.errors import QueryError
from pipeline.formats.duckdb import query_process
from pipeline.formats.duckdb.questions import ask

LIMIT_S = 1.0
NUMBERS = ",".join(map(str, range(120_000)))

DOING = [
    "create table t as select 1",
    "create temp table t as select 1",
    "create macro m() as 1",
    "insert into posteriors values (1, 2)",
    "update posteriors set beta = 2",
    "delete from posteriors",
    "drop table posteriors",
    "alter table posteriors add column c int",
    "copy posteriors to '{folder}/out.csv'",
    "copy (select 1) to '{folder}/out.parquet' (format parquet)",
    "export database '{folder}/out'",
    "import database '{folder}/out'",
    "attach '{folder}/other.db' as other",
    "attach ':memory:' as other",
    "install httpfs",
    "load httpfs",
    "load '{folder}/evil.duckdb_extension'",
    "set memory_limit = '100GB'",
    "set enable_external_access = true",
    "set lock_configuration = false",
    "reset memory_limit",
    "pragma memory_limit = '100GB'",
    "pragma database_list",
    "call enable_logging(storage = 'file')",
    "checkpoint",
    "vacuum",
    "begin",
    "use memory",
    "prepare q as select 1",
    "create secret (type s3)",
    "select 1; drop table posteriors",
    "select 1; select 2",
    "",
    ";",
    "-- nothing",
]
REACHING = [
    "from read_csv('/etc/passwd')",
    "from '/etc/passwd'",
    "from read_text('/etc/passwd')",
    "from read_blob('/etc/passwd')",
    "from glob('/*')",
    "from read_json('/etc/passwd')",
    "from read_parquet('{folder}/any.parquet')",
    "from sniff_csv('/etc/passwd')",
    "from read_duckdb('{folder}/../other.duckdb')",
    "from 'http://127.0.0.1:{port}/x.parquet'",
    "from read_csv('http://127.0.0.1:{port}/x.csv')",
    "from read_text('s3://bucket/key')",
    "select getenv('HOME')",
    "from sql",
    "from sys",
    "select load_extension('x')",
]
BLOWING_UP = [
    "select repeat('x', 1000000000) || repeat('y', 1000000000)",
    "select repeat('x', 1000000) from range(100000)",
    "from range(1000000000000)",
    "select count(*) from range(1000000000000)",
    "with recursive t(n) as (select 1 union all select n + 1 from t) select count(*) from t",
    "with recursive t(n) as (select 1 union all select n + 1 from t) from t",
    "select count(*) from range(1000000) a, range(1000000) b, range(1000000) c where a.range * b.range % 7 = c.range",
    "select count(*) from " + ", ".join(f"posteriors p{i}" for i in range(60)),
    "select list(range) from range(1000000000)",
    "select range from range(1000000000) order by hash(range)",
    "select generate_series(1, 1000000000000)",
    "select " + "(" * 50_000 + "1" + ")" * 50_000,
    "select " + "not " * 50_000 + "true",
    "select * from (" * 3000 + "select 1" + ")" * 3000,
    f"select id from posteriors where id in ({NUMBERS}) or id + 1 in ({NUMBERS[:200_000]}0)",
    "select 1 -- " + "x" * 5_000_000,
    "select '" + "\x1b]0;mine\x07" * 3 + "' + no_such_column",
]


@pytest.fixture(scope="module")
def catalog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("locked") / "folder" / "catalog.duckdb"
    path.parent.mkdir()
    with duckdb.connect(path) as con:
        con.execute("create table posteriors as select range as id, range / 10 as beta from range(1000)")
    with duckdb.connect(path.parents[1] / "other.duckdb") as con:
        con.execute("create table hidden as select 1")
    return path


def said(catalog: Path, question: str) -> tuple[str, float]:
    """What the refusal says, or `answered`, and how long it took."""
    began = time.perf_counter()
    try:
        ask(catalog, question, LIMIT_S)
    except QueryError as error:
        return str(error), time.perf_counter() - began
    return "answered", time.perf_counter() - began


def test_no_question_does_more_than_ask(catalog: Path) -> None:
    before = hashlib.sha256(catalog.read_bytes()).hexdigest()
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(2) as pool:
        server.settimeout(0.0)
        port = server.getsockname()[1]
        questions = [
            question.replace("{folder}", str(catalog.parent)).replace("{port}", str(port))
            for question in DOING + REACHING
        ]
        answers = list(pool.map(lambda question: said(catalog, question), questions))
        with pytest.raises(BlockingIOError):
            server.accept()
    for question, (sentence, _) in zip(questions, answers, strict=True):
        assert sentence != "answered", question
        assert "\n" not in sentence, question
        assert "root:" not in sentence
    assert hashlib.sha256(catalog.read_bytes()).hexdigest() == before
    assert [path.name for path in catalog.parent.iterdir()] == ["catalog.duckdb"]


def test_no_question_takes_more_than_its_time_and_memory(catalog: Path) -> None:
    for question in BLOWING_UP:
        sentence, seconds = said(catalog, question)
        assert "\n" not in sentence, question[:80]
        assert sentence != "answered" or "in (" in question, question[:80]
        assert len(sentence) < 1200
        assert seconds < LIMIT_S + query_process.GRACE_S + 20, question[:80]  # a busy machine starts processes slowly
    assert ask(catalog, "select count(*) as n from posteriors").item() == 1000


def test_the_process_that_answers_cannot_have_more_memory_than_stated(
    catalog: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import resource
    import subprocess
    import sys

    code = (
        "import resource; from pipeline.formats.duckdb import query_process; query_process._bound_memory();"
        "print(resource.getrlimit(resource.RLIMIT_AS)[0]); bytearray(query_process.ADDRESS_SPACE_BYTES)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert int(done.stdout) == query_process.ADDRESS_SPACE_BYTES
    assert "MemoryError" in done.stderr
    assert resource.getrlimit(resource.RLIMIT_AS)[0] != query_process.ADDRESS_SPACE_BYTES


@pytest.mark.parametrize(
    ("question", "rows"),
    [
        ("describe posteriors", 2),
        ("show tables", 1),
        ("summarize posteriors", 2),
        ("explain from posteriors", 1),
        ("with few as (from posteriors limit 3) from few", 3),
        ("values (1), (2)", 2),
        ("select 1::hugeint as a, [1, 2] as c, {'a': 1} as d, '2020-01-01'::date as e", 1),
    ],
)
def test_ordinary_questions_are_answered(catalog: Path, question: str, rows: int) -> None:
    assert ask(catalog, question).height == rows
