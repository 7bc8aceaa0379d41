"""Against ArviZ's `psislw`; `psis_arviz.json` holds its answers and says which version gave them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from pipeline.choice.weights.pareto import effective_draws, pareto_smoothed
from pipeline.errors import ArgumentError

CASES = json.loads((Path(__file__).parent / "psis_arviz.json").read_text(encoding="utf-8"))["cases"]


@pytest.mark.parametrize("name", CASES)
def test_agrees_with_arviz(name: str) -> None:
    case = CASES[name]
    log_weights, k = pareto_smoothed(np.array(case["log_ratios"]))
    np.testing.assert_allclose(log_weights, case["log_weights"], atol=1e-9)
    assert k == (math.inf if case["k"] is None else pytest.approx(case["k"], abs=1e-9))


def test_agrees_with_arviz_where_it_is_installed() -> None:
    arviz = pytest.importorskip("arviz")
    ratios = np.random.default_rng(3).standard_t(3, size=2000)
    expected, k = arviz.psislw(ratios.copy())
    log_weights, own = pareto_smoothed(ratios)
    np.testing.assert_allclose(log_weights, expected, atol=1e-9)
    assert own == pytest.approx(float(k), abs=1e-9)


def test_finds_the_tail_of_a_pareto_distribution() -> None:
    """Ratios u^-k have a tail of shape k."""
    u = np.random.default_rng(5).random(100_000)
    for shape in (0.2, 0.5, 0.9):
        assert pareto_smoothed(-shape * np.log(u))[1] == pytest.approx(shape, abs=0.1)


def test_impossible_draws_have_no_weight() -> None:
    log_weights, _ = pareto_smoothed(np.array([0.0, -np.inf] * 50))
    assert np.all(log_weights[1::2] == -np.inf)
    assert effective_draws(log_weights) == pytest.approx(50)


@pytest.mark.parametrize("ratios", [[], [np.nan, 0.0], [np.inf, 0.0], [-np.inf], [[0.0]]])
def test_refusals(ratios) -> None:
    with pytest.raises(ArgumentError, match="finite numbers"):
        pareto_smoothed(np.array(ratios))
