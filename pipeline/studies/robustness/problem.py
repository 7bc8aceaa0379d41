"""The data of the robustness study: demonstrations, hypotheses, and the sets of alternatives to compare."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice import LESS, Boltzmann, angle_to, log_likelihood, select_bandwidth
from pipeline.choice.logspace import log_sum_exp, peak
from pipeline.errors import BandwidthError, StageError
from pipeline.vocabulary import TASK_ANCHOR


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """The demonstrations of a task.

    Attributes:
        ids: the names of n demonstrations.
        participants: for each, the name of the person; one person may have several demonstrations.
        features: (n, F) scaled features.
        truths: for each, the unit vector (F,) of the true reward weights on scaled features; None where not known.
    """

    ids: tuple[str, ...]
    participants: tuple[str, ...]
    features: FloatArray
    truths: tuple[FloatArray | None, ...]

    def rows(self, anchor: str) -> list[int]:
        """Rows of the demonstrations that choose among alternatives with this anchor."""
        return list(range(len(self.ids))) if anchor == TASK_ANCHOR else [self.ids.index(anchor)]


@dataclass(frozen=True, eq=False)
class ChoiceSets:
    """One sampling of alternatives: one set, or one set for each anchor, all of the same size.

    Attributes:
        set_size: N.
        set_id: identifies the sampling among those of its size.
        features: for each anchor, (N, F) scaled features.
        log_proposals: for each anchor, (N,) log density with which the sampler drew each alternative; empty if the
            density is not known.
    """

    set_size: int
    set_id: str
    features: Mapping[str, FloatArray]
    log_proposals: Mapping[str, FloatArray]


Cell = tuple[str, int, tuple[ChoiceSets, ...]]  # regime, set size, samplings


@dataclass(frozen=True, eq=False)
class Problem:
    """Demonstrations, hypotheses, and for each regime the samplings whose posteriors are compared.

    Attributes:
        demonstrations: the n demonstrations.
        regimes: the samplings of each regime.
        thetas: (K, F) unit directions on scaled features.
        betas: (B,) inverse temperatures.
    """

    demonstrations: Demonstrations
    regimes: Mapping[str, tuple[ChoiceSets, ...]]
    thetas: FloatArray
    betas: FloatArray

    @cached_property
    def truth_angles(self) -> tuple[FloatArray | None, ...]:
        """(K,) angles (rad) between every theta and the truth, for each demonstration and for all together.

        The truth for all together is the mean of their directions. The entry is None where the truth is not known.
        """
        truths = self.demonstrations.truths
        directions = [truth for truth in truths if truth is not None]
        mean = np.sum(directions, axis=0) if directions and len(directions) == len(truths) else None
        return tuple(
            None if truth is None else np.array([angle_to(theta, truth) for theta in self.thetas])
            for truth in (*truths, mean)
        )

    def by_size(self, regime: str) -> Iterator[tuple[int, tuple[ChoiceSets, ...]]]:
        """The set sizes of a regime in ascending order, each with its samplings."""
        samplings = self.regimes[regime]
        for size in sorted({sets.set_size for sets in samplings}):
            yield size, tuple(sets for sets in samplings if sets.set_size == size)

    @property
    def cells(self) -> list[Cell]:
        """Every regime and set size, with its samplings."""
        return [(regime, *of_size) for regime in self.regimes for of_size in self.by_size(regime)]

    def rescaled(self, ratio: FloatArray) -> Problem:
        """The problem with every scaled feature multiplied by `ratio` (F,), and the true directions changed alike."""
        demonstrations = replace(
            self.demonstrations,
            features=self.demonstrations.features * ratio,
            truths=tuple(None if truth is None else unit(truth / ratio) for truth in self.demonstrations.truths),
        )
        regimes = {
            name: tuple(
                replace(sets, features={anchor: phi * ratio for anchor, phi in sets.features.items()})
                for sets in samplings
            )
            for name, samplings in self.regimes.items()
        }
        return replace(self, demonstrations=demonstrations, regimes=regimes)


Bandwidths = Mapping[str, float]  # the bandwidth of each anchor's set
Score = Callable[[FloatArray, ChoiceSets, str], FloatArray]
"""From demonstrations (m, F), a sampling and an anchor to log likelihoods (m, K, B)."""


def unit(direction: FloatArray) -> FloatArray:
    """A vector scaled to length one."""
    return np.asarray(direction / np.linalg.norm(direction))


def select_bandwidths(samplings: Sequence[ChoiceSets], method: str | float) -> dict[ChoiceSets, Bandwidths]:
    """Select the bandwidth of every set by `method`, on all cores.

    Raises:
        BandwidthError: a set has fewer than two distinct rows.
    """

    def select(sets: ChoiceSets) -> Bandwidths:
        bandwidths = {}
        for anchor, phi in sets.features.items():
            try:
                bandwidths[anchor] = select_bandwidth(phi, method).value
            except BandwidthError as error:
                raise error.of(sets.set_size, sets.set_id, anchor) from None
        return bandwidths

    with ThreadPoolExecutor() as pool:
        return dict(zip(samplings, pool.map(select, samplings), strict=True))


def boltzmann_score(problem: Problem) -> Score:
    """Log likelihoods under Boltzmann."""

    def score(demonstrations: FloatArray, sets: ChoiceSets, anchor: str) -> FloatArray:
        return log_likelihood(Boltzmann(), demonstrations, sets.features[anchor], problem.thetas, problem.betas)

    return score


def less_score(problem: Problem, selected: Callable[[ChoiceSets], Bandwidths]) -> Score:
    """Log likelihoods under LESS with the bandwidths that `selected` returns for a sampling."""

    def score(demonstrations: FloatArray, sets: ChoiceSets, anchor: str) -> FloatArray:
        model = LESS(bandwidth=selected(sets)[anchor])
        return log_likelihood(model, demonstrations, sets.features[anchor], problem.thetas, problem.betas)

    return score


def log_likelihoods(problem: Problem, samplings: tuple[ChoiceSets, ...], score: Score) -> FloatArray:
    """(R, n, K, B) log likelihoods of each demonstration among the alternatives of each of R samplings.

    Raises:
        StageError: a demonstration has no alternatives that share its anchor.
    """
    people = problem.demonstrations
    values = np.full((len(samplings), len(people.ids), len(problem.thetas), len(problem.betas)), np.nan)
    for r, sets in enumerate(samplings):
        for anchor in sets.features:
            rows = people.rows(anchor)
            values[r, rows] = score(people.features[rows], sets, anchor)
    missing = np.isnan(values).any(axis=(0, 2, 3))
    if missing.any():
        raise StageError(
            f"demonstration {people.ids[int(missing.argmax())]!r} has no alternatives with its anchor; run `dvc repro`"
        )
    return values


def log_posteriors(likelihoods: FloatArray) -> FloatArray:
    """(R, n + 1, K, B) joint log posteriors from (R, n, K, B) log likelihoods; the last is that of all together.

    The prior over hypotheses is uniform, so a posterior is its normalised likelihood; demonstrations are independent.
    """
    relative = likelihoods - peak(likelihoods, axis=(2, 3))
    joint = np.concatenate([relative, relative.sum(axis=1, keepdims=True)], axis=1)
    return np.asarray(joint - log_sum_exp(joint, axis=(2, 3))[..., None, None])


def theta_marginals(joint: FloatArray) -> FloatArray:
    """(R, G, K) log posteriors over theta from (R, G, K, B) joint ones, summed over beta."""
    return log_sum_exp(joint, axis=3)
