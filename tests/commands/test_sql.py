"""`lessbench sql`: answers in every form, and a prompt that a mistake does not end."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from prompt_toolkit.application import create_app_session
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput

from pipeline.commands import sql
from pipeline.commands.sql import Format, answer_once, candidates, prompt
from pipeline.errors import QueryError
from pipeline.formats.duckdb.catalog import build_catalog
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import write_table

COLUMNS = {"posteriors": {"theta": "weights", "beta": "strictness"}, "rejected": {"reason": "why"}}


@pytest.fixture
def catalog(tmp_path: Path) -> Path:
    table = pl.DataFrame(
        {
            "task": "a", "demonstration_id": "d", "participant": "[red]p[/]", "model": "less", "set_size": 10, "set_id": "00",
            "theta_id": [0, 1], "theta": pl.Series(np.eye(2)), "beta": 1.0, "log_posterior": np.log([0.25, 0.75]),
            "posterior": [0.25, 0.75],
        }
    )  # fmt: skip
    write_table(tmp_path / "posteriors.parquet", "posteriors", table, {})
    build_catalog(
        tmp_path / "catalog.duckdb", {"posteriors": [("a", OpenTable(tmp_path / "posteriors.parquet", "posteriors"))]}
    )
    return tmp_path / "catalog.duckdb"


QUESTION = "select participant, theta, posterior from posteriors order by posterior"


def test_an_answer_in_every_form(catalog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answer_once(catalog, QUESTION, Format.table)
    shown = capsys.readouterr().out
    assert "[red]p[/]" in shown
    assert "[0, 1]" in shown
    assert shown.endswith("2 rows\n")
    answer_once(catalog, QUESTION, Format.json)
    assert json.loads(capsys.readouterr().out)[1] == {
        "participant": "[red]p[/]",
        "theta": [0.0, 1.0],
        "posterior": 0.75,
    }
    answer_once(catalog, QUESTION, Format.csv)
    table = pl.read_csv(io.StringIO(capsys.readouterr().out))
    assert table.row(0) == ("[red]p[/]", "[1.0, 0.0]", 0.25)


def test_an_answer_as_parquet(catalog: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "answer.parquet").open("w") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        answer_once(catalog, QUESTION, Format.parquet)
    assert pl.read_parquet(tmp_path / "answer.parquet")["theta"].to_list() == [[1.0, 0.0], [0.0, 1.0]]


def test_parquet_is_not_thrown_on_a_terminal(catalog: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    with pytest.raises(QueryError, match=r"> answer\.parquet"):
        answer_once(catalog, QUESTION, Format.parquet)


def test_without_a_question_it_says_what_there_is(catalog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answer_once(catalog, None, Format.table)
    shown = capsys.readouterr().out
    assert "best_hypothesis" in shown
    assert "Whose demonstration says something else?\n    from people_against_group" in shown


def test_a_mistake_is_one_sentence_and_the_prompt_goes_on(catalog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    history = catalog.parent / "kept" / "history"
    before = catalog.read_bytes()
    typed = ["selec 1", "drop table posteriors", "", "from posteriors limit 1;", "help", "exit", "never asked"]
    with create_pipe_input() as keys, create_app_session(input=keys, output=DummyOutput()):
        keys.send_text("".join(f"{line}\n" for line in typed))
        prompt(catalog, history)
    lines = capsys.readouterr().out.splitlines()
    assert sum("syntax error" in line for line in lines) == 1
    assert sum("would do more than ask" in line for line in lines) == 1
    assert "1 row" in lines
    assert "Questions to begin with:" in lines
    assert catalog.read_bytes() == before
    assert "+from posteriors limit 1;" in history.read_text()
    assert "never" not in history.read_text()


def test_the_prompt_ends_with_its_input(catalog: Path) -> None:
    with create_pipe_input() as keys, create_app_session(input=keys, output=DummyOutput()):
        keys.send_text("\x04")
        prompt(catalog, catalog.parent / "history")


def test_a_question_that_takes_long_can_be_stopped(
    catalog: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sql, "answer_once", interrupted)
    sql._answer_or_say_why(catalog, "from posteriors")
    assert capsys.readouterr().out == "stopped\n"


@pytest.mark.parametrize(
    ("before", "whole", "offered", "not_offered"),
    [
        ("", "", {"select", "from", "help"}, {"theta"}),
        ("from ", "from ", {"posteriors", "rejected"}, {"theta", "select"}),
        ("select x from a JOIN ", "select x from a JOIN ", {"rejected"}, {"beta"}),
        ("select ", "select  from rejected", {"reason", "count"}, {"theta"}),
        ("select ", "select ", {"reason", "theta"}, set()),
        ("from posteriors where ", "from posteriors where ", {"theta", "beta", "and"}, {"reason"}),
    ],
)
def test_completion_knows_tables_and_their_columns(
    before: str, whole: str, offered: set[str], not_offered: set[str]
) -> None:
    found = candidates(COLUMNS, before, whole)
    assert offered <= set(found)
    assert not not_offered & set(found)
    assert candidates(COLUMNS, "select ", "select ")["beta"] == "strictness"
