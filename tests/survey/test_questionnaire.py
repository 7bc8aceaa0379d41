"""What a study may ask, and what is said of a file that is none."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from pipeline.errors import SurveyError
from pipeline.survey.questionnaire import PAPER, TURNED, cells_of, read_questionnaire

GRID = "grid: {columns: 3, rows: 3, start: [0, 0], goal: [2, 2], obstacles: [[1, 1]]}"
STUDY = f"""
title: Which?
trials:
  control:
    {GRID}
    options: {{over: {{moves: UURR}}, under: {{moves: RRUU}}}}
"""


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "study.yaml"
        path.write_text(text)
        return path

    return write


def test_the_papers_study_is_as_the_paper_says() -> None:
    control, experimental = (read_questionnaire(PAPER).trials[name] for name in ("control", "experimental"))

    assert [option.group or name for name, option in experimental.options.items()][:4] == ["left", *["right"] * 3]
    fair = {name: option.moves for name, option in experimental.options.items() if not option.attention}
    turns = {name: sum(a != b for a, b in pairwise(moves)) for name, moves in fair.items()}
    assert {len(moves) for moves in fair.values()} == {12}, "equally many cells"
    assert set(turns.values()) == {3}, "equally many turns"
    blocked = set(experimental.grid.obstacles)
    assert not any(blocked & set(cells_of(experimental.grid, moves)) for moves in fair.values())
    rightmost = {
        name: sum(column == 6 for column, _ in cells_of(experimental.grid, moves)) for name, moves in fair.items()
    }
    assert max(rightmost, key=rightmost.get) == "R2", "R2 visits the most cells of the last column"
    assert control.options["left"].moves == control.options["right"].moves.translate(TURNED), "symmetric"
    through = control.options["through"]
    assert through.attention
    assert len(through.moves) > 12
    assert blocked & set(cells_of(control.grid, through.moves))


def test_mirrored_paths_run_through_the_mirrored_grid() -> None:
    trial = read_questionnaire(PAPER).trials["experimental"]

    for option in trial.options.values():
        there = cells_of(trial.grid, option.moves)
        mirrored = cells_of(trial.grid.mirrored(), option.moves.translate(TURNED))
        assert mirrored == [(row, column) for column, row in there]


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("UURR", "UURRR", "option over: the path leaves the grid"),
        ("UURR", "UUR", "option over: the path ends at (1, 2) and not at the goal (2, 2)"),
        ("UURR", "UUXR", "trials.control.options.over.moves: String should match pattern"),
        ("title: Which?", "titel: Which?", "title: Field required"),
        (f"    {GRID}\n", "", "a trial has either a `grid` or a `task`"),
        ("{moves: UURR}", "{alternative: a-1}", "option over: moves need a `grid`, an alternative needs a `task`"),
        (", under: {moves: RRUU}", "", "at least 2 items"),
        ("{moves: RRUU}", "{moves: RRUU, attention: true}, third: {moves: UURR, atention: true}", "atention"),
        ("over:", "<script>:", "String should match pattern"),
        (STUDY, "[1, 2", "is not readable YAML"),
        (STUDY, "&a [*a]", "study.yaml"),
    ],
)
def test_a_file_that_is_no_study(written: Callable[[str], Path], before: str, after: str, said: str) -> None:
    with pytest.raises(SurveyError, match=r"study\.yaml") as error:
        read_questionnaire(written(STUDY.replace(before, after)))

    assert said in str(error.value)


def test_a_study_of_attention_tests_alone(written: Callable[[str], Path]) -> None:
    text = STUDY.replace("UURR}", "UURR, attention: true}").replace("RRUU}", "RRUU, attention: true}")

    with pytest.raises(SurveyError, match="no choice would count"):
        read_questionnaire(written(text))
