"""What is sent is checked before anything is kept."""

from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.studies.human_choice import analyse_choices
from pipeline.survey.choices_file import ChoicesFile
from pipeline.survey.questionnaire import PAPER, read_questionnaire
from pipeline.survey.visits import RefusedError, Visits


@pytest.fixture
def visits(tmp_path: Path) -> Visits:
    return Visits(read_questionnaire(PAPER), ChoicesFile(tmp_path / "c.csv"), lambda trial, option: None)


def choice(step: dict[str, Any], option: str) -> dict[str, Any]:
    return {"code": step["code"], "trial": step["trial"], "option": option, "seconds": 2.5, "screen": [390, 844]}


def test_from_entering_to_thanks(visits: Visits) -> None:
    step: Any = visits.enter({"code": "p1"})
    assert step["trial"] == "control"
    assert [option["name"] for option in step["options"]] == ["left", "right", "through"]

    assert visits.choose(choice(step, "right")) == {"code": "p1", "done": True}

    row = pl.read_csv(visits.file.path).row(0, named=True)
    assert row["participant"] == "p1"
    assert (row["trial"], row["choice"], row["group"], row["counted"]) == ("control", "right", "right", "yes")
    assert row["offered"] == "left=left right=right through="
    assert (row["seconds"], row["screen_width"], row["screen_height"]) == (2.5, 390, 844)


def test_coming_back_shows_the_same_until_it_is_done(visits: Visits) -> None:
    first = visits.enter({"code": "p1"})
    visits.enter({"code": "p2"})

    assert visits.enter({"code": "p1"}) == first
    again = Visits(visits.questionnaire, ChoicesFile(visits.file.path), visits.clip)
    assert again.enter({"code": "p1"}) == first, "after a restart too"


def test_the_second_of_two_choices_is_none(visits: Visits) -> None:
    step: Any = visits.enter({"code": "p1"})
    visits.choose(choice(step, "left"))

    assert visits.choose(choice(step, "right"))["done"]

    assert pl.read_csv(visits.file.path)["choice"].to_list() == ["left"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"option": "R1"}, "this option is not on offer"),
        ({"option": ""}, "this option is not on offer"),
        ({"option": 3}, "option is a short text"),
        ({"option": "x" * 1000}, "option is a short text"),
        ({"trial": "experimental"}, "this question was not asked"),
        ({"trial": "../../etc/passwd"}, "this question was not asked"),
        ({"code": "p2"}, "this code is not known"),
        ({"code": "=cmd()"}, "this code is not known"),
        ({"seconds": -1}, "seconds is a number from 0 to 86400"),
        ({"seconds": float("nan")}, "seconds is a number"),
        ({"seconds": float("inf")}, "seconds is a number"),
        ({"seconds": True}, "seconds is a number"),
        ({"seconds": "1"}, "seconds is a number"),
        ({"screen": [1]}, "screen is"),
        ({"screen": [1, 1e9]}, "screen is a number"),
        ({"screen": None}, "screen is"),
        ({"more": 1}, "and nothing else"),
    ],
)
def test_what_is_not_accepted_leaves_no_trace(visits: Visits, change: dict[str, Any], said: str) -> None:
    step: Any = visits.enter({"code": "p1"})
    before = visits.file.path.read_bytes(), visits.file.visits_path.read_bytes()

    with pytest.raises(RefusedError, match=said):
        visits.choose(choice(step, "left") | change)

    assert (visits.file.path.read_bytes(), visits.file.visits_path.read_bytes()) == before


NO_CODES = [None, [], "p1", {"code": "p1", "x": 1}]
NO_CODES += [{"code": code} for code in ("", "a,b", "a\nb", "-1", "é", "a" * 65, 1)]


@pytest.mark.parametrize("sent", NO_CODES)
def test_codes_that_are_none(visits: Visits, sent: object) -> None:
    with pytest.raises(RefusedError):
        visits.enter(sent)

    assert not visits.file.assigned


def test_the_study_of_section_3_reads_the_file_as_it_is(visits: Visits) -> None:
    for person in range(60):
        step: Any = visits.enter({"code": f"p{person}"})
        options = ["through", "L", "R1"] if step["trial"] == "experimental" else ["through", "left", "right"]
        visits.choose(choice(step, options[0] if person < 4 else options[1 + person % 3 // 2]))

    study = analyse_choices(pl.read_csv(visits.file.path, infer_schema=False))

    assert study.control["count"].sum() == 28, "two of thirty failed the attention test"
    options = study.predictions.filter(pl.col("comparison") == "options", pl.col("model") == "less")
    assert options["option"].to_list() == ["L", "R1", "R2", "R3"], "also those that nobody chose"
    assert options["count"].to_list()[2:] == [0, 0]
