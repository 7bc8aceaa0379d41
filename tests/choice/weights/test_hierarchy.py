from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from pipeline.choice import LESS, Boltzmann
from pipeline.choice.weights import Choices, GroupPrior, WeightPrior, sample_group, sample_weights
from pipeline.choice.weights.draws import WeightDraws
from pipeline.choice.weights.hierarchy import GroupDraws
from pipeline.choice.weights.joint_mode import find_joint_modes
from pipeline.choice.weights.laplace import find_modes
from pipeline.errors import ArgumentError

ROWS = np.random.default_rng(1).random((30, 1))
PEOPLE = [
    Choices.outside(LESS(0.1), demonstrations, ROWS)
    for demonstrations in ([[0.1], [0.2]], [[0.15]], [[0.8], [0.7], [0.75]])
]
PRIOR = GroupPrior(WeightPrior((1.0, 5.0)), (0.3, 2.0, 8.0))


def quadrature() -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Posterior of the spread (3,), mean of mu, means of the people's weights, and the log evidence, in one
    dimension.
    """
    omega = np.linspace(-80, 80, 8001)
    step = omega[1] - omega[0]
    mu = np.linspace(-30, 30, 601)
    likelihood = np.exp([person.total(omega[:, None]) for person in PEOPLE])
    mass, mean_mu, mean_omega = np.zeros(3), np.zeros(3), np.zeros((3, len(PEOPLE)))
    for index, s in enumerate(PRIOR.spreads):
        kernel = np.exp(-((omega[None] - mu[:, None]) ** 2) / (2 * s**2)) / np.sqrt(2 * np.pi) / s * step
        marginals = kernel @ likelihood.T  # (mu, people)
        joint = np.exp(PRIOR.weights.log_density(mu[:, None])) * marginals.prod(axis=1) * (mu[1] - mu[0])
        mass[index], mean_mu[index] = joint.sum(), (joint * mu).sum()
        mean_omega[index] = ((kernel @ (likelihood * omega).T / marginals) * joint[:, None]).sum(axis=0)
    total = mass.sum()
    return mass / total, mean_mu.sum() / total, mean_omega.sum(axis=0) / total, float(np.log(total / 3))


def test_agrees_with_quadrature_in_one_dimension() -> None:
    spread, mu, omega, log_evidence = quadrature()
    draws = sample_group(np.random.default_rng(0), PEOPLE, PRIOR, count=40_000)
    weight = draws.group.weight
    np.testing.assert_allclose([weight @ (draws.spread == s) for s in PRIOR.spreads], spread, atol=0.01)
    assert draws.group.mean[0] == pytest.approx(mu, abs=0.03)
    found = [draws.person(index).mean[0] for index in range(3)]
    np.testing.assert_allclose(found, omega, atol=0.05)
    assert draws.group.log_evidence == pytest.approx(log_evidence, abs=0.01)


def test_people_all_but_alike_are_one_person() -> None:
    """As the spread falls to zero the group's weights are those of all demonstrations together."""
    alike = sample_group(np.random.default_rng(0), PEOPLE, GroupPrior(WeightPrior((5.0,)), (1e-3,)), count=4000)
    chosen = [[0.1], [0.2], [0.15], [0.8], [0.7], [0.75]]
    together = sample_weights(np.random.default_rng(0), Choices.outside(LESS(0.1), chosen, ROWS), WeightPrior((5.0,)))
    assert alike.group.mean[0] == pytest.approx(together.mean[0], abs=0.03)
    assert alike.group.log_evidence == pytest.approx(together.log_evidence, abs=0.01)


def test_a_wide_spread_leaves_each_person_alone() -> None:
    apart = sample_group(np.random.default_rng(0), PEOPLE, GroupPrior(WeightPrior((0.01,)), (4.0,)), count=30_000)
    alone = sample_weights(np.random.default_rng(0), PEOPLE[1], WeightPrior((4.0,)))
    assert apart.person(1).mean[0] == pytest.approx(alone.mean[0], abs=0.06)


def test_unclear_people_are_drawn_towards_the_group() -> None:
    rng = np.random.default_rng(3)
    rows = rng.random((200, 2))
    likes = np.argsort(rows[:, 0])[:15]
    people = [Choices.of_rows(Boltzmann(), rng.choice(likes, 5), rows) for _ in range(8)]
    people.append(Choices.of_rows(Boltzmann(), [int(np.argmin(np.abs(rows[:, 0] - 0.5)))], rows))
    draws = sample_group(np.random.default_rng(0), people)
    alone = sample_weights(np.random.default_rng(0), people[-1])
    assert draws.group.mean[0] < draws.person(8).mean[0] < alone.mean[0]
    assert draws.disagreement < 0.05
    assert draws.next_person(np.random.default_rng(1)).positive[0] < 0.05


def test_two_groups_who_want_opposite_things_are_seen() -> None:
    rng = np.random.default_rng(3)
    rows = rng.random((200, 2))
    ends = np.argsort(rows[:, 0])
    people = [
        Choices.of_rows(Boltzmann(), rng.choice(side, 4), rows) for side in (ends[:15], ends[-15:]) for _ in range(6)
    ]
    draws = sample_group(np.random.default_rng(0), people)
    assert draws.disagreement > 0.2
    assert draws.group.trusted


def test_joint_modes_have_no_gradient() -> None:
    modes = find_joint_modes(PEOPLE, (5.0,), (2.0,))
    mu = modes.mu[0]
    # profiling the people's weights out, the derivative of mu is that of the sum of their pulls
    pulls = [find_modes(person, mu[None], np.array([2.0])).omega[0] - mu for person in PEOPLE]
    assert sum(pulls)[0] / 4 - mu[0] / 25 == pytest.approx(0, abs=1e-3)


def test_same_stream_same_draws() -> None:
    first, again = (sample_group(np.random.default_rng(4), PEOPLE, count=200) for _ in range(2))
    np.testing.assert_array_equal(first.people, again.people)
    np.testing.assert_array_equal(first.group.log_weight, again.group.log_weight)


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="one or more persons"):
        sample_group(np.random.default_rng(0), [])
    with pytest.raises(ArgumentError, match="100 draws"):
        sample_group(np.random.default_rng(0), PEOPLE, count=3)
    with pytest.raises(ArgumentError, match="spreads"):
        GroupPrior(spreads=(0.0,))


def test_how_probable_it_is_that_a_third_of_people_want_the_opposite() -> None:
    """Draws of mu = 2, 0.4, 0 and -1 with s = 1 say that 2, 34, 50 and 84 % of people have a negative weight."""
    group = WeightDraws(np.array([[2.0], [0.4], [0.0], [-1.0]]), np.log([0.4, 0.3, 0.2, 0.1]), 0.0, 0.0)
    draws = GroupDraws(group, np.ones(4), np.zeros((4, 1, 1)))
    np.testing.assert_allclose(norm.cdf([-2, -0.4, 0, 1]), [0.02, 0.34, 0.5, 0.84], atol=5e-3)
    assert draws.divided([1])[0] == pytest.approx(0.6)
    assert draws.divided([1], share=0.5)[0] == pytest.approx(0.3)
    assert draws.divided([-1])[0] == pytest.approx(0.9)
    assert draws.divided([0])[0] == 0
