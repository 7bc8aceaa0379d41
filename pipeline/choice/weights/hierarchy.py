"""A group of people: what it wants on average, how far people differ, and each person's own weights.

    mu      ~ WeightPrior                   the group's weights
    s       ~ uniform over GroupPrior.spreads   how far people differ, log-spaced
    omega_p ~ N(mu, s^2 I)                  each person's weights
    d       ~ p(d | omega_p)                each demonstration, from its own joined set

People with few or unclear demonstrations are drawn towards the group, others keep their own (partial pooling). Given s
and the prior's scale the joint density is log-concave. Draws of (mu, s) come from Student t's around its modes; the
integral over each person's omega is estimated without bias by a few draws around that person's mode given mu and s, so
the outer weights are exact in expectation (pseudo-marginal importance sampling).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.validation import vector
from pipeline.choice.weights.choices import Likelihood
from pipeline.choice.weights.draws import WeightDraws
from pipeline.choice.weights.joint_mode import JointModes, find_joint_modes
from pipeline.choice.weights.laplace import (
    find_modes,
    gaussian_log_density,
    lattice,
    student_draws,
    student_log_density,
)
from pipeline.choice.weights.pareto import pareto_smoothed
from pipeline.choice.weights.prior import DEFAULT, WeightPrior
from pipeline.errors import ArgumentError

DRAWS = 1024
_INNER = 8  # draws of each person's weights for every draw of the group's
_ROUGH = 1e-3  # nats: a proposal need not stand exactly on the mode
_LEAST_SHARE = 0.002


@dataclass(frozen=True)
class GroupPrior:
    """What is thought of a group before any demonstration.

    Attributes:
        weights: of the group's weights mu.
        spreads: standard deviations s of people's weights around mu, equally probable, in nats per unit of scaled
            feature. The default is log-spaced from 0.1 (people are all but alike) to 31.6.
    """

    weights: WeightPrior = DEFAULT
    spreads: tuple[float, ...] = tuple(float(s) for s in np.geomspace(0.1, 10**1.5, 11).round(3))

    def __post_init__(self) -> None:
        spreads = vector("spreads", self.spreads)
        if not np.all(spreads > 0):
            raise ArgumentError(f"spreads contains {spreads.min():g}; every spread is a positive number.")

    def draw(self, rng: np.random.Generator, people: int, features: int) -> tuple[FloatArray, float, FloatArray]:
        """The group's weights (F,), the spread, and the weights of its people (P, F)."""
        mu = self.weights.draw(rng, 1, features)[0]
        spread = float(rng.choice(np.array(self.spreads)))
        return mu, spread, mu + spread * rng.standard_normal((people, features))


DEFAULT_GROUP = GroupPrior()


@dataclass(frozen=True, eq=False)
class GroupDraws:
    """Weighted draws of a group's weights, its spread and its people's weights, jointly.

    Attributes:
        group: draws of mu, with the diagnostics and the evidence of the whole.
        spread: (S,) draws of s.
        people: (S, P, F) draws of each person's omega.
    """

    group: WeightDraws
    spread: FloatArray
    people: FloatArray

    def person(self, index: int) -> WeightDraws:
        """The weights of one person."""
        return self._of(self.people[:, index])

    def next_person(self, rng: np.random.Generator) -> WeightDraws:
        """The weights of someone new from the same group."""
        noise = rng.standard_normal(self.group.omega.shape)
        return self._of(self.group.omega + self.spread[:, None] * noise)

    @property
    def disagreement(self) -> float:
        """Probability that someone new differs from the group's direction by more than a right angle, given the draws.

        Along the group's direction a person's weights are N(|mu|, s^2), so it is the mean of Phi(-|mu| / s).
        """
        return float(self.group.weight @ ndtr(-self.group.beta / self.spread))

    def divided(self, signs: ArrayLike, share: float = 1 / 3) -> FloatArray:
        """(F,) probability that this share of people or more have a weight of the other sign; 0 where a sign is 0.

        A draw (mu, s) says that Phi(-sign mu / s) of all people do.

        Args:
            signs: (F,) -1, 0 or 1.
            share: of people.
        """
        wanted = np.asarray(signs, dtype=np.float64)
        against = ndtr(-wanted * self.group.omega / self.spread[:, None])
        return np.where(wanted == 0, 0.0, self.group.weight @ (against >= share))

    def _of(self, omega: FloatArray) -> WeightDraws:
        return WeightDraws(omega, self.group.log_weight, self.group.pareto_k, self.group.log_evidence)


