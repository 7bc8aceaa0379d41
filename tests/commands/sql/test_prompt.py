"""The prompt of `lessbench sql`: a mistake does not end it, and it knows the habits of other prompts."""

from __future__ import annotations

import os
from pathlib import Path

import polars as pl
import pytest
from prompt_toolkit.application import create_app_session
from prompt_toolkit.document import Document
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput

from pipeline.commands.sql import prompt as module
from pipeline.commands.sql.answers import Wanted
from pipeline.commands.sql.prompt import candidates, prompt
from pipeline.errors import StageError
from pipeline.formats.duckdb.catalog import build_catalog
from pipeline.formats.files.links import keep_inside
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import write_table
from schemas import schema

COLUMNS = {"posteriors": {"theta": "weights", "beta": "strictness"}, "rejected": {"reason": "why"}}


@pytest.fixture
def catalog(tmp_path: Path) -> Path:
    table = pl.DataFrame({"source": ["a.mcap", "b.mcap"], "reason": "truncated", "detail": "It ends too soon."})
    write_table(tmp_path / "rejected.parquet", "rejected", table, {})
    with OpenTable(tmp_path / "rejected.parquet", "rejected") as rejected:
        build_catalog(tmp_path / "catalog.duckdb", {"rejected": [("t", rejected)]})
    return tmp_path / "catalog.duckdb"


def typed(catalog: Path, keys: str) -> None:
    with create_pipe_input() as pipe, create_app_session(input=pipe, output=DummyOutput()):
        pipe.send_text(keys)
        prompt(catalog, catalog.parent / "kept" / "history")


