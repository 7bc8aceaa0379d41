"""Regimes side by side: simulated people, credible sets and summaries against slow obvious computations."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from pipeline.choice import LESS, Boltzmann, log_likelihood, theta_grid
from pipeline.choice.explored import region_log_likelihood
from pipeline.studies.robustness.problem import Demonstrations, Problem
from pipeline.studies.robustness.regimes import (
    SimulatedPeople,
    judged_by_set,
    judged_by_space,
    measured,
    pooled_recovery,
    recovered,
    simulate_people,
    summarised,
    with_costs,
)
from pipeline.trajectories.random_streams import child_rng

RNG = np.random.default_rng(5)
THETAS, BETAS = theta_grid([[0, 1], [0, 0.5, 1]]), np.array([0.5, 5.0])
SPACE, LOG_W = RNG.random((40, 2)), RNG.normal(size=40)
EVERY = np.arange(len(THETAS))


def people(repetitions: int = 4, count: int = 3, stream: int = 0) -> SimulatedPeople:
    return simulate_people(child_rng(7, stream), SPACE, LOG_W, THETAS, BETAS, EVERY, repetitions, count)


def test_people_choose_as_often_as_the_model_says() -> None:
    found = people(repetitions=4000, count=5)
    assert found.choices.shape == (len(THETAS) * len(BETAS) * 4000, 5, 2)
    for k, b in ((0, 0), (len(THETAS) - 1, 1)):
        theirs = found.choices[(found.theta == k) & (found.beta == BETAS[b])].reshape(-1, 2)
        p = np.exp(BETAS[b] * SPACE @ THETAS[k] + LOG_W)
        p /= p.sum()
        expected = p @ SPACE
        error = np.sqrt((p @ (SPACE - expected) ** 2) / len(theirs))
        assert (np.abs(theirs.mean(axis=0) - expected) < 4 * error).all()


@pytest.mark.parametrize("model", ["boltzmann", "less"])
def test_a_set_judges_each_choice_by_itself(model: str) -> None:
    found, alternatives = people(), RNG.random((12, 2))
    values = judged_by_set(model, found, alternatives, 0.2, THETAS, BETAS)
    of = Boltzmann() if model == "boltzmann" else LESS(0.2)
    for person, choice in ((0, 0), (5, 2), (len(found.theta) - 1, 1)):
        one = log_likelihood(of, found.choices[person, choice][None], alternatives, THETAS, BETAS)
        np.testing.assert_allclose(values[person, choice], one[0], rtol=1e-12)
    spaced = judged_by_space(found, SPACE, LOG_W, THETAS, BETAS)
    one = region_log_likelihood(found.choices[3, 1][None], SPACE, LOG_W, THETAS, BETAS)
    np.testing.assert_allclose(spaced[3, 1], one[0], rtol=1e-12)


def test_credible_sets_against_a_loop() -> None:
    found = people()
    values = judged_by_space(found, SPACE, LOG_W, THETAS, BETAS)
    rows = recovered(child_rng(1), found, values, THETAS)
    assert rows["choices"].to_list() == [1, 1, 3, 3]
    covered, truths, matches, count = 0, 0.0, 0, 0
    for i in np.flatnonzero(found.beta == BETAS[1]):
        p = np.exp(values[i].sum(axis=0)).sum(axis=1)
        p /= p.sum()
        total = 0.0
        for k in np.argsort(-p):  # the smallest set that reaches 0.9
            total += p[k]
            if k == found.theta[i]:
                covered += 1
            if total >= 0.9:
                break
        truths, matches, count = truths + p[found.theta[i]], matches + (p.argmax() == found.theta[i]), count + 1
    row = rows.filter(choices=3, true_beta=BETAS[1]).row(0, named=True)
    assert row["repetitions"] == count
    assert row["covered"] == pytest.approx(covered / count)
    assert row["true_posterior"] == pytest.approx(truths / count)
    assert row["true_match"] == pytest.approx(matches / count)


def test_inference_that_is_right_covers_as_often_as_it_says_and_one_from_other_options_does_not() -> None:
    found = people(repetitions=1500, count=6)
    right = recovered(child_rng(2), found, judged_by_space(found, SPACE, LOG_W, THETAS, BETAS), THETAS)
    together = right.filter(choices=6)
    share = (together["covered_randomised"] * together["repetitions"]).sum() / together["repetitions"].sum()
    error = np.sqrt(0.9 * 0.1 / together["repetitions"].sum())
    assert abs(share - 0.9) < 4 * error
    assert (together["covered"] >= together["covered_randomised"]).all()
    low = SPACE[SPACE[:, 0] < 0.3]  # among these whoever chooses at random seems to want much of the first feature
    few = people(repetitions=100, count=6)
    wrong = recovered(child_rng(3), few, judged_by_set("boltzmann", few, low, 0.1, THETAS, BETAS), THETAS)
    shares = [table.filter(choices=6, true_beta=BETAS[0])["covered_randomised"][0] for table in (right, wrong)]
    assert shares[1] < shares[0] - 0.1


def test_recoveries_are_pooled_by_their_numbers() -> None:
    labels = {"regime": "explored", "model": "less", "set_size": 0, "choices": 1, "true_beta": 1.0}
    numbers = ("true_posterior", "true_match", "map_angle_rad", "learned", "covered_randomised")

    def part(repetitions: int, covered: float) -> pl.DataFrame:
        return pl.DataFrame({**labels, "repetitions": repetitions, "covered": covered, **dict.fromkeys(numbers, 0.5)})

    row = pooled_recovery([part(10, 1.0), part(30, 0.6)]).row(0, named=True)
    assert (row["sets"], row["repetitions"], row["covered"]) == (2, 40, pytest.approx(0.7))
    assert row["covered_sd"] == pytest.approx(np.std([1.0, 0.6], ddof=1))


def test_kl_aggregate_is_put_on_the_scale_of_ten() -> None:
    shown = Demonstrations(("d0", "d1", "d2"), ("ann", "ann", "ben"), RNG.random((3, 2)), (None, None, None))
    problem = Problem(shown, {}, THETAS, BETAS)
    log_p = np.log(RNG.dirichlet(np.ones(len(THETAS)), size=(4, 4)))
    rows = measured(problem, log_p, "explored", "less", 0, 1234)
    np.testing.assert_allclose(rows["kl_aggregate"], rows["kl_mean"] * 12)
    np.testing.assert_allclose(rows["learned"], np.log(len(THETAS)) - rows["entropy"])
    single, batch = summarised(rows).sort("demonstrations", descending=True).iter_rows(named=True)
    by_person = [90 * rows["kl_mean"][:2].mean(), 90 * rows["kl_mean"][2]]
    assert single["value"] == pytest.approx(np.median(by_person))
    assert (single["largest"], single["low"]) == (pytest.approx(max(by_person)), None)
    assert batch["value"] == pytest.approx(90 * rows["kl_mean"][3])
    assert (single["participants"], single["trajectories"], batch["true_posterior"]) == (2, 1234, None)
    assert with_costs(rows, len(THETAS), pl.col("sets"))["trajectories"].to_list() == [4] * 4
