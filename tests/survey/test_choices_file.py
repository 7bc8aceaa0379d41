"""The file of choices grows by whole lines, and nothing in it is lost or counted twice."""

from pathlib import Path

import polars as pl
import pytest

from pipeline.errors import SurveyError
from pipeline.survey.assignment import Assignment
from pipeline.survey.choices_file import COLUMNS, ChoicesFile

ROW = dict.fromkeys(COLUMNS, "x") | {"participant": "p1", "trial": "control", "choice": "left"}
GIVEN = Assignment(("control",), True, 3)


def test_what_was_kept_is_there_after_a_restart(tmp_path: Path) -> None:
    first = ChoicesFile(tmp_path / "c.csv")
    first.assign("p1", GIVEN)
    first.choose(ROW)

    second = ChoicesFile(tmp_path / "c.csv")

    assert second.assigned == {"p1": GIVEN}
    assert second.chosen == {"p1": {"control": "left"}}


def test_a_second_choice_changes_nothing(tmp_path: Path) -> None:
    file = ChoicesFile(tmp_path / "c.csv")
    file.choose(ROW)
    before = file.path.read_bytes()

    file.choose(ROW | {"choice": "right"})
    ChoicesFile(tmp_path / "c.csv").choose(ROW | {"choice": "right"})

    assert file.path.read_bytes() == before


@pytest.mark.parametrize("kept", range(1, 40, 7))
def test_a_line_that_was_cut_off_is_taken_away(tmp_path: Path, kept: int) -> None:
    file = ChoicesFile(tmp_path / "c.csv")
    file.choose(ROW)
    whole = file.path.read_bytes()
    file.choose(ROW | {"participant": "p2"})
    file.path.write_bytes(file.path.read_bytes()[: len(whole) + kept].rstrip(b"\n"))

    again = ChoicesFile(tmp_path / "c.csv")
    assert again.path.read_bytes() == whole
    again.choose(ROW | {"participant": "p2"})
    assert pl.read_csv(again.path)["participant"].to_list() == ["p1", "p2"]


def test_a_file_of_something_else_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "thesis.txt"
    path.write_text("years of work\nno line end")

    with pytest.raises(
        SurveyError, match=r"thesis\.txt: is no file of this survey \(its columns are 'years of work'\)"
    ):
        ChoicesFile(path)

    assert path.read_text() == "years of work\nno line end"


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "c.csv").symlink_to(tmp_path / "elsewhere.csv")

    with pytest.raises(SurveyError, match="cannot be written"):
        ChoicesFile(tmp_path / "c.csv")

    assert not (tmp_path / "elsewhere.csv").exists()


def test_damaged_visits_are_named(tmp_path: Path) -> None:
    ChoicesFile(tmp_path / "c.csv").assign("p1", GIVEN)
    (tmp_path / "c.csv.visits").write_text('{"participant": 1}\n')

    with pytest.raises(SurveyError, match="line 1 is not what this survey writes; move the file away"):
        ChoicesFile(tmp_path / "c.csv")
