from __future__ import annotations

from functools import reduce
from operator import add

import numpy as np
import pytest

from pipeline.choice import LESS, Boltzmann, infer, likelihood, log_likelihood, log_sum_exp, posterior_from
from pipeline.choice.log_sum_exp import LogSumExp, log_likelihood_joined, partial_normaliser
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(4)
ROWS, OUTSIDE, THETAS = RNG.normal(size=(500, 3)), RNG.normal(size=(6, 3)), RNG.normal(size=(11, 3))
BETAS = [0.1, 3.0, 500.0]


def in_parts(model, count: int) -> np.ndarray:
    weights = model.weigh(ROWS)
    joined, own = zip(*(weights.joined(OUTSIDE[[d]]) for d in range(len(OUTSIDE))), strict=True)
    parts = [
        partial_normaliser(ROWS[p], weights.log_w[p], THETAS, BETAS, ROWS.min(axis=0), np.array(joined)[:, p])
        for p in np.array_split(np.arange(len(ROWS)), count)
    ]
    return log_likelihood_joined(reduce(add, parts), OUTSIDE, own, THETAS, BETAS, ROWS.min(axis=0))


@pytest.mark.parametrize("model", [Boltzmann(), LESS(0.3)])
@pytest.mark.parametrize("count", [1, 7])
def test_parts_give_the_likelihood_of_the_whole(model, count: int) -> None:
    whole = log_likelihood(model, OUTSIDE, ROWS, THETAS, BETAS)
    np.testing.assert_allclose(in_parts(model, count), whole, rtol=1e-12, atol=1e-11)
    assert in_parts(model, count).tobytes() == in_parts(model, count).tobytes()
    np.testing.assert_allclose(
        posterior_from(in_parts(model, count), THETAS, BETAS).log_probability,
        infer(model, OUTSIDE, ROWS, THETAS, BETAS).log_probability,
        rtol=1e-12, atol=1e-10,
    )  # fmt: skip


def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = in_parts(LESS(0.3), 3), infer(LESS(0.3), OUTSIDE, ROWS, THETAS, BETAS).log_probability
    monkeypatch.setattr(log_sum_exp, "BLOCK", 33 * 10)
    monkeypatch.setattr(likelihood, "BLOCK", 33 * 10)
    monkeypatch.setattr(likelihood, "_GROUP", 1000)
    blocks = in_parts(LESS(0.3), 3), infer(LESS(0.3), OUTSIDE, ROWS, THETAS, BETAS).log_probability
    for one, other in zip(whole, blocks, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-11)


def test_sums_far_apart_and_empty_ones() -> None:
    """Terms of e^1000 and e^-1000, and a hypothesis under which a part is impossible."""
    one = LogSumExp.of(np.array([[1000.0, 1000.0], [-np.inf, -np.inf]]))
    two = LogSumExp.of(np.array([[-1000.0], [-3.0]]))
    np.testing.assert_allclose((one + two).value, [[1000 + np.log(2), -3.0]], rtol=1e-15)
    np.testing.assert_array_equal(one.value, [[1000 + np.log(2), -np.inf]])


def test_a_normaliser_of_other_hypotheses_is_refused() -> None:
    part = partial_normaliser(ROWS, np.zeros(500), THETAS, BETAS, np.zeros(3))
    with pytest.raises(ArgumentError, match=r"\(6, 33\), are needed"):
        log_likelihood_joined(part, OUTSIDE, np.zeros(6), THETAS, BETAS, np.zeros(3))
