from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.choice import (
    LESS,
    AttributeRule,
    Boltzmann,
    PathSize,
    WeightedSet,
    infer,
    infer_sequential,
    likelihood,
    log_likelihood,
    log_probabilities,
    posterior_from,
    predict,
    theta_grid,
)  # fmt: skip
from pipeline.errors import ArgumentError, BandwidthError
from tests.oracles import slow_choice

RNG = np.random.default_rng(8)
ALTERNATIVES = RNG.normal(size=(40, 3))
ALTERNATIVES[5] = ALTERNATIVES[4]
OUTSIDE = np.vstack([RNG.normal(size=(2, 3)), ALTERNATIVES[4]])
THETAS = theta_grid([[0, 1]] * 3)
BETAS = np.array([0.1, 3.0, 100.0])
LOG_PRIOR = RNG.normal(size=(len(THETAS), len(BETAS)))

MODELS = [
    (Boltzmann(), slow_choice.boltzmann),
    (LESS(bandwidth=0.7), slow_choice.less(0.7)),
    (AttributeRule(), slow_choice.attribute_rule),
]
by_model = pytest.mark.parametrize(("model", "slow"), MODELS, ids=lambda model: getattr(model, "name", ""))
both_kinds = pytest.mark.parametrize("demonstrations", [OUTSIDE, np.array([4, 5, 31])], ids=["outside", "rows"])


def slow_likelihoods(slow, demonstrations, alternatives=ALTERNATIVES) -> list:
    values = [d if np.ndim(d) else int(d) for d in demonstrations]
    return [
        [[slow_choice.log_likelihood(slow, d, list(alternatives), t, b) for b in BETAS] for t in THETAS] for d in values
    ]


@both_kinds
@by_model
def test_everything_equals_the_slow_loops(model, slow, demonstrations) -> None:
    expected = slow_likelihoods(slow, demonstrations)
    actual = log_likelihood(model, demonstrations, ALTERNATIVES, THETAS, BETAS)
    np.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-12)

    posterior = infer(model, demonstrations, ALTERNATIVES, THETAS, BETAS, LOG_PRIOR)
    wanted = np.array(slow_choice.log_posterior(expected, LOG_PRIOR))
    np.testing.assert_allclose(posterior.log_probability, wanted, rtol=1e-12, atol=1e-11)
    np.testing.assert_allclose(posterior.marginal_theta, np.exp(wanted).sum(axis=1), rtol=1e-10)
    assert posterior.marginal_theta.sum() == pytest.approx(1, abs=1e-14)
    np.testing.assert_array_equal(posterior.map_theta, THETAS[np.exp(wanted).sum(axis=1).argmax()])

    sequence = infer_sequential(model, demonstrations, ALTERNATIVES, THETAS, BETAS, LOG_PRIOR)
    np.testing.assert_array_equal(sequence[-1].log_probability, posterior.log_probability)
    for count, after in enumerate(sequence, start=1):
        wanted = slow_choice.log_posterior(expected[:count], LOG_PRIOR)
        np.testing.assert_allclose(after.log_probability, wanted, rtol=1e-12, atol=1e-11)

    predicted = predict(posterior, model, ALTERNATIVES)
    wanted = slow_choice.predict(slow, list(ALTERNATIVES), THETAS, BETAS, np.array(posterior.log_probability))
    np.testing.assert_allclose(predicted, wanted, rtol=1e-11)