def test_a_mistake_is_one_sentence_and_the_prompt_goes_on(catalog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = catalog.read_bytes()
    questions = ["selec 1;", "drop table rejected;", "", "from rejected limit 1;", "help", "exit", "never asked;"]
    typed(catalog, "".join(f"{line}\n" for line in questions))
    lines = capsys.readouterr().out.splitlines()
    assert sum("syntax error" in line for line in lines) == 1
    assert sum("would do more than ask" in line for line in lines) == 1
    assert "1 row" in lines
    assert "Questions to begin with:" in lines
    assert catalog.read_bytes() == before
    history = (catalog.parent / "kept" / "history").read_text()
    assert "+from rejected limit 1;" in history
    assert "never" not in history


@pytest.mark.parametrize(
    "keys",
    [
        "select count(*) as n\nfrom rejected;\n",
        "select count(*) as n\nfrom rejected\n\n",  # an empty line ends it as well
        "select count(*) as n\nfrom rejected\nwhere reason = ';'\nor true\n;\n",
        "select count(*) as n from rejected ; \n",
    ],
)
def test_a_question_goes_over_several_lines(catalog: Path, capsys: pytest.CaptureFixture[str], keys: str) -> None:
    typed(catalog, keys + "\\q\n")
    lines = capsys.readouterr().out.splitlines()
    assert "│ 2 │" in lines
    assert lines[-1] == "1 row"


@pytest.mark.parametrize("leave", ["exit\n", "quit\n", "\\q\n", ".exit\n", ".quit\n", "EXIT\n", "exit;\n", "\x04"])
def test_every_habit_leaves_it(catalog: Path, leave: str) -> None:
    typed(catalog, leave)


@pytest.mark.parametrize("command", ["help", "\\?", ".help", ".tables", "\\d", "\\dt", ".tables;"])
def test_what_there_is(catalog: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    typed(catalog, f"{command}\nexit\n")
    shown = capsys.readouterr().out
    assert "rejected" in shown
    assert f"each row: {schema('rejected').row}" in " ".join(shown.replace("│", " ").split())
    if "table" not in command and "d" not in command:
        assert ".once" in shown


@pytest.mark.parametrize("command", [".schema rejected", "\\d rejected", "\\d  REJECTED;"])
def test_columns_of_a_table(catalog: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    typed(catalog, f"{command}\nexit\n")
    shown = capsys.readouterr().out
    assert "VARCHAR" in shown
    (detail,) = [column for column in schema("rejected").columns if column.name == "detail"]
    assert detail.description in " ".join(shown.replace("│", " ").split())


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (".schema nothing", "there is no table or view nothing"),
        (".schema it's", "there is no table or view it's"),
        (".schema", "there is no command `.schema`"),
        (".rows 0", "there is no command `.rows 0`"),
        (".rows many", "there is no command"),
        (".once", "there is no command"),
        ("\\x", "`help` explains them"),
        (".once answer.xlsx\nfrom rejected;", ".csv, .json or .parquet"),
    ],
)
def test_a_command_that_is_none(catalog: Path, capsys: pytest.CaptureFixture[str], command: str, said: str) -> None:
    typed(catalog, f"{command}\nexit\n")
    assert said in capsys.readouterr().out.splitlines()[-1]


def test_more_rows_and_a_file(catalog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = catalog.parent / "answer.csv"
    typed(catalog, f".rows 1\nfrom rejected;\n.once {path}\nfrom rejected;\nfrom rejected;\nexit\n")
    lines = capsys.readouterr().out.splitlines()
    cut = "the first 1 of 2 rows; `.rows 10` shows more, `.once answer.csv` writes all of the next answer"
    assert lines.count(cut) == 2
    assert f"{path}: written" in lines
    assert pl.read_csv(path).height == 2


def test_a_question_that_takes_long_can_be_stopped(
    catalog: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "answer_once", interrupted)
    wanted = Wanted()
    assert module._answer_or_say_why(catalog, "from posteriors", wanted) is wanted
    assert capsys.readouterr().out == "stopped\n"


@pytest.mark.parametrize("kind", ["link", "folder link", "hard link", "fifo"])
def test_what_was_asked_is_written_nowhere_else(catalog: Path, tmp_path: Path, kind: str) -> None:
    project, outside = tmp_path / "project", tmp_path / "outside"
    (project / "kept").mkdir(parents=True)
    outside.mkdir()
    (outside / "history").write_text("mine\n")
    keep_inside(project)
    if kind == "folder link":
        (project / "kept").rmdir()
        (project / "kept").symlink_to(outside)
    elif kind == "link":
        (project / "kept" / "history").symlink_to(outside / "history")
    elif kind == "hard link":
        os.link(outside / "history", project / "kept" / "history")
    else:
        os.mkfifo(project / "kept" / "history")
    with create_pipe_input() as pipe, create_app_session(input=pipe, output=DummyOutput()):
        pipe.send_text("select 1;\nexit\n")
        with pytest.raises(StageError, match="nothing was written"):
            prompt(catalog, project / "kept" / "history")
    assert (outside / "history").read_text() == "mine\n"


@pytest.mark.parametrize(
    ("before", "whole", "offered", "not_offered"),
    [
        ("", "", {"select", "from", "help", ".tables"}, {"theta"}),
        ("from ", "from ", {"posteriors", "rejected"}, {"theta", "select"}),
        (".schema ", ".schema ", {"posteriors", "rejected"}, {"theta", "select"}),
        ("\\d ", "\\d ", {"posteriors", "rejected"}, {"theta", "select"}),
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


def test_completion_offers_nothing_that_a_terminal_obeys() -> None:
    names = pl.DataFrame(
        {
            "table": ["t", "t", "\x1b[2J"],
            "column": ["good", "bad\x1b]0;x\x07", "c"],
            "meaning": ["a\x1b[2J\u202e", "b", "c"],
        }
    )
    completer = module._completer(names)
    for text in ("", "from ", "select ", ".", "select g"):
        for found in completer.get_completions(Document(text), None):  # type: ignore[arg-type]
            assert found.text.isprintable()
            assert found.display_meta_text.isprintable()
    texts = {found.text for found in completer.get_completions(Document("."), None)}  # type: ignore[arg-type]
    assert texts == {".tables", ".schema", ".rows", ".once"}
