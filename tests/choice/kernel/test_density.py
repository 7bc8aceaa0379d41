from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.choice import log_density
from pipeline.choice.kernel import pairwise
from pipeline.errors import ArgumentError
from tests.oracles import slow_choice


@pytest.fixture
def clustered() -> np.ndarray:
    """600 rows, three tiles, one in three a repetition."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(400, 3)) * [1.0, 0.1, 5.0]
    return rng.permutation(np.vstack([rows, rows[:200]]))


@pytest.mark.parametrize("sigma", [0.01, 0.3, 20.0])
def test_equals_the_slow_loop_at_the_rows_and_elsewhere(clustered: np.ndarray, sigma: float) -> None:
    rows = clustered[:150]
    points = np.vstack([rows[:5], [[1e3, 0, 0]], rows[:5] + 0.01])
    np.testing.assert_allclose(log_density(rows, sigma), slow_choice.log_density(rows, sigma), rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        log_density(rows, sigma, at=points), slow_choice.log_density(rows, sigma, points), rtol=1e-13, atol=1e-12
    )


def test_tiles_add_up(clustered: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = log_density(clustered, 0.2), log_density(clustered, 0.2, at=clustered)
    monkeypatch.setattr(pairwise, "_TILE", 7)
    tiled = log_density(clustered, 0.2), log_density(clustered, 0.2, at=clustered)
    np.testing.assert_allclose(tiled, whole, rtol=0, atol=1e-12)
    np.testing.assert_allclose(tiled[0], tiled[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("many", [1, 2, 1000])
def test_threads_share_the_tiles(clustered: np.ndarray, monkeypatch: pytest.MonkeyPatch, many: int) -> None:
    monkeypatch.setattr(pairwise, "_TILE", 7)
    monkeypatch.setattr(pairwise, "_MANY", many)
    found = log_density(clustered, 0.1, engine="exact")
    np.testing.assert_allclose(found, slow_choice.log_density(clustered, 0.1), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found, log_density(clustered, 0.1, engine="exact"))


def test_the_order_of_rows_changes_no_bit(clustered: np.ndarray) -> None:
    order = np.random.default_rng(0).permutation(len(clustered))
    assert np.array_equal(log_density(clustered, 0.2)[order], log_density(clustered[order], 0.2))


def test_a_far_point_does_not_underflow() -> None:
    value = log_density([[0.0, 0.0], [3.0, 0.0]], 1.0, at=[[1e6, 0.0]])
    assert value[0] == pytest.approx(-((1e6 - 3) ** 2) / 2, rel=1e-15)


def test_a_neighbour_below_rounding_still_counts() -> None:
    """Two rows 8 sigma apart: log(1 + e^-32) = e^-32, which 1 + e^-32 would round to within 1 %."""
    values = log_density([[0.0], [8.0]], 1.0)
    np.testing.assert_allclose(values, math.exp(-32), rtol=1e-12)


def test_a_common_offset_costs_no_digits() -> None:
    rows = np.array([[0.0], [0.5], [0.75]])
    np.testing.assert_array_equal(log_density(rows + 2.0**40, 0.3), log_density(rows, 0.3))


def test_minus_zero_is_zero() -> None:
    np.testing.assert_array_equal(log_density([[0.0], [-0.0]], 0.1), np.log([2.0, 2.0]))


def test_an_unknown_engine_is_refused() -> None:
    with pytest.raises(ArgumentError, match="the engines are auto, exact, neighbours, spectral"):
        log_density([[0.0], [1.0]], 1.0, engine="fast")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"features": [[0.0], [math.nan]], "bandwidth": 1.0}, r"features contains nan at \[1, 0\]"),
        ({"features": np.empty((0, 2)), "bandwidth": 1.0}, "features is empty"),
        ({"features": [0.0, 1.0], "bandwidth": 1.0}, r"features has shape \(2,\)"),
        ({"features": [["a"]], "bandwidth": 1.0}, "features cannot be read"),
        ({"features": [[0.0]], "bandwidth": 0.0}, "bandwidth is 0.0"),
        ({"features": [[0.0]], "bandwidth": -1.0}, "bandwidth is -1.0"),
        ({"features": [[0.0]], "bandwidth": math.nan}, "bandwidth is nan"),
        ({"features": [[0.0]], "bandwidth": "wide"}, "bandwidth is 'wide'"),
        ({"features": [[0.0]], "bandwidth": 1.0, "at": [[0.0, 1.0]]}, "at has 2 columns where 1 are needed"),
        ({"features": [[1e200]], "bandwidth": 1.0}, "numbers up to 1e[+]150"),
    ],
)
def test_refusals(arguments: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        log_density(**arguments)
