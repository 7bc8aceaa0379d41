"""Whether any theta explains people better than chance: by hand, and on people who choose the opposite of the grid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from pipeline.choice import Boltzmann, log_likelihood
from pipeline.choice.chance import needed_gain
from pipeline.params import parse
from pipeline.studies.posteriors import Group, fit_rows, hypotheses
from pipeline.studies.support import chance_notes
from tests.support.gantry_project import PARAMETERS

ABOUT = {"task": "sweep", "model": "less"}


def test_weights_of_both_signs_need_half_a_quantile_of_chi_square() -> None:
    assert chi2.sf(2 * needed_gain(np.array([[1.0, 1], [-1, -1]])), 2) == pytest.approx(0.05, abs=1e-9)


@pytest.mark.parametrize("signs", [(-1,), (-1, 0), (-1, -1, 1, 0)])
def test_luck_has_a_share_of_one_in_twenty(signs: tuple[int, ...]) -> None:
    """Weights of any size seen with unit noise: the gain is half the squared length of what the signs allow."""
    seen = np.random.default_rng(5).standard_normal((200_000, len(signs)))
    allowed = np.where(np.array(signs) == 0, seen, np.where(seen * signs > 0, seen, 0.0))
    thetas = np.array([[sign or 1 for sign in signs], [sign or -1 for sign in signs]], dtype=float)
    lucky = ((allowed**2).sum(axis=1) / 2 >= needed_gain(thetas)).mean()
    assert lucky == pytest.approx(0.05, abs=0.002)  # its standard error is 0.0005


def test_groups_by_hand() -> None:
    values = np.array([[[-1.0], [-4.0]], [[-6.0], [-2.0]]])  # two demonstrations, two thetas
    groups: list[Group] = [("a", "p", [0]), ("all", "all", [0, 1])]
    rows = fit_rows(groups, values, np.array([-5.0, -2.5]), np.eye(2), ABOUT)
    assert rows["log_likelihood"].to_list() == [-1.0, -6.0]  # together the second theta is the best
    assert rows["log_chance"].to_list() == [-5.0, -7.5]
    assert rows["better"].to_list() == [True, False]
    (sentence,) = chance_notes(rows)
    assert "under LESS no theta of the grid explains the 2 demonstrations better than chance" in sentence
    assert "+1.5 against that of theta = 0, needed is +2.1" in sentence


def test_people_who_want_much_are_found_with_positive_values_alone() -> None:
    """Of 200 heights people take the upper ones: no cost of height explains them, a wish does."""
    heights = np.linspace(0, 1, 200)[:, None]
    people, groups = heights[[180, 190, 185, 199, 195]], [("all", "all", list(range(5)))]
    chance = log_likelihood(Boltzmann(), people, heights, [[0.0]], [1.0])[:, 0, 0]
    better = []
    for thetas in ([[-1.0]], [[-1.0], [1.0]]):
        values = log_likelihood(Boltzmann(), people, heights, thetas, [0.01, 1.0, 10.0, 30.0])
        better += fit_rows(groups, values, chance, np.array(thetas), ABOUT)["better"].to_list()
    assert better == [False, True]


def grid(thetas: object, directions: tuple[str, ...]) -> list[tuple[float, ...]]:
    task = PARAMETERS["tasks"]["sweep"] | {"thetas": thetas}
    parsed = parse(PARAMETERS | {"tasks": {"sweep": task}})
    found = hypotheses(parsed.tasks["sweep"], parsed.infer, ("effort", "vase"), directions)
    return [tuple(row) for row in np.sign(found).astype(int)]


def test_the_grid_follows_the_directions() -> None:
    assert set(grid("grid", ("cost", "cost"))) == {(0, -1), (-1, 0), (-1, -1)}
    assert set(grid("grid", ("cost", "wish"))) == {(0, 1), (-1, 0), (-1, 1)}
    assert set(grid("grid", ("cost", "either"))) == {(0, -1), (0, 1), (-1, 0), (-1, -1), (-1, 1)}
    assert set(grid({"vase": [0.5]}, ("cost", "cost"))) == {(0, 1), (-1, 1)}
