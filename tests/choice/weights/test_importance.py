from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice import LESS, Boltzmann
from pipeline.choice.weights import Choices, WeightPrior, sample_weights
from pipeline.choice.weights.importance import modes_by_scale
from pipeline.choice.weights.laplace import find_modes, lattice, student_draws, student_log_density
from pipeline.errors import ArgumentError
from tests.oracles import slow_weights

PRIOR = WeightPrior((0.3, 1.0, 3.0, 10.0, 30.0))  # what a grid of moderate reach can hold
MODELS = [Boltzmann(), LESS(0.15)]


def made(model, features: int, demonstrations: int = 3) -> Choices:
    rng = np.random.default_rng(features)
    alternatives = rng.random((25, features))
    return Choices.outside(model, 0.2 + 0.5 * rng.random((demonstrations, features)), alternatives)


def grid_posterior(choices: Choices, points: int) -> tuple[np.ndarray, np.ndarray, float]:
    grid = slow_weights.Grid(choices.features, points, reach=200.0)
    log_joint = slow_weights.mixture_log_density(grid.omega, PRIOR.scales)
    for chosen, own, log_w in zip(choices.chosen, choices.chosen_log_w, choices.joined_log_w, strict=True):
        for start in range(0, len(log_joint), 50_000):
            block = slice(start, start + 50_000)
            log_joint[block] += slow_weights.log_likelihood(
                grid.omega[block], choices.alternatives, log_w, chosen, own, joins=True
            )
    return grid.omega, *grid.posterior(log_joint)


@pytest.mark.parametrize(("features", "points"), [(2, 600), (3, 120)])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_agrees_with_a_fine_grid(model, features: int, points: int) -> None:
    """Means to 1e-3 of a standard deviation, probabilities and the log evidence to 1e-3."""
    choices = made(model, features)
    omega, p, log_evidence = grid_posterior(choices, points)
    draws = sample_weights(np.random.default_rng(1), choices, PRIOR, count=400_000)
    mean = p @ omega
    deviation = np.sqrt(p @ (omega - mean) ** 2)
    np.testing.assert_allclose(draws.mean / deviation, mean / deviation, atol=1e-3)
    assert draws.log_evidence == pytest.approx(log_evidence, abs=1e-3)
    beta, directions = np.linalg.norm(omega, axis=1), omega / np.linalg.norm(omega, axis=1, keepdims=True)
    for level in (1.0, 3.0, 6.0, 12.0):
        assert draws.weight @ (draws.beta < level) == pytest.approx(p @ (beta < level), abs=1e-3)
    np.testing.assert_allclose(draws.weight @ draws.directions, p @ directions, atol=1e-3)
    for probability in (0.1, 0.5, 0.9):
        for column in range(features):
            edge = cell_edge(omega[:, column], p, probability)
            assert draws.weight @ (draws.omega[:, column] < edge) == pytest.approx(
                p @ (omega[:, column] < edge), abs=1e-3
            )


def cell_edge(values: np.ndarray, p: np.ndarray, probability: float) -> float:
    """Near a quantile, the edge between two cells of the grid."""
    axis, index = np.unique(values, return_inverse=True)
    place = int(np.searchsorted(np.cumsum(np.bincount(index, weights=p)), probability))
    return float(np.sinh(np.arcsinh(axis[place : place + 2]).mean()))


def test_same_stream_same_draws_and_order_of_demonstrations_does_not_matter() -> None:
    choices = made(LESS(0.15), 3)
    first, again = (sample_weights(np.random.default_rng(4), choices) for _ in range(2))
    np.testing.assert_array_equal(first.omega, again.omega)
    np.testing.assert_array_equal(first.log_weight, again.log_weight)
    turned = sample_weights(np.random.default_rng(4), choices.subset([2, 0, 1]))
    np.testing.assert_allclose(turned.mean, first.mean, rtol=1e-6)


