"""The robustness study against loops and closed forms."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy.stats import binom

from pipeline.choice import Boltzmann, angle_to, kl_aggregate, log_likelihood, posterior_from, theta_grid
from pipeline.choice.metrics import divergences
from pipeline.errors import StageError
from pipeline.params import Duplicates
from pipeline.studies.robustness.divergence import jackknife_interval, true_direction
from pipeline.studies.robustness.duplicates import inject_duplicates
from pipeline.studies.robustness.importance import effective_sample_size, weighted_log_likelihood
from pipeline.studies.robustness.problem import (
    ChoiceSets,
    Demonstrations,
    Problem,
    log_posteriors,
    theta_marginals,
    unit,
)
from pipeline.studies.robustness.samplings import compare_samplings
from pipeline.studies.robustness.sensitivity import vary_choices
from pipeline.studies.robustness.tests import analyse_regime, median_interval, summarise
from pipeline.vocabulary import INDEPENDENT, KNOWN_DENSITY, SAMPLER_SHIFT
from tests.oracles.slow_robustness import kl_aggregate as slow_kl_aggregate
from tests.oracles.slow_robustness import marginals as slow_marginals

THETAS = theta_grid([[0, 1], [0, 0.5, 1]])
BETAS = np.array([0.5, 5.0])
SIGMA = 0.2


def sets(rng: np.random.Generator, size: int, set_id: str, known: bool = False) -> ChoiceSets:
    phi = rng.random((size, 2))
    return ChoiceSets(size, set_id, {"task": phi}, {"task": rng.normal(size=size)} if known else {})


@pytest.fixture
def problem() -> Problem:
    rng = np.random.default_rng(3)
    people = Demonstrations(
        ("d0", "d1", "d2"), ("ann", "ben", "cid"), rng.random((3, 2)),
        (unit(np.array([-1.0, -0.4])), unit(np.array([-1.0, -0.6])), unit(np.array([-0.2, -1.0]))),
    )  # fmt: skip
    independent = tuple(sets(rng, size, f"{r:02d}") for size in (6, 15) for r in range(3))
    shifted = tuple(sets(rng, size, label, label != "via") for size in (6, 15) for label in ("a", "b", "via"))
    return Problem(people, {INDEPENDENT: independent, SAMPLER_SHIFT: shifted}, THETAS, BETAS)


@pytest.mark.parametrize("model", ["boltzmann", "less"])
def test_the_table_against_loops(problem: Problem, model: str) -> None:
    result = compare_samplings(problem, SIGMA)
    people = problem.demonstrations
    for regime in (INDEPENDENT, SAMPLER_SHIFT):
        for size, samplings in problem.by_size(regime):
            for name, rows in (("d0", [0]), ("d2", [2]), ("all", [0, 1, 2])):
                slow = [
                    slow_marginals(
                        people.features[rows], s.features["task"], THETAS, BETAS, SIGMA if model == "less" else None
                    )
                    for s in samplings
                ]
                (row,) = result.robustness.filter(
                    regime=regime, model=model, set_size=size, demonstration_id=name
                ).iter_rows(named=True)
                assert row["kl_aggregate"] == pytest.approx(slow_kl_aggregate(slow), rel=1e-10)
                assert row["kl_mean"] == pytest.approx(row["kl_aggregate"] / 6, rel=1e-15)
                assert row["entropy"] == pytest.approx(-np.mean(np.sum(slow * np.log(slow), axis=1)), rel=1e-10)
                truth = sum(people.truths[r] for r in rows)  # type: ignore[misc]
                angles = np.array([angle_to(theta, truth) for theta in THETAS])  # type: ignore[arg-type]
                assert row["true_posterior"] == pytest.approx(np.mean(np.array(slow)[:, angles.argmin()]), rel=1e-10)
                assert row["map_angle_rad"] == pytest.approx(angles[np.argmax(slow, axis=1)].mean(), rel=1e-10)
                assert row["truth_to_grid_rad"] == pytest.approx(angles.min(), rel=1e-12)
                stored = result.posteriors.filter(regime=regime, model=model, set_size=size, demonstration_id=name)
                np.testing.assert_allclose(stored["posterior"], np.ravel(slow), rtol=1e-10)


def test_only_sets_of_known_density_are_weighted(problem: Problem) -> None:
    result = compare_samplings(problem, SIGMA)
    known = result.robustness.filter(regime=KNOWN_DENSITY)
    assert set(known["model"]) == {
        "boltzmann", "less", "boltzmann-weighted", "boltzmann-weighted-apart", "boltzmann-apart"
    }  # fmt: skip
    assert known["sets"].unique().to_list() == [2]
    assert known["kl_low"].null_count() == known.height  # two sets leave nothing to leave out
    weighted = result.posteriors.filter(model="boltzmann-weighted")
    assert set(weighted["set_id"]) == {"a", "b"}
    # the part of the sets gives what these sets give by themselves
    alone = Problem(
        problem.demonstrations,
        {SAMPLER_SHIFT: tuple(s for s in problem.regimes[SAMPLER_SHIFT] if s.log_proposals)},
        THETAS,
        BETAS,
    )
    by_itself = compare_samplings(alone, SIGMA).robustness.filter(regime=SAMPLER_SHIFT, model="less")
    np.testing.assert_array_equal(known.filter(model="less")["kl_aggregate"], by_itself["kl_aggregate"])
    sizes = result.sets.filter(regime=SAMPLER_SHIFT, set_size=15)
    assert sizes.filter(set_id="via")["effective_sample_size"].null_count() == 1
    assert sizes.filter(set_id="a")["effective_sample_size"].is_between(1, 15).all()


def test_posteriors_together_are_those_of_one_at_a_time() -> None:
    likelihoods = np.random.default_rng(0).normal(-500, 40, (4, 3, 5, 2))
    together = log_posteriors(likelihoods)
    for r in range(4):
        for g, rows in enumerate(([0], [1], [2], [0, 1, 2])):
            one = posterior_from(likelihoods[r, rows], np.eye(5), BETAS)
            np.testing.assert_allclose(together[r, g], one.log_probability, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(theta_marginals(together)[r, g], one.log_marginal_theta, rtol=1e-12, atol=1e-12)


def test_the_jackknife_leaves_one_out() -> None:
    p = np.log(np.random.default_rng(2).dirichlet(np.ones(4), 6))
    found = jackknife_interval(divergences(p))
    assert found is not None
    logs = np.log([kl_aggregate(np.delete(p, r, axis=0)) * 6 / 4 for r in range(6)])
    half_width = 2.5705818366147395 * np.sqrt(5 / 6 * np.sum((logs - logs.mean()) ** 2))  # t of 5 d.f., 97.5 %
    np.testing.assert_allclose(np.log(found), np.log(kl_aggregate(p)) + np.array([-half_width, half_width]), rtol=1e-9)
    assert jackknife_interval(np.zeros((4, 4))) is None
    assert jackknife_interval(np.ones((2, 2))) is None


def test_importance_weights_recover_the_integral() -> None:
    """Two very different samplers on a line: the estimates agree with the integral of exp(beta theta x) over [0, 1]."""
    rng = np.random.default_rng(5)
    thetas, betas = np.array([[-1.0], [1.0]]), np.array([2.0])
    exact = [[-2 * 0.3 - np.log((1 - np.exp(-2)) / 2)], [2 * 0.3 - np.log((np.exp(2) - 1) / 2)]]
    for a, b in ((1.0, 1.0), (2.0, 1.0), (1.0, 1.6)):
        x = rng.beta(a, b, 200_000)
        log_q = np.log(a if b == 1 else b) + (a - 1) * np.log(x) + (b - 1) * np.log1p(-x)
        found = weighted_log_likelihood(
            np.array([[0.3]]), x[:, None], -log_q - np.log(len(x)), thetas, betas, joined=False
        )
        np.testing.assert_allclose(found[0], exact, atol=0.02)  # about 5 standard errors


def test_equal_weights_in_a_joined_set_are_boltzmann() -> None:
    rng = np.random.default_rng(6)
    alternatives, demonstrations = rng.normal(size=(30, 2)), rng.normal(size=(4, 2))
    found = weighted_log_likelihood(demonstrations, alternatives, np.full(30, -7.0), THETAS[:, :2], BETAS, joined=True)
    expected = log_likelihood(Boltzmann(), demonstrations, alternatives, THETAS[:, :2], BETAS)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    # a better demonstration than all that was drawn: apart from them its likelihood has no bound
    better = np.array([[-50.0, -50.0]])
    apart = weighted_log_likelihood(better, alternatives, np.zeros(30), THETAS[:, :2], BETAS, joined=False)
    assert apart.max() > 10
    assert weighted_log_likelihood(better, alternatives, np.zeros(30), THETAS[:, :2], BETAS, joined=True).max() <= 0


def test_effective_sample_size() -> None:
    assert effective_sample_size(np.full(40, -800.0)) == pytest.approx(40, rel=1e-12)
    assert effective_sample_size(np.array([0.0, -1e4, -1e4])) == pytest.approx(1, rel=1e-12)
    assert effective_sample_size(np.log([1.0, 2.0, 3.0])) == pytest.approx(36 / 14, rel=1e-12)


def test_what_was_wanted_on_scaled_features() -> None:
    scales = np.array([2.0, 10.0, 5.0])
    theta = true_direction({"effort": -3.0, "lift": -0.8, "grace": -9.0}, ("effort", "lift", "vase"), scales)
    # -3 per unit of a feature divided by 2 is -6, -0.8 of one divided by 10 is -8; the unnamed vase was not wanted
    np.testing.assert_allclose(theta, [-0.6, -0.8, 0.0], rtol=1e-15)
    raw, weights = np.array([[1.0, 4.0, 2.0], [3.0, 1.0, 0.0]]), np.array([-3.0, -0.8, 0.0])
    np.testing.assert_allclose((raw / scales) @ theta * 10, raw @ weights, rtol=1e-14)
    assert true_direction({"grace": -1.0}, ("effort", "lift", "vase"), scales) is None


def test_another_scale_keeps_rewards_and_truth(problem: Problem) -> None:
    ratio = np.array([3.0, 0.5])
    other = problem.rescaled(ratio)
    phi, truth = problem.demonstrations.features, problem.demonstrations.truths[0]
    there, turned = other.demonstrations.features, other.demonstrations.truths[0]
    assert truth is not None
    assert turned is not None
    rewards, rewards_there = phi @ truth, there @ turned
    np.testing.assert_allclose(rewards / rewards[0], rewards_there / rewards_there[0], rtol=1e-13)
    np.testing.assert_array_equal(
        other.regimes[SAMPLER_SHIFT][0].features["task"], problem.regimes[SAMPLER_SHIFT][0].features["task"] * ratio
    )


def test_a_truth_that_nobody_knows_is_missing(problem: Problem) -> None:
    people = problem.demonstrations
    unknown = Demonstrations(people.ids, people.participants, people.features, (people.truths[0], None, None))
    table = compare_samplings(Problem(unknown, problem.regimes, THETAS, BETAS), SIGMA).robustness
    assert table.filter(demonstration_id="d0")["true_posterior"].null_count() == 0
    others = table.filter(pl.col("demonstration_id") != "d0")
    for column in ("true_posterior", "map_angle_rad", "truth_to_grid_rad"):
        assert others[column].null_count() == others.height


def test_sets_of_ones_own_anchor(problem: Problem) -> None:
    """Judged against its own alternatives, whatever the others have; without any it is named."""
    rng = np.random.default_rng(8)
    people = problem.demonstrations
    own = tuple(ChoiceSets(6, str(r), {name: rng.random((6, 2)) for name in people.ids}, {}) for r in range(2))
    table = compare_samplings(Problem(people, {INDEPENDENT: own}, THETAS, BETAS), SIGMA).posteriors
    slow = slow_marginals(people.features[[1]], own[0].features["d1"], THETAS, BETAS, SIGMA)
    mine = table.filter(model="less", demonstration_id="d1", set_id="0")["posterior"]
    np.testing.assert_allclose(mine, slow, rtol=1e-10)
    lacking = tuple(ChoiceSets(6, s.set_id, {"d0": s.features["d0"], "d2": s.features["d2"]}, {}) for s in own)
    with pytest.raises(StageError, match="'d1' has no alternatives"):
        compare_samplings(Problem(people, {INDEPENDENT: lacking}, THETAS, BETAS), SIGMA)


def test_duplicates_against_sets_made_by_hand(problem: Problem) -> None:
    samplings = problem.regimes[INDEPENDENT][3:]
    settings = Duplicates(set_size=15, copied=2, copies=(1, 3), spreads=(0.0, 0.1))
    table = inject_duplicates(problem, samplings, settings, SIGMA, lambda set_id, anchor: np.random.default_rng(9))
    for spread in (0.0, 0.1):
        shifts = []
        for s in samplings:
            rng, phi = np.random.default_rng(9), s.features["task"]
            picked = rng.choice(15, size=2, replace=False)
            noise = rng.standard_normal((3, 2, 2))
            joined = np.concatenate([phi, *(phi[picked] + spread * noise[c] for c in range(3))])
            demonstration = problem.demonstrations.features[[1]]
            clean = slow_marginals(demonstration, phi, THETAS, BETAS, SIGMA)
            moved = slow_marginals(demonstration, joined, THETAS, BETAS, SIGMA)
            shifts.append(np.sum(clean * np.log(np.array(clean) / moved)))
        row = table.filter(model="less", copies=3, spread=spread, demonstration_id="d1")
        assert row["kl_from_clean"].item() == pytest.approx(np.mean(shifts), rel=1e-9)


def test_exact_copies_of_lone_alternatives_move_boltzmann_alone() -> None:
    """Alternatives out of each other's reach: LESS gives the copies the original's weight between them."""
    rng = np.random.default_rng(4)
    phi = rng.permutation(np.stack([np.arange(12.0), np.arange(12.0) ** 2], axis=1)) / 10
    people = Demonstrations(("d",), ("ann",), np.array([[0.35, 1.3]]), (None,))
    samplings = (ChoiceSets(12, "0", {"task": phi}, {}), ChoiceSets(12, "1", {"task": phi[::-1]}, {}))
    problem = Problem(people, {INDEPENDENT: samplings}, THETAS, BETAS)
    settings = Duplicates(set_size=12, copied=3, copies=(1, 10), spreads=(0.0,))
    table = inject_duplicates(problem, samplings, settings, 1e-3, lambda set_id, anchor: np.random.default_rng(1))
    shift = {key: table.filter(model=key[0], copies=key[1], demonstration_id="d")["kl_from_clean"].item()
             for key in (("boltzmann", 1), ("boltzmann", 10), ("less", 10), ("less-clean-bandwidth", 10))}  # fmt: skip
    assert shift["boltzmann", 10] > shift["boltzmann", 1] > 1e-4
    assert abs(shift["less", 10]) < 1e-12
    assert abs(shift["less-clean-bandwidth", 10]) < 1e-12


def test_one_choice_at_a_time(problem: Problem) -> None:
    result = compare_samplings(problem, "leave-one-out")
    table = vary_choices(problem, result, "leave-one-out", (0.5, 1), {"none": np.array([1.0, 4.0])}, "range")
    settings = {key[0]: part["setting"].unique().sort().to_list() for key, part in table.group_by("choice")}
    assert settings == {
        "bandwidth": ["0.5", "1"], "selector": ["k-fold", "leave-one-out", "literal"], "scale": ["none", "range"],
        "beta": ["0.5", "5", "joint", "marginal"],
    }  # fmt: skip
    key = ["regime", "model", "set_size", "demonstration_id"]
    main = result.robustness.filter(pl.col("regime") != KNOWN_DENSITY)
    for (choice,), part in table.filter("is_default").group_by("choice"):
        same = part.join(main, on=key, how="inner", validate="1:1")
        assert same.height == main.height, choice
        np.testing.assert_array_equal(same["kl_aggregate"], same["kl_aggregate_right"])
    people, samplings = problem.demonstrations, problem.regimes[SAMPLER_SHIFT][3:]
    fixed = [slow_marginals(people.features[[0]], s.features["task"], THETAS, [5.0]) for s in samplings]
    mine = {"regime": SAMPLER_SHIFT, "set_size": 15, "demonstration_id": "d0"}
    row = table.filter(choice="beta", setting="5", model="boltzmann", **mine)
    assert row["kl_aggregate"].item() == pytest.approx(slow_kl_aggregate(fixed), rel=1e-10)
    half = [
        slow_marginals(people.features[[0]], s.features["task"], THETAS, BETAS, 0.5 * result.bandwidths[s]["task"])
        for s in samplings
    ]
    row = table.filter(choice="bandwidth", setting="0.5", model="less", **mine)
    assert row["kl_aggregate"].item() == pytest.approx(slow_kl_aggregate(half), rel=1e-9)
    usual = [slow_marginals(people.features[[0]], s.features["task"], THETAS, BETAS) for s in samplings]
    flips = [np.argmax(one) != np.argmax(other) for one, other in zip(fixed, usual, strict=True)]
    changed = table.filter(choice="beta", setting="5", model="boltzmann", **mine)["map_changed"].item()
    assert changed == pytest.approx(np.mean(flips))
    assert table.filter("is_default")["map_changed"].max() == 0
    assert table["map_changed"].max() > 0
    assert table.filter(setting="joint")["true_posterior"].null_count() == table.filter(setting="joint").height


def made_up(participants: int) -> pl.DataFrame:
    rng = np.random.default_rng(6)
    rows = [
        {"regime": "r", "model": model, "set_size": size, "demonstration_id": f"d{p}", "participant": f"p{p}",
         "kl_aggregate": (3 if model == "boltzmann" else 1) * 100 / size * np.exp(0.1 * rng.normal())}
        for p in range(participants) for model in ("boltzmann", "less") for size in (10, 30, 100)
    ]  # fmt: skip
    return pl.DataFrame(rows)


def test_analysis_of_variance_and_pairs_of_one_size() -> None:
    effects, pairs = analyse_regime(made_up(12), "r") or (None, None)
    assert effects is not None
    assert pairs is not None
    interaction = effects.filter(measure="kl_aggregate", effect="model:set_size").row(0, named=True)
    assert (interaction["df_effect"], interaction["df_error"]) == (2, 22)
    assert interaction["p_value"] < 1e-6
    # three times as much at every size: on the logarithm there is no interaction
    assert effects.filter(measure="log_kl_aggregate", effect="model:set_size")["p_value"].item() > 0.01
    assert pairs.filter(measure="kl_aggregate")["set_size"].to_list() == [10, 30, 100]
    assert (pairs["difference"] > 0).all()
    np.testing.assert_allclose(pairs.filter(measure="log_kl_aggregate")["difference"], np.log(3), atol=0.15)


def test_several_demonstrations_of_one_person_count_once() -> None:
    table = made_up(12)
    again = pl.concat([table, table.with_columns(pl.col("demonstration_id") + "b")])
    first, second = analyse_regime(table, "r"), analyse_regime(again, "r")
    assert first is not None
    assert second is not None
    assert first[0].equals(second[0])
    by = ["regime", "model", "set_size"]
    assert summarise(table, by, "kl_aggregate").equals(summarise(again, by, "kl_aggregate"))


def test_too_few_for_an_analysis() -> None:
    assert analyse_regime(made_up(1), "r") is None
    assert analyse_regime(made_up(5).filter(model="less", set_size=10), "r") is None
    one_size = analyse_regime(made_up(5).filter(set_size=30), "r")
    assert one_size is not None
    assert one_size[0]["effect"].to_list() == ["model", "model"]
    assert one_size[1]["set_size"].to_list() == [30, 30]


@pytest.mark.parametrize(("count", "rank"), [(6, 1), (8, 1), (9, 2), (12, 3), (25, 8), (100, 40)])
def test_interval_of_a_median(count: int, rank: int) -> None:
    values = np.random.default_rng(0).permutation(count).astype(float)
    assert median_interval(values) == (rank - 1, count - rank)
    assert 2 * binom.cdf(rank - 1, count, 0.5) <= 0.05 < 2 * binom.cdf(rank, count, 0.5)
    assert median_interval(values[:5]) is None


def test_what_a_figure_shows(problem: Problem) -> None:
    result = compare_samplings(problem, SIGMA).robustness
    table = summarise(result, ["regime", "model", "set_size"], "kl_aggregate")
    own = {"regime": INDEPENDENT, "model": "less", "set_size": 15}
    rows = result.filter(**own)
    single, batch = (table.filter(demonstrations=kind, **own).row(0, named=True) for kind in ("single", "batch"))
    each = rows.filter(pl.col("demonstration_id") != "all")["kl_aggregate"]
    assert (single["value"], single["mean"], single["participants"]) == (each.median(), each.mean(), 3)
    together = rows.filter(demonstration_id="all").row(0, named=True)
    assert [batch[name] for name in ("value", "low", "high")] == [
        together[f"kl_{n}"] for n in ("aggregate", "low", "high")
    ]
