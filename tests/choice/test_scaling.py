from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.arrays import FloatArray
from pipeline.choice import LESS, infer
from pipeline.choice.scaling import Spread, feature_scale
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
def test_a_feature_that_does_not_vary_is_left_as_it_is(method: str, value: float) -> None:
    pool = np.column_stack([np.arange(7.0), np.full(7, value)])
    assert feature_scale(pool, method, NAMES)[1] == 1
    assert feature_scale(pool, method, NAMES, np.array([[3.0, value], [9.0, value]]))[1] == 1
    assert Spread.of(pool).varies.tolist() == [True, False]


@pytest.mark.parametrize("method", ["range", "std"])
def test_where_only_demonstrations_vary_they_differ_by_one(method: str) -> None:
    """A person went near the laptop and no alternative does: the difference counts as the largest of its kind."""
    pool, people = np.column_stack([np.arange(7.0), np.zeros(7)]), np.array([[3.0, 2.5], [90.0, 0.5]])
    scale = feature_scale(pool, method, NAMES, people)
    assert scale[1] == 2.5
    assert scale[0] == feature_scale(pool, method, NAMES)[0]  # of the others, demonstrations change nothing
    np.testing.assert_allclose(feature_scale(pool * 1e3, method, NAMES, people * 1e3), 1e3 * scale)


def test_rounding_is_no_spread() -> None:
    pool = np.column_stack([np.arange(3.0), [1.0, 1.0 + 1e-15, 1.0]])
    assert feature_scale(pool, "range", NAMES)[1] == 1
    pool[1, 1] = 1.0 + 1e-11
    np.testing.assert_allclose(feature_scale(pool, "range", NAMES)[1], 1e-11, rtol=1e-4)


@given(st.integers(0, 2), st.sampled_from([0.0, 3.0, -1e4]), st.integers(0, 2**32 - 1))
def test_a_feature_that_does_not_vary_tells_nothing(place: int, value: float, seed: int) -> None:
    """With and without it, the posterior over the other weights is the same, to rounding."""
    rng = np.random.default_rng(seed)
    others, people = rng.random((20, 2)), rng.random((3, 2))
    thetas = np.array([[-1.0, 0.0], [0.0, -1.0], [-0.6, -0.8]])
    names = ("a", "b", "c")

    def posterior(with_it: bool) -> FloatArray:
        pool, shown, weights = others, people, thetas
        if with_it:
            pool, shown = (np.insert(rows, place, value, axis=1) for rows in (others, people))
            weights = np.insert(thetas, place, -0.7, axis=1)
        scale = feature_scale(pool, "range", names[: pool.shape[1]], shown)
        return infer(LESS(bandwidth=0.1), shown / scale, pool / scale, weights, betas=(1.0, 10.0)).log_probability

    np.testing.assert_allclose(posterior(True), posterior(False), atol=1e-8)


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
