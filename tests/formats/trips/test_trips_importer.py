"""Trips from text files: what is read, and what is refused in one sentence."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from pipeline.errors import StageError
from pipeline.formats.trips.importer import ANGLES, STEPS, TIMES, TRIPS, read_trips
from tests.support.small_roads import MOVES, write_small_roads


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_small_roads(tmp_path / "roads")


def test_steps_have_their_features_and_trips_their_links_in_order(folder: Path) -> None:
    read = read_trips(folder)
    assert list(read.network.select("from_link", "to_link").iter_rows()) == MOVES
    assert read.network["left_turn"].to_list() == [1, 0, 0, 0, 0, 1, 0, 0, 0]
    assert read.network["u_turn"].to_list() == [0, 0, 1, 0, 1, 0, 0, 0, 0]
    assert read.network["link"].to_list() == [1] * 6 + [0] * 3
    assert read.observed["trip"].n_unique() == 40
    assert read.observed.filter(place=1)["link"].to_list() == [1] * 40


def test_the_order_of_lines_changes_nothing(folder: Path) -> None:
    before = read_trips(folder)
    for file in folder.iterdir():
        file.write_text("\n".join(reversed(file.read_text().splitlines())))
    after = read_trips(folder)
    assert before.network.equals(after.network)
    assert before.observed.equals(after.observed)


@pytest.mark.parametrize(
    ("file", "line", "message"),
    [
        (STEPS, "1 2", "three numbers"),
        (STEPS, "1 2 1", "twice"),
        (STEPS, "1 5 2", "other than 1"),
        (STEPS, "0 5 1", "whole numbers from 1"),
        (STEPS, "1.5 5 1", "whole numbers from 1"),
        (STEPS, "99999999999 5 1", "whole numbers from 1"),
        (TIMES, "1 5 nan", "finite"),
        (TIMES, "3 5 -1", "negative travel time"),
        (TIMES, "x y z", "three numbers"),
        (ANGLES, "3 5 90", "beyond pi"),
        (TRIPS, "61 1 5", "fewer than two links"),
        (TRIPS, "1 90 5", "leaves out a place"),
        (TRIPS, "61 1 5\n61 2 4\n61 3 6", "does not end at its destination"),
        (TRIPS, "61 1 4\n61 2 2\n61 3 4", "leads on"),
        (TRIPS, "61 1 5\n61 2 1\n61 3 5", "does not lead to"),
        (TRIPS, "61 1 5\n61 2 1.5\n61 3 5", "no whole number"),
        (TRIPS, "\u00e9", "no plain text"),
    ],
)
def test_hostile_files_are_refused(folder: Path, file: str, line: str, message: str) -> None:
    with (folder / file).open("a", encoding="utf-8") as stream:
        stream.write(line + "\n")
    with pytest.raises(StageError, match=message) as error:
        read_trips(folder)
    assert file in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_and_empty_files_are_refused(folder: Path) -> None:
    with pytest.raises(StageError, match="no such folder"):
        read_trips(folder / "nowhere")
    (folder / TIMES).write_text("")
    with pytest.raises(StageError, match="no entries"):
        read_trips(folder)
    (folder / TIMES).unlink()
    with pytest.raises(StageError, match="no such file"):
        read_trips(folder)


def test_the_published_network_has_its_size(shared: Path) -> None:
    read = read_trips(shared / "real" / "borlange")
    assert read.network["from_link"].n_unique() == 7288
    assert read.network.height == 21_452
    assert read.observed["trip"].n_unique() == 1832
    assert read.network.select(pl.sum("left_turn", "link", "u_turn")).row(0) == (4304, 20_196, 7100)
