"""A study of section 3 on a grid: how many paths to offer on either side of an obstacle, and which.

As in the paper, paths of one side are alike and those of different sides are not: LESS gives a side its share of the
control trial whatever the number of its paths, Boltzmann counts paths. All paths have the same length and number of
turns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import SurveyError
from pipeline.studies.choice_design import information
from pipeline.survey.questionnaire import MOST_OPTIONS, Cell, Grid, Option, Questionnaire, Trial, cells_of

_SHARES = (np.arange(99) + 1) / 100  # of the left side in the control trial, equally probable


@dataclass(frozen=True, eq=False)
class GridDesign:
    """The study, and what it is expected to tell.

    Attributes:
        questionnaire: ready to be served.
        left, right: how many paths of each side the experimental trial offers.
        about_model: nats that a person's choice tells about the model once the control trial has told the shares, mean
            over shares.
        predicted: probability of each option of the experimental trial under Boltzmann and under LESS, if the control
            trial is divided equally.
    """

    questionnaire: Questionnaire
    left: int
    right: int
    about_model: float
    predicted: FloatArray


def grid_design(grid: Grid, attention: str, options: int, turns: int, rng: np.random.Generator) -> GridDesign:
    """Choose the numbers of paths for which the models disagree most, and paths that resemble one another most.

    Args:
        grid: with one block of obstacles between start and goal, the start at the lower left and the goal at the upper
            right.
        attention: moves of the option that nobody who follows the instructions takes.
        options: how many paths the experimental trial offers, without that one.
        turns: of each path.
        rng: decides between paths that are equally alike.

    Raises:
        SurveyError: the grid has not so many paths.
    """
    if not 3 <= options < MOST_OPTIONS:
        raise SurveyError(f"{options} options are wanted; 3 to {MOST_OPTIONS - 1} can be shown beside the test one")
    left, right = _sides(grid, turns)
    told = {
        (a, options - a): _about_model(a, options - a)
        for a in range(1, options)
        if a <= len(left) and options - a <= len(right)
    }
    if not told:
        raise SurveyError(
            f"the grid has {len(left)} paths with {turns} turns on one side and {len(right)} on the other; that is too "
            f"few for {options} options"
        )
    # the first of equals: fewer on the left, as in the paper
    a, b = max(told, key=lambda split: (round(told[split], 12), -split[0]))
    few, many = _alike(grid, left, a, rng), _alike(grid, right, b, rng)
    test = Option(moves=attention, attention=True)
    control = {"left": Option(moves=few[0]), "right": Option(moves=many[0]), "through": test}
    offered = {f"L{number}": Option(moves=moves, group="left") for number, moves in enumerate(few, 1)}
    offered |= {f"R{number}": Option(moves=moves, group="right") for number, moves in enumerate(many, 1)}
    questionnaire = Questionnaire(
        title="Which path would you take?", mirror=True,
        trials={
            "control": Trial(grid=grid, options=control),
            "experimental": Trial(grid=grid, options=offered | {"through": test}),
        },
    )  # fmt: skip
    return GridDesign(questionnaire, a, b, told[a, b], _predicted(0.5, a, b))


def _predicted(share: float, left: int, right: int) -> FloatArray:
    """(2, options) probabilities under Boltzmann and LESS, for the left side's share of the control trial."""
    rewards = np.array([share] * left + [1 - share] * right)
    sizes = np.array([left] * left + [right] * right)
    p = np.stack([rewards, rewards / sizes])
    return np.asarray(p / p.sum(axis=1, keepdims=True))


def _about_model(left: int, right: int) -> float:
    return float(np.mean([information(_predicted(float(share), left, right) / 2) for share in _SHARES]))


def _sides(grid: Grid, turns: int) -> tuple[list[str], list[str]]:
    """The shortest paths around the obstacles with so many turns, above them and below them."""
    across, up = grid.goal[0] - grid.start[0], grid.goal[1] - grid.start[1]
    if across < 1 or up < 1 or not grid.obstacles:
        raise SurveyError("the grid needs obstacles, and its goal above and to the right of its start")
    if math.comb(across + up, up) > 200_000:
        raise SurveyError("the grid has more than 200,000 shortest paths; take a smaller one")
    blocked = {tuple(cell) for cell in grid.obstacles}
    middle = np.array(sorted(blocked), dtype=float).mean(axis=0)
    sides: tuple[list[str], list[str]] = ([], [])
    for places in combinations(range(across + up), up):
        moves = "".join("U" if place in places else "R" for place in range(across + up))
        if sum(one != other for one, other in pairwise(moves)) != turns:
            continue
        cells = cells_of(grid, moves)
        if not blocked.intersection(cells):
            sides[0 if _passes_above(cells, middle) else 1].append(moves)
    return sides


def _passes_above(cells: Sequence[Cell], middle: FloatArray) -> bool:
    """Whether a path is above the middle of the obstacles where it passes them."""
    return bool(max(row for column, row in cells if column <= middle[0]) > middle[1])


def _alike(grid: Grid, paths: list[str], count: int, rng: np.random.Generator) -> list[str]:
    """Paths that share the most cells: the best first one, and with it one after the other."""
    cells = [set(cells_of(grid, moves)) for moves in paths]
    shared = np.array([[len(one & other) for other in cells] for one in cells], dtype=float)
    shared += rng.uniform(0, 1e-3, shared.shape)  # decides between equals
    np.fill_diagonal(shared, -np.inf)
    if count == 1:
        return [paths[int(rng.integers(len(paths)))]]
    first = int(np.argmax([np.sort(row)[::-1][: count - 1].sum() for row in shared]))
    picked = [first]
    while len(picked) < count:
        worth = shared[picked].sum(axis=0)
        worth[picked] = -np.inf
        picked.append(int(np.argmax(worth)))
    return [paths[index] for index in picked]
