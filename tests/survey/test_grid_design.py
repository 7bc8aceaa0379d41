"""Designs of the study of section 3: the numbers of paths against all others, and the paths themselves."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from pipeline.errors import SurveyError
from pipeline.survey.grid_design import grid_design
from pipeline.survey.questionnaire import PAPER, Grid, cells_of, read_questionnaire

THROUGH = "RRRUUULUUURRRR"
GRID = read_questionnaire(PAPER).trials["control"].grid
assert GRID is not None


def told(left: int, right: int) -> float:
    """What a choice tells about the model, mean over shares of the left side, with plain sums over options."""
    values = []
    for share in (np.arange(99) + 1) / 100:
        rewards = [share] * left + [1 - share] * right
        boltzmann = [reward / sum(rewards) for reward in rewards]
        less = [share / left] * left + [(1 - share) / right] * right
        middle = [(p + q) / 2 for p, q in zip(boltzmann, less, strict=True)]
        pairs = [*zip(boltzmann, middle, strict=True), *zip(less, middle, strict=True)]
        values.append(sum(p * np.log(p / m) for p, m in pairs) / 2)
    return float(np.mean(values))


@pytest.mark.parametrize("options", [3, 4, 6, 9])
def test_no_other_split_tells_more(options: int) -> None:
    made = grid_design(GRID, THROUGH, options, 3, np.random.default_rng(0))
    assert made.left + made.right == options
    assert made.about_model == pytest.approx(told(made.left, made.right), abs=1e-12)
    # the grid has at least that many paths on either side
    assert made.about_model == pytest.approx(max(told(a, options - a) for a in range(1, options)), abs=1e-12)


def test_paths_are_alike_in_length_and_turns_and_differ_from_one_another() -> None:
    trials = grid_design(GRID, THROUGH, 6, 3, np.random.default_rng(0)).questionnaire.trials
    paths = {name: str(option.moves) for name, option in trials["experimental"].options.items() if option.group}
    assert len(set(paths.values())) == 6
    blocked = {tuple(cell) for cell in GRID.obstacles}
    for name, moves in paths.items():
        assert len(moves) == 12
        assert sum(one != other for one, other in pairwise(moves)) == 3
        cells = cells_of(GRID, moves)
        assert not blocked.intersection(cells)
        # what passes the obstacles on the left is above them where they begin
        assert (name[0] == "L") == (max(row for column, row in cells if column == 2) > 4)
    assert trials["control"].options["right"].moves == paths["R1"]
    again = grid_design(GRID, THROUGH, 6, 3, np.random.default_rng(0)).questionnaire
    assert again.trials == trials


def test_grids_without_a_question_are_refused() -> None:
    with pytest.raises(SurveyError, match="2 options are wanted"):
        grid_design(GRID, THROUGH, 2, 3, np.random.default_rng(0))
    small = Grid(columns=3, rows=3, start=(0, 0), goal=(2, 2), obstacles=[(1, 1)])
    with pytest.raises(SurveyError, match=r"has 1 paths with 1 turns on one side and 1 on the other"):
        grid_design(small, "RURU", 3, 1, np.random.default_rng(0))
    with pytest.raises(SurveyError, match="needs obstacles"):
        grid_design(Grid(columns=3, rows=3, start=(0, 0), goal=(2, 2)), "RURU", 3, 1, np.random.default_rng(0))