@both_kinds
@by_model
def test_blocks_change_nothing(model, slow, demonstrations, monkeypatch: pytest.MonkeyPatch) -> None:
    posterior = infer(model, demonstrations, ALTERNATIVES, THETAS, BETAS)
    predicted = predict(posterior, model, ALTERNATIVES)
    monkeypatch.setattr(likelihood, "BLOCK", 60)
    blocked = infer(model, demonstrations, ALTERNATIVES, THETAS, BETAS)
    np.testing.assert_allclose(blocked.log_probability, posterior.log_probability, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(predict(posterior, model, ALTERNATIVES), predicted, rtol=1e-12)


def test_trajectory_space() -> None:
    """LESS that compares waypoints: the joined set is joined there, too."""
    waypoints, outside = RNG.normal(size=(40, 6)), RNG.normal(size=(3, 6))
    actual = log_likelihood(LESS(2.0), OUTSIDE, ALTERNATIVES, THETAS, BETAS, waypoints, outside)
    for d in range(3):
        for k in (0, 3):
            expected = slow_choice.log_likelihood(
                slow_choice.less(2.0), OUTSIDE[d], list(ALTERNATIVES), THETAS[k], 3.0, list(waypoints), outside[d]
            )
            assert actual[d, k, 1] == pytest.approx(expected, abs=1e-12)
    posterior = infer(LESS(2.0), [1, 2], ALTERNATIVES, THETAS, BETAS, similarity=waypoints)
    predicted = predict(posterior, LESS(2.0), ALTERNATIVES, similarity=waypoints)
    assert predicted.sum() == pytest.approx(1, abs=1e-13)
    assert not np.allclose(predicted, predict(posterior, LESS(2.0), ALTERNATIVES))
    np.testing.assert_array_equal(
        infer(Boltzmann(), OUTSIDE, ALTERNATIVES, THETAS, similarity=waypoints, demonstration_similarity=outside)
        .log_probability,
        infer(Boltzmann(), OUTSIDE, ALTERNATIVES, THETAS).log_probability,
    )  # fmt: skip


def test_paths_that_share_links() -> None:
    paths, features = np.array([[1, 1, 0], [1, 0, 1], [0, 0, 1]]), np.array([[2.0], [2.0], [1.0]])
    outside = np.array([[0, 1, 1]])
    actual = log_likelihood(PathSize(), [[1.5]], features, [[-1.0]], [2.0], paths, outside)
    expected = slow_choice.log_likelihood(
        slow_choice.path_size([1, 1, 1]), [1.5], list(features), [-1.0], 2.0, list(paths), outside[0]
    )
    assert actual[0, 0, 0] == pytest.approx(expected, abs=1e-14)


def test_two_alternatives_closed_form() -> None:
    """p(1) = 1 / (1 + e^-beta theta)."""
    values = np.exp(log_probabilities(Boltzmann(), [[0.0], [1.0]], theta=[2.0], beta=0.5))
    np.testing.assert_allclose(values, [1 / (1 + math.e), math.e / (1 + math.e)], rtol=1e-15)


def test_the_human_choice_study() -> None:
    """Reward ln(19/21) on the left; three paths on the right whose features are the same."""
    features, lam = [[1.0], [0.0], [0.0], [0.0]], 19 / 21
    left = [np.exp(log_probabilities(m, features, [math.log(lam)]))[0] for m in (Boltzmann(), LESS(1e-3))]
    assert left == pytest.approx([lam / (lam + 3), lam / (lam + 1)], rel=1e-12)
    assert [round(value, 4) for value in left] == [0.2317, 0.4750]


def test_posterior_from_summed_likelihoods_subsets_and_none() -> None:
    values = log_likelihood(LESS(0.7), OUTSIDE, ALTERNATIVES, THETAS, BETAS)
    whole = infer(LESS(0.7), OUTSIDE, ALTERNATIVES, THETAS, BETAS).log_probability
    np.testing.assert_array_equal(posterior_from(values, THETAS, BETAS).log_probability, whole)
    summed = posterior_from(values.sum(axis=0), THETAS, BETAS).log_probability
    np.testing.assert_allclose(summed, whole, rtol=1e-12, atol=1e-12)
    single = infer(LESS(0.7), OUTSIDE[[1]], ALTERNATIVES, THETAS, BETAS).log_probability
    np.testing.assert_allclose(posterior_from(values[[1]], THETAS, BETAS).log_probability, single, rtol=1e-13)
    prior = posterior_from(values[:0], THETAS, BETAS, LOG_PRIOR).log_probability
    np.testing.assert_allclose(prior, slow_choice.log_posterior([], LOG_PRIOR), rtol=1e-13)


def test_a_prior_over_thetas_holds_for_every_beta_and_may_exclude() -> None:
    prior = np.where(np.arange(len(THETAS)) == 2, -np.inf, 0.0)
    posterior = infer(Boltzmann(), [3], ALTERNATIVES, THETAS, BETAS, prior)
    assert posterior.marginal_theta[2] == 0
    assert posterior.marginal_theta.sum() == pytest.approx(1, abs=1e-14)
    full = infer(Boltzmann(), [3], ALTERNATIVES, THETAS, BETAS, np.tile(prior[:, None], 3))
    np.testing.assert_array_equal(posterior.log_probability, full.log_probability)


def test_same_inputs_same_bytes() -> None:
    first, second = (infer(LESS(), OUTSIDE, ALTERNATIVES, THETAS, BETAS).log_probability.tobytes() for _ in range(2))
    assert first == second


@pytest.mark.parametrize("model", [Boltzmann(), LESS(0.1), AttributeRule()], ids=lambda m: m.name)
class TestExtremes:
    def test_beta_1e6(self, model) -> None:
        """Utilities 0, 1e6 and 2e6: the log probabilities are these differences, to the last digits."""
        values = log_probabilities(model, [[0.0], [1.0], [2.0]], [1.0], beta=1e6)
        np.testing.assert_allclose(values, [-2e6, -1e6, 0.0], rtol=1e-15, atol=1e-15)

    def test_features_1e8_apart(self, model) -> None:
        rows = [[0.0], [0.5], [1e8]]
        slow = {m.name: s for m, s in MODELS}[model.name]
        slow = slow_choice.less(0.1) if model.name == "less" else slow
        for demonstration in ([1e8 + 0.5], [-0.25]):
            actual = log_likelihood(model, [demonstration], rows, [[1.0], [-1.0]], [1.0])
            expected = [slow_choice.log_likelihood(slow, demonstration, rows, t, 1.0) for t in ([1.0], [-1.0])]
            np.testing.assert_allclose(actual[0, :, 0], expected, rtol=1e-14, atol=1e-12)

    def test_a_common_offset_costs_no_digits(self, model) -> None:
        rows = np.array([[0.0, 1.0], [0.5, 0.25], [0.75, 0.0]])
        near = log_likelihood(model, rows[:1] + 0.125, rows, [[1.0, -2.0]], [3.0])
        far = log_likelihood(model, rows[:1] + 0.125 + 2.0**40, rows + 2.0**40, [[1.0, -2.0]], [3.0])
        np.testing.assert_array_equal(near, far)

    def test_all_alternatives_identical(self, model) -> None:
        rows = np.ones((4, 2))
        np.testing.assert_allclose(log_probabilities(model, rows, [1.0, 2.0], 1e6), -math.log(4), rtol=1e-15)
        posterior = infer(model, [0, 3], rows, [[1.0, 0.0], [0.0, 1.0]])
        np.testing.assert_allclose(posterior.marginal_theta, 0.5, rtol=1e-15)

    def test_one_alternative(self, model) -> None:
        posterior = infer(model, [0], [[3.0]], [[1.0], [-1.0]], [0.1, 10.0])
        np.testing.assert_array_equal(posterior.log_probability, -math.log(4))
        np.testing.assert_allclose(predict(posterior, model, [[3.0]]), 1.0, rtol=1e-15)

    def test_duplicated_demonstrations_count_twice(self, model) -> None:
        once = log_likelihood(model, OUTSIDE[[0]], ALTERNATIVES, THETAS, BETAS)
        twice = infer(model, OUTSIDE[[0, 0]], ALTERNATIVES, THETAS, BETAS)
        wanted = posterior_from(2 * once, THETAS, BETAS)
        np.testing.assert_allclose(twice.log_probability, wanted.log_probability, rtol=1e-13)

    def test_a_demonstration_equal_to_an_alternative_joins_as_its_twin(self, model) -> None:
        twin = log_likelihood(model, ALTERNATIVES[[9]], ALTERNATIVES, THETAS, BETAS)
        member = log_likelihood(model, [40], np.vstack([ALTERNATIVES, ALTERNATIVES[9]]), THETAS, BETAS)
        np.testing.assert_allclose(twin, member, rtol=1e-12, atol=1e-12)


def test_leave_one_out_needs_two_distinct_alternatives() -> None:
    for rows in ([[1.0]], [[1.0], [1.0]]):
        with pytest.raises(BandwidthError, match="at least two distinct rows"):
            infer(LESS(), [0], rows, [[1.0]])


VALID = {"model": Boltzmann(), "demonstrations": [0], "alternatives": [[0.0, 1.0], [1.0, 1.0]], "thetas": [[1.0, 0.0]]}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"alternatives": [[0.0, math.nan], [1.0, 1.0]]}, r"alternatives contains nan at \[0, 1\]"),
        ({"alternatives": np.empty((0, 2))}, "alternatives is empty"),
        ({"alternatives": [0.0, 1.0]}, r"alternatives has shape \(2,\)"),
        ({"demonstrations": [[0.0, math.inf]]}, "demonstrations contains inf"),
        ({"demonstrations": [[0.0, 1.0, 2.0]]}, "demonstrations has 3 columns where 2 are needed"),
        ({"demonstrations": []}, r"demonstrations has shape \(0,\)"),
        ({"demonstrations": np.empty(0, dtype=int)}, "one or more rows"),
        ({"demonstrations": np.empty((0, 2))}, "demonstrations is empty"),
        ({"demonstrations": [2]}, "rows between 0 and 1 are needed"),
        ({"demonstrations": [-1]}, "rows between 0 and 1 are needed"),
        ({"demonstrations": [0.0, 1.0]}, r"demonstrations has shape \(2,\)"),
        ({"demonstrations": [True, False]}, "demonstrations cannot be read"),
        ({"thetas": [[1.0]]}, "thetas has 1 columns where 2 are needed"),
        ({"thetas": [1.0, 0.0]}, r"thetas has shape \(2,\)"),
        ({"thetas": [[math.nan, 0.0]]}, "thetas contains nan"),
        ({"betas": [1.0, 0.0]}, "betas contains 0"),
        ({"betas": [-1.0]}, "betas contains -1"),
        ({"betas": []}, "betas has shape"),
        ({"betas": [math.nan]}, "betas contains nan"),
        ({"betas": 2.0}, r"betas has shape \(\)"),
        ({"log_prior": [0.0, 0.0]}, "log_prior has shape"),
        ({"log_prior": [math.nan]}, "log_prior holds"),
        ({"log_prior": [-math.inf]}, "log_prior holds"),
        (
            {"betas": [1e140], "thetas": [[1e140, 0.0]], "alternatives": [[1e140, 0], [0, 0]]},
            "beyond the largest double",
        ),
        ({"similarity": [[0.0], [math.nan]]}, r"similarity contains nan at \[1, 0\]"),
        ({"similarity": [[0.0]]}, "similarity has shape [(]1, 1[)]; two axes with 2 rows"),
        ({"similarity": np.eye(2), "demonstration_similarity": np.eye(2)}, "leave it out"),
        ({"demonstrations": [[0.0, 0.0]], "similarity": np.eye(2)}, "give both or neither"),
        ({"demonstrations": [[0.0, 0.0]], "demonstration_similarity": [[1.0, 0.0]]}, "give both or neither"),
    ],
)
def test_refusals(changed: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        infer(**VALID | changed)


def test_posterior_from_refuses_other_shapes_and_nan() -> None:
    with pytest.raises(ArgumentError, match="log_likelihoods has shape"):
        posterior_from(np.zeros((3, 2, 2)), [[1.0]], [1.0])
    with pytest.raises(ArgumentError, match="without NaN"):
        posterior_from([[[math.nan]]], [[1.0]], [1.0])
    with pytest.raises(ArgumentError, match="excludes every hypothesis"):
        posterior_from([[[-math.inf]]], [[1.0]], [1.0])


def test_a_model_that_turns_the_weights_upside_down_is_refused() -> None:
    class Upside:
        name = "upside"

        def weigh(self, compared: object) -> WeightedSet:
            log_w = np.array([0.0, -2000.0])
            return WeightedSet(log_w, lambda row: (log_w[::-1], 0.0))

    with pytest.raises(ArgumentError, match="changes a log weight of the set by 2000"):
        log_likelihood(Upside(), [[0.5]], [[0.0], [1.0]], thetas=[[1.0]])
