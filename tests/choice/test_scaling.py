from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.choice.scaling import feature_scale
from pipeline.errors import ArgumentError

FEATURES = np.array([[1.0, -20.0], [4.0, 0.0], [3.0, -10.0], [2.0, 30.0]])
NAMES = ("effort", "height")


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        ("range", [3.0, 50.0]),
        ("std", [math.sqrt(1.25), math.sqrt(350.0)]),
        ("none", [1.0, 1.0]),
        ({"height": 0.5, "effort": 7.0}, [7.0, 0.5]),
    ],
)
def test_closed_forms(method: str | dict[str, float], expected: list[float]) -> None:
    np.testing.assert_allclose(feature_scale(FEATURES, method, NAMES), expected, rtol=1e-15)


def test_range_brings_the_pool_to_length_one() -> None:
    pool = np.random.default_rng(3).normal(size=(200, 3)) * [1e-6, 1.0, 1e6]
    scaled = pool / feature_scale(pool, "range", ("a", "b", "c"))
    np.testing.assert_allclose(np.ptp(scaled, axis=0), 1.0, rtol=1e-12)


@pytest.mark.parametrize("method", ["range", "std"])
def test_a_change_of_units_changes_no_scaled_feature(method: str) -> None:
    pool = np.random.default_rng(4).normal(size=(50, 2))
    units = np.array([1e-3, 2048.0])
    in_other_units = pool * units
    np.testing.assert_allclose(
        in_other_units / feature_scale(in_other_units, method, NAMES),
        pool / feature_scale(pool, method, NAMES),
        rtol=1e-12,
    )


@pytest.mark.parametrize("method", ["range", "std"])
@pytest.mark.parametrize("value", [0.0, 5.0, 0.1])
def test_a_feature_that_does_not_vary_is_refused_by_name(method: str, value: float) -> None:
    pool = np.column_stack([np.arange(7.0), np.full(7, value)])
    with pytest.raises(ArgumentError, match="'height' is the same for all 7 alternatives"):
        feature_scale(pool, method, NAMES)


def test_rounding_is_no_spread() -> None:
    pool = np.column_stack([np.arange(3.0), [1.0, 1.0 + 1e-15, 1.0]])
    with pytest.raises(ArgumentError, match="'height'"):
        feature_scale(pool, "range", NAMES)
    pool[1, 1] = 1.0 + 1e-11
    np.testing.assert_allclose(feature_scale(pool, "range", NAMES)[1], 1e-11, rtol=1e-4)


def test_a_feature_that_does_not_vary_may_be_left_as_it_is() -> None:
    pool = np.column_stack([np.arange(3.0), np.ones(3)])
    np.testing.assert_array_equal(feature_scale(pool, "none", NAMES), [1.0, 1.0])
    np.testing.assert_array_equal(feature_scale(pool, {"tilt": 1.0, "effort": 2.0, "height": 3.0}, NAMES), [2.0, 3.0])


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("minmax", "'minmax'; allowed are range, std, none"),
        ({"effort": 1.0, "tilt": 1.0}, "constants for effort, tilt; it lacks height"),
    ],
)
def test_refusals(method: str | dict[str, float], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        feature_scale(FEATURES, method, NAMES)
