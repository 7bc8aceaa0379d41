"""People are spread over trials, sides and orders as evenly as their number allows."""

from collections import Counter
from itertools import combinations

import pytest

from pipeline.survey.assignment import Assignment, next_assignment, order


def assigned(count: int, trials: list[str], *, show_all: bool, mirror: bool) -> list[Assignment]:
    given: list[Assignment] = []
    for _ in range(count):
        given.append(next_assignment(given, trials, show_all=show_all, mirror=mirror))
    return given


@pytest.mark.parametrize("count", [1, 2, 7, 77, 200])
def test_trials_and_sides_differ_by_one_person_at_most(count: int) -> None:
    given = assigned(count, ["control", "experimental"], show_all=False, mirror=True)

    first = Counter(one.trials for one in given)
    cells = Counter((one.trials, one.mirrored) for one in given)
    assert set(first) <= {("control",), ("experimental",)}
    assert max(first.values()) - (min(first.values()) if len(first) == 2 else 0) <= 1
    for trial in first:
        sides = [cells[trial, side] for side in (False, True)]
        assert max(sides) - min(sides) <= 1


def test_with_all_trials_each_comes_first_equally_often() -> None:
    given = assigned(30, ["a", "b", "c"], show_all=True, mirror=False)

    assert Counter(one.trials for one in given) == {("a", "b", "c"): 10, ("b", "c", "a"): 10, ("c", "a", "b"): 10}


@pytest.mark.parametrize("count", [2, 3, 5, 8])
def test_orders_are_balanced_over_a_round(count: int) -> None:
    names = [f"option-{place}" for place in range(count)]
    orders = [order(names, turn) for turn in range(2 * count)]

    assert all(sorted(one) == names for one in orders)
    for place in range(count):
        assert set(Counter(one[place] for one in orders).values()) == {2}
    for a, b in combinations(names, 2):
        assert sum(one.index(a) < one.index(b) for one in orders) == count
    assert order(names, 2 * count) == orders[0]
