"""From demonstrations and alternatives in memory to the answer and the numbers behind its verdict.

The answer is the group's weights under LESS. Everything else is another way of computing it, or a check of whether
these people fit these alternatives. What is not given is not checked, and the verdict says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from pipeline.answers.calibration import calibrate
from pipeline.answers.checks import departure, edge_probability, outside_share, surprise
from pipeline.answers.verdict import Numbers
from pipeline.answers.words import stated_signs
from pipeline.arrays import FloatArray
from pipeline.choice import LESS, Boltzmann, select_bandwidth
from pipeline.choice.models import Model
from pipeline.choice.prediction import effective_alternatives, predictive, predictive_check
from pipeline.choice.weights import (
    Choices,
    GroupDraws,
    GroupPrior,
    WeightDraws,
    WeightPrior,
    sample_group,
    sample_weights,
)
from pipeline.choice.weights.held_out import leave_one_out
from pipeline.choice.weights.hierarchy import DEFAULT_GROUP

_LIKELY = 0.05  # probability from which on a scale of the prior is one that might be


@dataclass(frozen=True, eq=False)
class Case:
    """What an answer is computed from; features are raw, and scaled by their range over the alternatives.

    Attributes:
        alternatives: (N, F).
        demonstrations: (n, F).
        people: (n,) who gave each demonstration.
        other_samplers: sets (M, F) drawn by other samplers from the same choice space; none if there are none.
        end_gap: see `checks.end_gap`; None if it was not looked at.
        repetitions: simulated repetitions for the coverage; 0 leaves it unchecked.
    """

    alternatives: FloatArray
    demonstrations: FloatArray
    people: Sequence[str]
    other_samplers: tuple[FloatArray, ...] = ()
    end_gap: float | None = None
    repetitions: int = 40


@dataclass(frozen=True, eq=False)
class Answer:
    """What a case comes to.

    Attributes:
        group: the group's weights on scaled features.
        scale: (F,) what features are divided by.
        ways: the same weights computed in other ways, by name: models, explorations, samplers, bandwidths, scales,
            prior.
        numbers: for the verdict.
    """

    group: GroupDraws
    scale: FloatArray
    ways: Mapping[str, tuple[WeightDraws, ...]]
    numbers: Numbers

    def cap(self, level: float) -> float:
        """Angle (rad) around the answer's direction that holds theta with probability `level` whichever way it is
        computed.
        """
        return widest_cap(self.group.group, self.ways, level)


def widest_cap(answer: WeightDraws, ways: Mapping[str, tuple[WeightDraws, ...]], level: float) -> float:
    """The widest of the answer's own cap and those of the other ways around its direction (rad)."""
    everything = [answer, *chain.from_iterable(ways.values())]
    return max(draws.cap(level, about=answer.direction) for draws in everything)


def assess(rng: np.random.Generator, case: Case, prior: GroupPrior = DEFAULT_GROUP) -> Answer:
    """Compute the answer and check it in every way that the case allows."""
    scale = np.ptp(case.alternatives, axis=0)
    rows, chosen = case.alternatives / scale, case.demonstrations / scale
    sigma = select_bandwidth(rows).value
    together = Choices.outside(LESS(sigma), chosen, rows)
    names = sorted(set(case.people))
    each = [together.subset([n for n, who in enumerate(case.people) if who == name]) for name in names]
    group = sample_group(rng, each, prior, count=512)
    answer = group.group
    pooled = sample_weights(rng, together, prior.weights, 2048)
    ways = _other_ways(rng, case, scale, sigma, pooled, prior.weights)
    departures = {name: departure(answer, some) for name, some in ways.items()}
    numbers = Numbers(
        **departures,
        pareto_k=answer.pareto_k,
        effective_draws=answer.effective,
        stated=float(np.abs(stated_signs(answer)).sum()),
        cap_deg=math.degrees(widest_cap(answer, ways, 0.9)),
        ends=case.end_gap,
        outside=outside_share(chosen, rows),
        surprise=_surprise(together, pooled),
        alternatives=effective_alternatives(predictive(rows, together.log_w, pooled.omega, pooled.weight)),
        disagreement=group.disagreement if len(names) > 1 else None,
        coverage=_coverage(rng, case, scale, sigma, group, prior) if case.repetitions else None,
        edge=edge_probability(pooled, prior.weights),
    )
    return Answer(group, scale, ways, numbers)


def _other_ways(
    rng: np.random.Generator, case: Case, scale: FloatArray, sigma: float, pooled: WeightDraws, prior: WeightPrior
) -> dict[str, tuple[WeightDraws, ...]]:
    """All demonstrations together under everything else that might have been chosen; names as in `Numbers`."""
    rows, chosen = case.alternatives / scale, case.demonstrations / scale

    def other(model: Model, alternatives: FloatArray) -> WeightDraws:
        return sample_weights(rng, Choices.outside(model, chosen, alternatives), prior, 1024)

    likely, by_scale = pooled.by_scale(prior)
    found = {
        "models": (other(Boltzmann(), rows),),
        "bandwidths": tuple(other(LESS(factor * sigma), rows) for factor in (0.5, 2.0)),
        "scales": (_scaled_otherwise(rng, case, scale, prior),),
        "prior": tuple(part for part, p in zip(by_scale, likely, strict=True) if p >= _LIKELY),
    }
    if len(rows) >= 8:
        half = rng.permutation(len(rows)) % 2
        found["explorations"] = tuple(other(LESS(), rows[half == part]) for part in (0, 1))
    if case.other_samplers:
        found["samplers"] = tuple(other(LESS(), more / scale) for more in case.other_samplers)
    return found


def _scaled_otherwise(rng: np.random.Generator, case: Case, scale: FloatArray, prior: WeightPrior) -> WeightDraws:
    """With features scaled by their standard deviation; its weights in the units of the answer."""
    by_std = case.alternatives.std(axis=0)
    # the prior speaks of ranges: a standard deviation is a fraction of one
    by_std = by_std * np.exp(np.log(scale / by_std).mean())
    draws = sample_weights(
        rng, Choices.outside(LESS(), case.demonstrations / by_std, case.alternatives / by_std), prior, 1024
    )
    return WeightDraws(draws.omega * (scale / by_std), draws.log_weight, draws.pareto_k, draws.log_evidence)


def _surprise(together: Choices, pooled: WeightDraws) -> float | None:
    if together.count < 2:
        return None
    without = leave_one_out(pooled, together.log_likelihood(pooled.omega))
    p = predictive(together.alternatives, together.log_w, pooled.omega, np.exp(without.log_weight))
    return surprise(predictive_check(together.alternatives, p, together.chosen))


def _coverage(
    rng: np.random.Generator, case: Case, scale: FloatArray, sigma: float, group: GroupDraws, prior: GroupPrior
) -> float:
    """Of 90 % regions, for people like these who choose from everything that is known of the choice space."""
    rows = case.alternatives / scale
    pool = np.concatenate([rows, *(more / scale for more in case.other_samplers)])
    found = calibrate(
        rng, {LESS.name: LESS(sigma)}, rows, len(case.demonstrations), case.repetitions, prior.weights,
        truths=group.group.resampled(rng, case.repetitions), pool=pool, count=512,
    )  # fmt: skip
    return found.recoveries[LESS.name, LESS.name].coverage()
