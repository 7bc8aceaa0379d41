"""The grid-world study on a small grid, whole, against loops over every path; its statistics against closed forms."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.stats import chisquare, ttest_rel

from pipeline import params
from pipeline.choice import LESS, Boltzmann, infer
from pipeline.errors import ArgumentError
from pipeline.params import GridWorldSettings
from pipeline.studies.grid_world.study import GridWorldStudy, run_grid_world
from pipeline.studies.grid_world.trials import (
    HIDDEN_MODELS,
    INFERENCE_MODELS,
    SAMPLING_MODELS,
    THETAS,
    GridWorld,
    build_world,
    draw_demonstrations,
    posteriors,
)
from tests.oracles import slow_choice_sets
from tests.oracles.slow_grid_world import all_paths

OBJECTS = ((1, 2), (3, 0))
SETTINGS = GridWorldSettings(size=4, objects=OBJECTS, beta=3.0, demonstrations=4, seeds=40)
SEED, BANDWIDTH = 0, 0.2
MODELS = (*INFERENCE_MODELS, *HIDDEN_MODELS)


@pytest.fixture(scope="module")
def world() -> GridWorld:
    return build_world(SETTINGS, BANDWIDTH)


@pytest.fixture(scope="module")
def study() -> GridWorldStudy:
    return run_grid_world(SETTINGS, SEED, BANDWIDTH)


@pytest.fixture(scope="module")
def likelihoods() -> dict[str, list[list[float]]]:
    """By model, p(path | theta) from loops."""
    paths = all_paths(4)
    phi = slow_choice_sets.features(paths, list(OBJECTS))
    weights = {model: slow_choice_sets.weights(model, paths, list(OBJECTS), 0.2) for model in MODELS}
    return {
        model: [slow_choice_sets.probabilities(w, phi, tuple(theta), 3.0) for theta in THETAS.tolist()]
        for model, w in weights.items()
    }


def test_eight_thetas() -> None:
    assert THETAS.tolist() == [[-1, -1], [-1, 0], [-1, 1], [0, -1], [0, 1], [1, -1], [1, 0], [1, 1]]


@pytest.mark.parametrize("model", MODELS)
def test_choice_probabilities(world: GridWorld, likelihoods: dict[str, list[list[float]]], model: str) -> None:
    p = np.exp(world.log_probabilities[model])
    assert p == pytest.approx(np.array(likelihoods[model]), rel=1e-10)
    assert p.sum(axis=1) == pytest.approx(np.ones(8), abs=1e-12)


def test_trials_agree_with_loops(
    world: GridWorld, study: GridWorldStudy, likelihoods: dict[str, list[list[float]]]
) -> None:
    assert study.trials.height == 4 * 4 * 8 * 40
    drawn = {
        m: draw_demonstrations(world.log_probabilities[m], SETTINGS, SEED) for m in (*SAMPLING_MODELS, *HIDDEN_MODELS)
    }
    for row in study.trials.sample(400, seed=0).to_dicts():
        rows = drawn[row["sampling_model"]][row["theta_id"], row["seed"]].tolist()
        expected = slow_choice_sets.posterior(likelihoods[row["inference_model"]], rows)
        true = expected[row["theta_id"]]
        assert row["true_posterior"] == pytest.approx(true, rel=1e-9)
        others = [p for k, p in enumerate(expected) if k != row["theta_id"]]
        assert row["true_match"] == (true > max(others) * (1 + 1e-9))


def test_posteriors_are_those_of_infer(world: GridWorld) -> None:
    rows = np.array([[0, 3, 3, 19], [7, 7, 8, 1]])
    for name, model in (("boltzmann", Boltzmann()), ("less", LESS(0.2))):
        ours = posteriors(world.log_probabilities[name], rows)
        theirs = [infer(model, drawn, world.features, THETAS, [3.0]).marginal_theta for drawn in rows]
        assert ours == pytest.approx(np.array(theirs), rel=1e-11)


@pytest.mark.parametrize("model", [*SAMPLING_MODELS, *HIDDEN_MODELS])
def test_demonstrations_follow_their_probabilities(world: GridWorld, model: str) -> None:
    many = GridWorldSettings(size=4, objects=OBJECTS, beta=3.0, demonstrations=10, seeds=2000)
    drawn = draw_demonstrations(world.log_probabilities[model], many, SEED)
    p = np.exp(world.log_probabilities[model])
    for k in range(8):
        counts = np.bincount(drawn[k].ravel(), minlength=p.shape[1])
        assert chisquare(counts, counts.sum() * p[k] / p[k].sum()).pvalue > 1e-4


def test_draws_depend_on_theta_seed_and_root_alone(world: GridWorld) -> None:
    log_p = world.log_probabilities["boltzmann"]
    drawn = draw_demonstrations(log_p, SETTINGS, SEED)
    uniform = np.full_like(log_p, -np.log(log_p.shape[1]))
    again = draw_demonstrations(uniform, SETTINGS, SEED)
    ranks = np.cumsum(np.exp(log_p), axis=1)
    for k in range(8):  # the same uniform number lies in both of its cells
        low = np.concatenate([[0.0], ranks[k]])[drawn[k]]
        assert (low <= (again[k] + 1) / 20 + 1e-12).all()
        assert (again[k] / 20 <= ranks[k][drawn[k]] + 1e-12).all()
    assert not (drawn[0] == drawn[1]).all()
    assert not (drawn == draw_demonstrations(log_p, SETTINGS, random_seed=1)).all()


def test_statistics_in_closed_form(study: GridWorldStudy) -> None:
    cells = {
        key: rows.sort("theta_id", "seed")["true_posterior"].to_numpy()
        for key, rows in study.trials.group_by("sampling_model", "inference_model")
    }
    interaction = study.analysis.anova.filter(effect="sampling_model:inference_model").row(0, named=True)
    t = ttest_rel(
        cells["less", "less"] - cells["less", "boltzmann"], cells["boltzmann", "less"] - cells["boltzmann", "boltzmann"]
    )
    assert interaction["f"] == pytest.approx(t.statistic**2, rel=1e-9)
    assert (interaction["df_effect"], interaction["df_error"]) == (1, 319)
    for model in HIDDEN_MODELS:
        one_way = study.analysis.anova.filter(experiment=model).row(0, named=True)
        paired = ttest_rel(cells[model, "less"], cells[model, "boltzmann"])
        assert one_way["f"] == pytest.approx(paired.statistic**2, rel=1e-9)
        assert one_way["p_value"] == pytest.approx(paired.pvalue, rel=1e-6)


def test_logistic_odds_are_those_of_the_match_rates(study: GridWorldStudy) -> None:
    rates = {
        (row["sampling_model"], row["inference_model"]): row["true_match"]
        for row in study.analysis.summary.filter(pl.col("theta_id").is_null()).to_dicts()
    }
    for model in (*SAMPLING_MODELS, *HIDDEN_MODELS):
        less, boltzmann = rates[model, "less"], rates[model, "boltzmann"]
        odds_ratio = (less / (1 - less)) / (boltzmann / (1 - boltzmann))
        assert study.analysis.logistic.filter(experiment=model)["odds_ratio"].item() == pytest.approx(
            odds_ratio, rel=1e-7
        )


def test_summary(study: GridWorldStudy) -> None:
    rows = study.analysis.summary
    assert rows.height == 4 * 4 * 9
    one = study.trials.filter(sampling_model="less", inference_model="path-size", theta_id=5)
    summed = rows.filter(sampling_model="less", inference_model="path-size", theta_id=5).row(0, named=True)
    assert summed["sets"] == 40
    assert summed["true_posterior"] == pytest.approx(one["true_posterior"].mean(), rel=1e-12)
    assert summed["standard_error"] == pytest.approx(
        np.std(one["true_posterior"].to_numpy(), ddof=1) / np.sqrt(40), rel=1e-12
    )
    assert summed["true_match"] == pytest.approx(one["true_match"].mean(), rel=1e-12)


def test_hypotheses(study: GridWorldStudy) -> None:
    table = study.analysis.hypotheses
    assert table.select("hypothesis", "sampling_model", "expected").rows() == [
        ("H3", "less", "less"),
        ("H4", "boltzmann", "boltzmann"),
        ("H5", "less-hidden", "less"),
        ("H5", "less-hidden-own-bandwidth", "less"),
    ]
    for row in table.to_dicts():
        ahead = row["posterior_expected"] > row["posterior_other"] and row["match_expected"] > row["match_other"]
        assert (row["match_odds_ratio"] > 1) == (row["match_expected"] > row["match_other"])
        assert row["supported"] == (ahead and max(row["posterior_p_value"], row["match_p_value"]) < 0.05)


def test_example_sets(study: GridWorldStudy) -> None:
    leads = study.trials.filter(pl.col("sampling_model").is_in(SAMPLING_MODELS)).pivot(
        "inference_model", index=["sampling_model", "theta_id", "seed"], values="true_posterior"
    )
    lead = (leads["less"] - leads["boltzmann"]).to_numpy()
    posterior = study.examples.posteriors
    assert (
        posterior.group_by("set", "inference_model").agg(pl.col("posterior").sum())["posterior"].to_list()
        == [pytest.approx(1.0)] * 4
    )
    for name, best in (("Xi_L", lead.max()), ("Xi_B", -lead.min())):
        true = dict(posterior.filter(pl.col("is_true"), set=name).select("inference_model", "posterior").iter_rows())
        assert abs(true["less"] - true["boltzmann"]) == pytest.approx(best, rel=1e-12)
    paths = study.examples.paths
    assert paths.height == 8
    for row in paths.to_dicts():
        steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(zip(row["x"], row["y"], strict=True))]
        assert set(steps) == {(1, 0), (0, 1)}


def test_densities(study: GridWorldStudy, world: GridWorld) -> None:
    one = study.examples.density_1d
    two = study.examples.density_2d
    for name in ("raw", "adjusted"):
        areas = (
            one.with_columns(area=(pl.col("high") - pl.col("low")) * pl.col(name))
            .group_by("feature")
            .agg(pl.sum("area"))
        )
        assert areas["area"].to_list() == [pytest.approx(1.0)] * 2
        cell = (pl.col("phi_1_high") - pl.col("phi_1_low")) * (pl.col("phi_2_high") - pl.col("phi_2_low"))
        assert two.select((cell * pl.col(name)).sum()).item() == pytest.approx(1.0)
    expected = slow_choice_sets.density(world.features.tolist(), 0.2)
    assert np.exp(world.log_density) == pytest.approx(np.array(expected), rel=1e-10)


def test_same_settings_same_tables(study: GridWorldStudy) -> None:
    again = run_grid_world(SETTINGS, SEED, BANDWIDTH)

    def tables(record: object) -> list[pl.DataFrame]:
        parts = [getattr(record, field.name) for field in fields(record)]  # type: ignore[arg-type]
        return [table for part in parts for table in (tables(part) if is_dataclass(part) else [part])]

    assert len(tables(study)) == 11
    assert all(a.equals(b) for a, b in zip(tables(study), tables(again), strict=True))


def test_bandwidth_is_selected_if_not_given() -> None:
    world = build_world(SETTINGS.model_copy(update={"size": 5, "objects": ((1, 3), (3, 1))}))
    assert world.bandwidths["less"] == world.bandwidths["less-hidden"] > 0
    assert world.bandwidths["less-hidden-own-bandwidth"] > 0


def test_the_papers_size() -> None:
    # our own environment: the values are what it gave, the degrees of freedom and the directions are the paper's
    settings = params.load(Path(__file__).parents[2] / params.FILE).studies.grid_world
    study = run_grid_world(settings, random_seed=0, bandwidth=0.0026066)
    interaction = study.analysis.anova.filter(effect="sampling_model:inference_model").row(0, named=True)
    assert interaction["df_error"] == 1199
    assert interaction["f"] == pytest.approx(1236.8, abs=0.5)
    supported = dict(study.analysis.hypotheses.select("hypothesis", "supported").head(2).iter_rows())
    assert supported == {"H3": True, "H4": True}


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="bandwidth is -1"):
        build_world(SETTINGS, bandwidth=-1.0)