def test_most_draws_count_even_at_the_rim() -> None:
    """One demonstration, the best of all in one feature: its likelihood does not fall as omega grows."""
    rng = np.random.default_rng(8)
    alternatives = rng.random((300, 3))
    rim = Choices.outside(LESS(0.1), [[-0.1, 0.5, 0.5]], alternatives)
    draws = sample_weights(np.random.default_rng(0), rim)
    assert draws.trusted
    assert draws.effective > 0.4 * len(draws.omega)
    assert draws.beta_interval(0.9)[1] > 15


def test_no_information_gives_the_prior_back() -> None:
    alike = Choices.of_rows(Boltzmann(), [0], [[0.5, 0.5], [0.5, 0.5]])
    draws = sample_weights(np.random.default_rng(0), alike, PRIOR, count=60_000)
    assert draws.log_evidence == pytest.approx(np.log(0.5), abs=2e-3)
    np.testing.assert_allclose(draws.positive, 0.5, atol=5e-3)
    expected = np.linalg.norm(PRIOR.draw(np.random.default_rng(1), 200_000, 2), axis=1)
    for level in (0.5, 3.0, 20.0):
        assert draws.weight @ (draws.beta < level) == pytest.approx((expected < level).mean(), abs=5e-3)


def test_each_scale_alone_is_what_its_own_prior_gives() -> None:
    choices = made(Boltzmann(), 3)
    probabilities, parts = sample_weights(np.random.default_rng(2), choices, PRIOR, count=40_000).by_scale(PRIOR)
    assert probabilities.sum() == pytest.approx(1)
    alone = sample_weights(np.random.default_rng(3), choices, WeightPrior((3.0,)), count=40_000)
    np.testing.assert_allclose(parts[2].mean, alone.mean, atol=0.03)
    assert parts[2].log_evidence == pytest.approx(alone.log_evidence, abs=0.02)


def test_modes_have_no_gradient_and_evidence_is_close() -> None:
    choices = made(LESS(0.15), 3)
    modes = modes_by_scale(choices, PRIOR)
    tau = np.array(PRIOR.scales)
    slope = choices.derivatives(modes.omega).gradient - modes.omega / tau[:, None] ** 2
    np.testing.assert_allclose(slope, 0, atol=1e-4)
    alone = sample_weights(np.random.default_rng(3), choices, WeightPrior((1.0,)), count=20_000)
    assert modes.log_evidence[1] == pytest.approx(alone.log_evidence, abs=0.05)


def test_newton_reaches_a_mode_far_away() -> None:
    choices = Choices.of_rows(Boltzmann(), [0] * 50, [[0.0], [0.001], [1.0]])
    modes = find_modes(choices, np.zeros((1, 1)), np.array([1e4]))
    slope = choices.derivatives(modes.omega).gradient[0, 0] - modes.omega[0, 0] / 1e8
    assert abs(slope) < 1e-6


def test_student_draws_have_their_density() -> None:
    """The expectation of another density over this one is one."""
    curvature, mean = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([1.0, -1.0])
    draws = student_draws(lattice(np.random.default_rng(0), 50_000, 3), mean, curvature)
    log_q = student_log_density(draws, mean, curvature)
    log_p = -0.5 * np.einsum("sf,fh,sh->s", draws - mean, curvature, draws - mean) - np.log(2 * np.pi)
    log_p += 0.5 * np.log(np.linalg.det(curvature))
    assert np.exp(log_p - log_q).mean() == pytest.approx(1, abs=1e-3)


def test_too_few_draws_are_refused() -> None:
    with pytest.raises(ArgumentError, match="100 draws or more"):
        sample_weights(np.random.default_rng(0), made(Boltzmann(), 2), count=10)


@pytest.mark.parametrize("scales", [(), (0.0,), (-1.0, 2.0), (np.nan,)])
def test_scales_of_the_prior_are_positive(scales) -> None:
    with pytest.raises(ArgumentError, match="scales"):
        WeightPrior(scales)
