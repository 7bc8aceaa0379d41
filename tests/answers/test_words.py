from __future__ import annotations

import numpy as np
import pytest

from pipeline.answers.words import preferences, sentence, stated_signs, wording
from pipeline.choice.weights import WeightDraws
from pipeline.errors import ArgumentError

FEATURES = {
    "efficiency": {"kind": "efficiency"},
    "table": {"kind": "height"},
    "laptop": {"kind": "proximity", "object": "laptop", "radius_m": 0.4},
}


def draws(mean) -> WeightDraws:
    omega = np.random.default_rng(0).normal(size=(4000, len(mean))) + np.array(mean)
    return WeightDraws(omega, np.full(4000, -np.log(4000)), 0.1, 0.0)


def test_a_cost_and_a_wish_are_put_the_right_way_round() -> None:
    found = preferences(draws([-4.0, -9.0, 5.0]), FEATURES)
    assert [one.words for one in found] == ["stay low", "pass close to the laptop", "be brief"]
    assert sentence(found) == "stay low, pass close to the laptop, be brief"
    other = preferences(draws([4.0, 9.0, -5.0]), FEATURES)
    assert [one.words for one in other] == ["stay high", "keep away from the laptop", "take detours"]


def test_what_is_not_sure_is_not_said() -> None:
    found = preferences(draws([0.5, -9.0, 0.0]), FEATURES)
    assert sentence(found) == "stay low"
    assert [one.stated for one in found] == [True, False, False]
    assert "not known" in str(found[1])
    assert sentence(preferences(draws([0.0, 0.1, 0.0]), FEATURES)) == "nothing is known yet"
    np.testing.assert_array_equal(stated_signs(draws([0.5, -9.0, 4.0])), [0, -1, 1])


def test_words_carry_their_interval() -> None:
    (first, *_) = preferences(draws([0.0, -9.0, 0.0]), FEATURES)
    low, high = first.interval
    assert low < first.weight < high < 0
    assert str(first).startswith("stay low (table -9.0, 90 % between -10.")


@pytest.mark.parametrize(
    ("kind", "place", "wished", "expected"),
    [
        ("efficiency", None, False, "be brief"),
        ("path_length", None, False, "go the short way"),
        ("tilt", None, False, "keep level"),
        ("proximity", None, False, "keep away from the name"),
        ("my_own_kind", None, False, "less name"),
        ("my_own_kind", None, True, "more name"),
    ],
)
def test_wording(kind, place, wished, expected) -> None:
    assert wording(kind, "name", place, wished) == expected


def test_as_many_names_as_weights() -> None:
    with pytest.raises(ArgumentError, match="2 names for weights of 3"):
        preferences(draws([1.0, 2.0, 3.0]), {"a": {}, "b": {}})
