"""Redrawn sets: every number against a loop over the models' own functions."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from pipeline.arrays import FloatArray
from pipeline.choice import LESS, Boltzmann, kl_aggregate, log_likelihood, posterior_from, select_bandwidth, theta_grid
from pipeline.choice.explored import PooledLESS
from pipeline.choice.held_out import held_out_score
from pipeline.choice.nested_logit import nested_log_likelihood, nests_of
from pipeline.studies.robustness.problem import ChoiceSets, Demonstrations
from pipeline.studies.robustness.redraws import (
    DISSIMILARITY,
    INFERRED,
    NEST_BANDWIDTHS,
    Measured,
    Redraw,
    explored_scores,
    held_out_leads,
    leads,
    measure,
    paper_tests,
    positions,
)
from pipeline.studies.statistics import crossed_lead

THETAS, BETAS = theta_grid([[0, 1], [0, 0.5, 1]]), np.array([0.5, 5.0])
RNG = np.random.default_rng(12)
PEOPLE = Demonstrations(("d0", "d1", "d2"), ("ann", "ben", "cid"), RNG.random((3, 2)) * 1.3, (None, None, None))


def redraw(draw: int, sampler: str = "wide") -> Redraw:
    rng = np.random.default_rng(100 + draw)
    sets = tuple(
        ChoiceSets(size, f"{number:02d}", {"task": rng.random((size, 2))}, {})
        for size in (8, 20)
        for number in range(3)
    )
    return Redraw(sampler, draw, sets, {"task": rng.random((40, 2))})


@pytest.fixture(scope="module")
def measured() -> Measured:
    return Measured.together(
        [measure(redraw(draw), PEOPLE, ("a", "b"), THETAS, BETAS, "leave-one-out") for draw in range(4)]
    )


def likelihood(model: str, one: Redraw, sets: ChoiceSets) -> FloatArray:
    rows, pool = sets.features["task"], one.pool["task"]
    sigma = select_bandwidth(rows).value
    if model == "nested-logit":
        nests = nests_of(rows, NEST_BANDWIDTHS * sigma)
        return nested_log_likelihood(PEOPLE.features, rows, nests, THETAS, BETAS, DISSIMILARITY)
    of = {
        "boltzmann": Boltzmann(),
        "less": LESS(sigma),
        "less-pooled": PooledLESS(np.concatenate([rows, pool]), select_bandwidth(pool).value),
    }[model]
    return log_likelihood(of, PEOPLE.features, rows, THETAS, BETAS)


@pytest.mark.parametrize("model", ["boltzmann", "less", "less-pooled", "nested-logit"])
def test_divergences_and_scores_against_loops(measured: Measured, model: str) -> None:
    one = redraw(2)
    for size in (8, 20):
        values = [likelihood(model, one, sets) for sets in one.sets if sets.set_size == size]
        rows = measured.divergences.filter(draw=2, model=model, set_size=size)
        for i, name in enumerate(PEOPLE.ids):
            posteriors = np.stack([posterior_from(v[[i]], THETAS, BETAS).log_marginal_theta for v in values])
            (found,) = rows.filter(demonstration_id=name)["kl_aggregate"]
            assert found == pytest.approx(kl_aggregate(posteriors), rel=1e-9, abs=1e-12)
        together = np.stack([posterior_from(v, THETAS, BETAS).log_marginal_theta for v in values])
        assert rows.filter(demonstration_id="all")["kl_aggregate"].item() == pytest.approx(kl_aggregate(together))
        scores = measured.scores.filter(draw=2, model=model, set_size=size)
        for b, beta in ((None, INFERRED), (0, "0.5"), (1, "5")):
            expected = []
            for v in values:
                kept = v if b is None else v[:, :, [b]]
                flat = kept.reshape(3, -1)
                per_person = []
                for i in range(3):
                    others = np.delete(flat, i, axis=0).sum(axis=0)
                    weights = np.exp(others - others.max())
                    per_person.append(np.log((weights / weights.sum()) @ np.exp(flat[i])))
                expected.append(per_person)
            np.testing.assert_allclose(scores.filter(beta=beta)["score"], np.mean(expected, axis=0), rtol=1e-9)


def test_the_held_out_score_of_boltzmann_is_that_of_the_library(measured: Measured) -> None:
    one = redraw(0)
    scores = [
        held_out_score(Boltzmann(), PEOPLE.features, sets.features["task"], THETAS, BETAS).log_predictive
        for sets in one.sets
        if sets.set_size == 20
    ]
    found = measured.scores.filter(draw=0, model="boltzmann", set_size=20, beta=INFERRED)["score"]
    np.testing.assert_allclose(found, np.mean(scores, axis=0), rtol=1e-12)


def test_leads_are_log_ratios_over_draws_and_people(measured: Measured) -> None:
    _, post_hoc = paper_tests(measured.divergences)
    table = leads(measured.divergences, post_hoc)
    assert table.height == 3 * 2 * 2
    kl = {
        (row["draw"], row["model"], row["participant"]): row["kl_aggregate"]
        for row in measured.divergences.filter(set_size=20).iter_rows(named=True)
    }
    values = np.array(
        [[np.log(kl[d, "less", p] / kl[d, "boltzmann", p]) for p in PEOPLE.participants] for d in range(4)]
    )
    expected, single = crossed_lead(values), table.filter(model="less", set_size=20, demonstrations="single")
    for name, value in (("ratio", expected.mean), ("low", expected.low), ("high", expected.high)):
        assert single[name].item() == pytest.approx(np.exp(value))
    assert single["p_paired"].item() == pytest.approx(expected.p_paired)
    tukey = post_hoc.filter(measure="kl_aggregate", set_size=20)
    assert tukey.height == 4
    assert single["share_tukey"].item() == pytest.approx(np.mean([p < 0.05 for p in tukey["p_value"]]))
    batch = table.filter(model="less", set_size=20, demonstrations="batch").row(0, named=True)
    assert np.log(batch["ratio"]) == pytest.approx(
        np.mean([np.log(kl[d, "less", "all"] / kl[d, "boltzmann", "all"]) for d in range(4)])
    )
    assert (batch["participants"], batch["p_paired"]) == (1, None)


def test_held_out_leads_are_paired(measured: Measured) -> None:
    table = held_out_leads(measured.scores).filter(model="less-pooled", set_size=8, beta=INFERRED)
    rows = measured.scores.filter(set_size=8, beta=INFERRED)
    values = np.array(
        [
            rows.filter(draw=d, model="less-pooled")["score"].to_numpy()
            - rows.filter(draw=d, model="boltzmann")["score"].to_numpy()
            for d in range(4)
        ]
    )
    expected = crossed_lead(values)
    row = table.row(0, named=True)
    assert (row["lead"], row["low"]) == (pytest.approx(expected.mean), pytest.approx(expected.low))
    assert row["people_ahead"] == (values.mean(axis=0) > 0).sum()
    assert row["share_ahead"] == pytest.approx((values.mean(axis=1) > 0).mean())


def test_people_are_ranked_in_the_pools(measured: Measured) -> None:
    table = positions(measured.positions)
    for row in table.iter_rows(named=True):
        i, f = PEOPLE.ids.index(row["demonstration_id"]), "ab".index(row["feature"])
        shares = [float((redraw(d).pool["task"][:, f] < PEOPLE.features[i, f]).mean()) for d in range(4)]
        assert row["percentile"] == pytest.approx(np.mean(shares))
        assert row["beyond"] == np.mean([share in (0, 1) for share in shares])


def test_scores_over_the_explored_space_are_in_the_same_columns() -> None:
    values = {"boltzmann": [RNG.normal(size=(3, 4, 2)) for _ in range(2)], "less": [RNG.normal(size=(3, 4, 2))] * 2}
    table = explored_scores(PEOPLE, values, BETAS)
    assert table.height == 2 * 2 * 3 * 3
    assert held_out_leads(table).filter(beta=INFERRED)["draws"].to_list() == [2]
    alone = Demonstrations(("d0",), ("ann",), PEOPLE.features[:1], (None,))
    assert explored_scores(alone, values, BETAS).is_empty()
    assert held_out_leads(explored_scores(alone, values, BETAS)).is_empty()


def test_one_person_has_divergences_but_no_tests_and_no_scores() -> None:
    alone = Demonstrations(("d0",), ("ann",), PEOPLE.features[:1], (None,))
    found = Measured.together([measure(redraw(d), alone, ("a", "b"), THETAS, BETAS, 0.2) for d in range(2)])
    anova, post_hoc = paper_tests(found.divergences)
    assert (anova.height, post_hoc.height, found.scores.height) == (0, 0, 0)
    table = leads(found.divergences, post_hoc)
    assert table.filter(pl.col("p_paired").is_not_null()).is_empty()
    assert table["share_tukey"].null_count() == table.height
