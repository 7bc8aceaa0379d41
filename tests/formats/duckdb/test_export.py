"""Answers as files for other programs, written while they come."""

from __future__ import annotations

import csv
import io
import json
import tracemalloc
from pathlib import Path

import duckdb
import polars as pl
import pytest

from pipeline.errors import QueryError
from pipeline.formats.duckdb.export import write_csv, write_json, write_parquet
from pipeline.formats.duckdb.questions import asked


@pytest.fixture(scope="module")
def catalog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("exported") / "catalog.duckdb"
    with duckdb.connect(path) as con:
        con.execute("create table t as select range as id, [range, 2] as pair, 'x' as word from range(25000)")
    return path


KINDS = """select 1.5::double as number, -2 as whole, true as yes, '=1+1' as formula, null as nothing,
    [1.0::double, null] as list, {'a': [1]} as record, '2020-01-02'::date as day, 'é "q", ' || chr(10) || 'n' as text"""


@pytest.mark.parametrize("write", [write_csv, write_json, write_parquet])
def test_nothing_comes_as_an_empty_answer(catalog: Path, write: object) -> None:
    stream = io.BytesIO()
    with asked(catalog, "select id, pair from t where id < 0") as answer:
        write(answer, stream)  # type: ignore[operator]
    if write is write_csv:
        assert stream.getvalue() == b"id,pair\n"
    elif write is write_json:
        assert json.loads(stream.getvalue()) == []
    else:
        stream.seek(0)
        assert pl.read_parquet(stream).schema == {"id": pl.Int64, "pair": pl.List(pl.Int64)}


def test_every_kind_of_value(catalog: Path) -> None:
    texts = {}
    for write in (write_csv, write_json):
        stream = io.BytesIO()
        with asked(catalog, KINDS) as answer:
            write(answer, stream)
        texts[write] = stream.getvalue().decode()
    names, row = csv.reader(io.StringIO(texts[write_csv]))
    assert dict(zip(names, row, strict=True)) == {
        "number": "1.5", "whole": "-2", "yes": "true", "formula": "=1+1", "nothing": "", "list": "[1.0, null]",
        "record": '{"a": [1]}', "day": "2020-01-02", "text": 'é "q", \nn',
    }  # fmt: skip
    expected = {
        "number": 1.5, "whole": -2, "yes": True, "formula": "=1+1", "nothing": None, "list": [1.0, None],
        "record": {"a": [1]}, "day": "2020-01-02", "text": 'é "q", \nn',
    }  # fmt: skip
    assert json.loads(texts[write_json]) == [expected]
    assert texts[write_json] == json.dumps([expected], indent=1) + "\n"


@pytest.mark.parametrize("write", [write_csv, write_json, write_parquet])
def test_an_answer_of_many_batches_is_whole(catalog: Path, write: object) -> None:
    stream = io.BytesIO()
    with asked(catalog, "from t order by id") as answer:
        write(answer, stream)  # type: ignore[operator]
    stream.seek(0)
    read = {write_csv: pl.read_csv, write_json: pl.read_json, write_parquet: pl.read_parquet}[write]  # type: ignore[index]
    assert read(stream)["id"].to_list() == list(range(25_000))


class Counted(io.RawIOBase):
    """A stream that keeps nothing but how much was written at most at a time."""

    total = largest = 0

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        size = len(memoryview(data).cast("B"))  # type: ignore[arg-type]
        self.total, self.largest = self.total + size, max(self.largest, size)
        return size


@pytest.mark.parametrize("write", [write_csv, write_json, write_parquet])
def test_an_answer_is_never_held_whole(catalog: Path, write: object) -> None:
    stream = Counted()
    tracemalloc.start()
    with asked(catalog, "select id, random() as number, 'y' as word from t, range(6)") as answer:
        write(answer, stream)  # type: ignore[operator]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert stream.total > 1_200_000
    assert stream.largest < stream.total / 2
    assert peak < 20_000_000


@pytest.mark.parametrize("begin", ["=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠"])
def test_what_a_spreadsheet_would_calculate_can_be_made_text(catalog: Path, begin: str) -> None:
    code = "||".join(f"chr({ord(c)})" for c in begin)
    sql = f"""select {code} || '1' as a, 'b' || {code} as b, -1.5 as number, [{code}] as list, 1 as "{begin}c" """
    rows = {}
    for formulas in (True, False):
        stream = io.BytesIO()
        with asked(catalog, sql) as answer:
            write_csv(answer, stream, formulas=formulas)
        rows[formulas] = list(csv.reader(io.StringIO(stream.getvalue().decode(), newline="")))
    assert rows[True] == [
        ["a", "b", "number", "list", f"{begin}c"],
        [f"{begin}1", f"b{begin}", "-1.5", json.dumps([begin]), "1"],
    ]
    assert rows[False] == [
        ["a", "b", "number", "list", f"'{begin}c"], [f"'{begin}1", f"b{begin}", "-1.5", json.dumps([begin]), "1"],
    ]  # fmt: skip


def test_for_a_terminal_texts_are_plain(catalog: Path) -> None:
    stream = io.BytesIO()
    with asked(catalog, "select chr(27) || '[2J' as a, [chr(27)] as list, 1 as \"\x1b]0;x\x07\"") as answer:
        write_csv(answer, stream, for_terminal=True)
    assert stream.getvalue().decode().replace("\n", "").isprintable()
    assert "\\x1b[2J" in stream.getvalue().decode()


def test_what_parquet_has_not_is_said(catalog: Path) -> None:
    with asked(catalog, "select interval 1 month as i") as answer, pytest.raises(QueryError, match="::varchar"):
        write_parquet(answer, io.BytesIO())
