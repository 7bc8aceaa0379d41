import numpy as np
import pytest

from pipeline.choice import kl_aggregate
from pipeline.choice.convergence import Convergence, Round, disagreement, run_until
from pipeline.choice.logspace import log_sum_exp
from pipeline.errors import ArgumentError


def posteriors(spread: float, seed: int = 0, runs: int = 4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    logits = np.linspace(0, 2, 10).reshape(2, 5) + spread * rng.normal(size=(runs, 2, 5))
    return np.asarray(logits - log_sum_exp(logits, axis=2)[..., None])


def test_disagreement_is_kl_aggregate_a_pair() -> None:
    log_p = posteriors(0.7)
    ours = disagreement(log_p)
    for question in range(2):
        assert ours[question] * 4 * 3 == pytest.approx(kl_aggregate(log_p[:, question]), rel=1e-10)


def test_what_one_excludes_and_another_does_not_is_infinite() -> None:
    with np.errstate(divide="ignore"):
        log_p = np.log(np.array([[[0.5, 0.5]], [[1.0, 0.0]]]))
    assert disagreement(log_p)[0] == np.inf
    assert disagreement(log_p[[1, 1]])[0] == 0


def test_rounds_double_until_they_agree_and_answer_stays() -> None:
    asked = []

    def step(evaluations: int) -> np.ndarray:
        asked.append(evaluations)
        return posteriors(10 / np.sqrt(evaluations))

    record = run_until(step, 100, 0.01, 10**7)
    assert record.reached
    assert record.further_evaluations == 0
    assert asked == [100 * 2**k for k in range(len(asked))]
    assert record.disagreement <= 0.01
    assert record.change <= 0.01


def test_agreement_on_an_answer_that_still_moves_is_no_convergence() -> None:
    """All explorations too short in the same way: they agree, and all change when they go on."""
    record = Convergence(tuple(Round(n, np.repeat(posteriors(1.0, n, 1), 3, axis=0)) for n in (100, 200)), 0.01)
    assert record.disagreement == pytest.approx(0, abs=1e-12)
    assert record.change > 0.01
    assert not record.reached


def test_no_more_than_allowed_and_an_extrapolation_says_what_is_missing() -> None:
    record = run_until(lambda n: posteriors(10 / np.sqrt(n)), 100, 1e-4, 800)
    assert not record.reached
    assert record.rounds[-1].evaluations == 800
    assert record.further_evaluations is not None
    # variance falls as one over the evaluations here, so the power law is the truth
    assert record.further_evaluations == pytest.approx(800 * record.disagreement / 1e-4, rel=0.5)


def test_one_exploration_cannot_agree() -> None:
    with pytest.raises(ArgumentError, match="two or more explorations"):
        disagreement(posteriors(1.0, runs=1))