def sample_group(
    rng: np.random.Generator, people: Sequence[Likelihood], prior: GroupPrior = DEFAULT_GROUP, count: int = DRAWS
) -> GroupDraws:
    """The joint posterior over a group's weights, its spread and its people's weights.

    Args:
        rng: random stream; the same stream gives the same draws.
        people: the demonstrations of each person, all over the same features.
        prior: of the group.
        count: number of draws, at least 100.

    Returns:
        Weighted draws; `group.pareto_k` and `group.effective` say how far to trust them.

    Raises:
        ArgumentError: no people, different numbers of features, or `count` is too small.
        WorkbenchError: no mode was found.
    """
    if count < 100:
        raise ArgumentError(f"count is {count}; 100 draws or more are needed.")
    if not people or len({person.features for person in people}) != 1:
        raise ArgumentError("people must be one or more persons' choices over the same features.")
    modes = find_joint_modes(people, prior.weights.scales, prior.spreads)
    counts = _allotted(modes.log_evidence, count)
    mu, spread = _outer_draws(rng, modes, counts)
    log_ratio = prior.weights.log_density(mu) - math.log(len(prior.spreads)) - _log_proposal(modes, counts, mu, spread)
    omega = np.empty((len(mu), len(people), mu.shape[1]))
    for index, person in enumerate(people):
        log_marginal, omega[:, index] = _inner_draws(rng, person, mu, spread)
        log_ratio += log_marginal
    log_weight, pareto_k = pareto_smoothed(log_ratio)
    evidence = float(log_sum_exp(log_ratio)) - math.log(len(mu))
    return GroupDraws(WeightDraws(mu, log_weight, pareto_k, evidence), spread, omega)


def _allotted(log_evidence: FloatArray, count: int) -> IndexArray:
    """(C,) how many draws each cell of scale and spread gets."""
    share = np.maximum(np.exp(log_evidence - log_sum_exp(log_evidence)), _LEAST_SHARE)
    return np.asarray(np.maximum(np.round(count * share / share.sum()).astype(np.intp), 1))


def _outer_draws(rng: np.random.Generator, modes: JointModes, counts: IndexArray) -> tuple[FloatArray, FloatArray]:
    size = modes.mu.shape[1]
    mu = [
        student_draws(lattice(rng, int(number), size + 1), mean, curvature)
        for number, mean, curvature in zip(counts, modes.mu, modes.mu_curvature, strict=True)
    ]
    return np.concatenate(mu), np.repeat(modes.spread, counts)


def _log_proposal(modes: JointModes, counts: IndexArray, mu: FloatArray, spread: FloatArray) -> FloatArray:
    """(S,) log of the probability of the spread times the density of mu given it, all scales of the prior together."""
    log_share = np.log(counts / counts.sum())
    found = np.empty(len(mu))
    for value in np.unique(spread):
        rows, cells = spread == value, np.flatnonzero(modes.spread == value)
        parts = [student_log_density(mu[rows], modes.mu[c], modes.mu_curvature[c]) + log_share[c] for c in cells]
        found[rows] = log_sum_exp(np.stack(parts, axis=1), axis=1)
    return found


def _inner_draws(
    rng: np.random.Generator, person: Likelihood, mu: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(S,) unbiased estimates, as logs, of a person's likelihood given mu and s, and (S, F) a draw of its weights."""
    count, size = mu.shape
    modes = find_modes(person, mu, spread, precise=_ROUGH)
    points = (lattice(rng, _INNER, size + 1) + rng.random((count, 1, size + 1))) % 1.0
    points = np.clip(points, 1e-12, 1 - 1e-12).reshape(-1, size + 1)
    mean, curvature = np.repeat(modes.omega, _INNER, axis=0), np.repeat(modes.curvature, _INNER, axis=0)
    omega = student_draws(points, mean, curvature)
    log_prior = gaussian_log_density(omega, np.repeat(mu, _INNER, axis=0), np.repeat(spread, _INNER))
    log_ratio = (person.total(omega) + log_prior - student_log_density(omega, mean, curvature)).reshape(count, _INNER)
    log_marginal = log_sum_exp(log_ratio, axis=1) - math.log(_INNER)
    cumulative = np.cumsum(np.exp(log_ratio - log_sum_exp(log_ratio, axis=1)[:, None]), axis=1)
    picked = (cumulative < rng.random((count, 1)) * cumulative[:, -1:]).sum(axis=1)
    return log_marginal, omega.reshape(count, _INNER, size)[np.arange(count), picked]
