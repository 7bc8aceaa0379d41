"""Rows as people read them: beside each other where they fit, below each other where they do not."""

from __future__ import annotations

import polars as pl
import pytest

from pipeline.commands.sql.layout import LONGEST_CELL, WIDTH_IN_A_PIPE, Page

WIDE = pl.DataFrame({f"column_{number}": [f"value-{number}", f"other-{number}"] for number in range(20)})


def test_what_fits_is_a_table() -> None:
    page = Page(pl.DataFrame({"a": [1, None], "b": ["x", "y"], "c": [[1.0, 0.25], None]}), False)
    assert page.fits
    lines = page.drawn().splitlines()
    assert lines[1].split("┃")[1:-1] == [" a ", " b ", " c         "]
    assert lines[3].split("│")[1:-1] == [" 1 ", " x ", " [1, 0.25] "]
    assert lines[4].split("│")[1:-1] == ["   ", " y ", "           "]


def test_what_is_too_wide_is_below_each_other() -> None:
    page = Page(WIDE, False)
    assert not page.fits
    lines = page.drawn().splitlines()
    assert lines[0].startswith("row 1 ──")
    assert lines[1] == "column_0   value-0"
    assert lines[20] == "column_19  value-19"
    assert lines[21].startswith("row 2 ──")
    assert len(lines) == 42


@pytest.mark.parametrize("on_terminal", [False, True])
def test_a_terminal_has_the_width_it_has(monkeypatch: pytest.MonkeyPatch, on_terminal: bool) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    rows = WIDE.select("column_0", "column_1", "column_2", "column_3")
    assert Page(rows, on_terminal).fits is not on_terminal


def test_sentences_go_on_in_the_next_line_and_numbers_do_not() -> None:
    sentence = "many words " * 40
    page = Page(pl.DataFrame({"what": [sentence], "list": [[0.123] * 10]}), False)
    assert page.fits
    drawn = page.drawn()
    assert "[" + ", ".join(["0.123"] * 10) + "]" in drawn
    assert max(map(len, drawn.splitlines())) <= WIDTH_IN_A_PIPE
    assert not Page(pl.DataFrame({"list": [[0.123] * 50]}), False).fits


def test_a_cell_is_bounded_and_plain() -> None:
    page = Page(pl.DataFrame({"a\x1b]0;x\x07": ["x" * 5000], "b": ["[red]\x1b[2J\u202e\n\x9b"]}), False)
    drawn = page.drawn()
    assert drawn.replace("\n", "").isprintable()
    assert "[red]\\x1b[2J\\u202e\\n\\x9b" in drawn
    assert drawn.count("x" * 100) < LONGEST_CELL / 100
    assert " [...] " in drawn


def test_nothing_is_still_a_table() -> None:
    assert Page(pl.DataFrame(schema={"a": pl.Int64}), False).drawn().count("\n") >= 3
