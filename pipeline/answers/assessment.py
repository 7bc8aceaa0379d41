"""From demonstrations and alternatives in memory to the answer and the numbers behind its verdict.

The answer is the group's weights under LESS. Everything else is another way of computing it, or a check of whether
these people fit these alternatives. What is not given is not checked, and the verdict says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np

from pipeline.answers.calibration import calibrate, recover
from pipeline.answers.checks import departure, edge_probability, outside_share, surprise, truth_level
from pipeline.answers.verdict import OVER_SPACE, RULES, Numbers, Verdict, judge
from pipeline.answers.words import stated_signs
from pipeline.arrays import FloatArray
from pipeline.choice import LESS, Boltzmann, select_bandwidth
from pipeline.choice.explored import ExploredSpace, Region
from pipeline.choice.models import Model
from pipeline.choice.prediction import PredictiveCheck, effective_alternatives, predictive, predictive_check
from pipeline.choice.weights import (
    Choices,
    GroupDraws,
    GroupPrior,
    WeightDraws,
    WeightPrior,
    sample_group,
    sample_weights,
)
from pipeline.choice.weights.choices import SeparateChoices
from pipeline.choice.weights.held_out import leave_one_out
from pipeline.choice.weights.hierarchy import DEFAULT_GROUP

_WIDTHS = 0.5, 2.0  # of the kernel, beside its own
_LIKELY = 0.05  # probability from which on a scale of the prior is one that might be


@dataclass(frozen=True, eq=False)
class Case:
    """What an answer is computed from.

    Attributes:
        alternatives: (N, F) raw features of what all demonstrations were chosen from; or n such sets, one for each.
        demonstrations: (n, F) raw.
        people: (n,) who gave each demonstration.
        other_samplers: what other samplers drew from the same choice space, each as `alternatives`; there may be none.
        end_gap: see `checks.end_gap`; None if it was not looked at.
        repetitions: simulated repetitions for the coverage; 0 leaves it unchecked.
        scale: (F,) what features are divided by; None: their range over the alternatives.
        bandwidth: of LESS, in scaled features; None: selected.
        truth: (P, F) true directions on scaled features, of simulated people; None if nobody knows.
        remarks: recordings that were refused, cut off or repaired; None if it was not looked at.
        space: the choice space, if it was explored. Then it, and not the alternatives, is what people chose from.
        unsettled: how far its explorations' posteriors are from agreeing, in multiples of what is tolerated.
    """

    alternatives: FloatArray | Sequence[FloatArray]
    demonstrations: FloatArray
    people: Sequence[str]
    other_samplers: tuple[FloatArray | Sequence[FloatArray], ...] = ()
    end_gap: float | None = None
    repetitions: int = 40
    scale: FloatArray | None = None
    bandwidth: float | None = None
    truth: FloatArray | None = None
    remarks: int | None = None
    space: ExploredSpace | None = None
    unsettled: float | None = None

    @property
    def shared(self) -> bool:
        """Whether all demonstrations were chosen from one set."""
        return isinstance(self.alternatives, np.ndarray)

    @cached_property
    def divisor(self) -> FloatArray:
        """(F,) what features are divided by."""
        return np.ptp(_pooled(self.alternatives), axis=0) if self.scale is None else self.scale

    @cached_property
    def rows(self) -> FloatArray | tuple[FloatArray, ...]:
        """The alternatives in scaled features."""
        return _divided(self.alternatives, self.divisor)

    @cached_property
    def others(self) -> tuple[FloatArray | tuple[FloatArray, ...], ...]:
        """Those of other samplers in scaled features."""
        return tuple(_divided(sets, self.divisor) for sets in self.other_samplers)

    @cached_property
    def chosen(self) -> FloatArray:
        """(n, F) the demonstrations in scaled features."""
        return self.demonstrations / self.divisor

    @cached_property
    def sigma(self) -> float:
        """Bandwidth of LESS; of several sets, the median."""
        if self.bandwidth is not None:
            return self.bandwidth
        sets = [self.rows] if isinstance(self.rows, np.ndarray) else self.rows
        return float(np.median([select_bandwidth(rows).value for rows in sets]))

    def considered(self, model: Model) -> Choices | SeparateChoices:
        """The demonstrations and what they were chosen from: the explored space, or else the alternatives."""
        if self.space is None:
            return choices_from(model, self.chosen, self.rows)
        return Choices.over(self.space.region(model.name), self.chosen)

    def groups(self) -> dict[str, list[int]]:
        """By person, in order of their names, the demonstrations that they gave."""
        return {name: [n for n, who in enumerate(self.people) if who == name] for name in sorted(set(self.people))}


Sets = FloatArray | tuple[FloatArray, ...]


def choices_from(model: Model, chosen: FloatArray, rows: Sets) -> Choices | SeparateChoices:
    """Demonstrations (n, F) that join the alternatives that they were chosen from, all scaled."""
    if isinstance(rows, np.ndarray):
        return Choices.outside(model, chosen, rows)
    parts = (Choices.outside(model, one[None], own) for one, own in zip(chosen, rows, strict=True))
    return SeparateChoices(tuple(parts))


def _pooled(sets: FloatArray | Sequence[FloatArray]) -> FloatArray:
    return sets if isinstance(sets, np.ndarray) else np.concatenate(list(sets))


def _divided(sets: FloatArray | Sequence[FloatArray], divisor: FloatArray) -> Sets:
    return sets / divisor if isinstance(sets, np.ndarray) else tuple(one / divisor for one in sets)


def _halves(rng: np.random.Generator, sets: Sets) -> tuple[Sets, Sets]:
    """Two random halves of every set."""
    if isinstance(sets, np.ndarray):
        half = rng.permutation(len(sets)) % 2
        return sets[half == 0], sets[half == 1]
    parts = [_halves(rng, one) for one in sets]
    return tuple(np.asarray(one) for one, _ in parts), tuple(np.asarray(other) for _, other in parts)


@dataclass(frozen=True, eq=False)
class Answer:
    """What a case comes to.

    Attributes:
        group: the group's weights on scaled features.
        pooled: the weights of all as if they were one person.
        scale: (F,) what features are divided by.
        ways: the same weights computed in other ways, by name: models, explorations, samplers, bandwidths, scales,
            prior.
        numbers: for the verdict.
        over_space: whether people are taken to have chosen from an explored space.
    """

    group: GroupDraws
    pooled: WeightDraws
    scale: FloatArray
    ways: Mapping[str, tuple[WeightDraws, ...]]
    numbers: Numbers
    over_space: bool = False

    @property
    def verdict(self) -> Verdict:
        """Whether to trust it."""
        return judge(self.numbers, OVER_SPACE if self.over_space else RULES)

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
    together = case.considered(LESS(case.sigma))
    group = sample_group(rng, [together.subset(own) for own in case.groups().values()], prior, count=512)
    answer = group.group
    pooled = sample_weights(rng, together, prior.weights, 2048)
    ways = _other_ways(rng, case, pooled, prior.weights)
    departures = {name: departure(answer, some) for name, some in ways.items()}
    parts = together.parts if isinstance(together, SeparateChoices) else (together,)
    predicted = [predictive(part.alternatives, part.log_w, pooled.omega, pooled.weight) for part in parts]
    numbers = Numbers(
        **departures,
        pareto_k=answer.pareto_k,
        effective_draws=answer.effective,
        stated=float(np.abs(stated_signs(answer)).sum()),
        cap_deg=math.degrees(widest_cap(answer, ways, 0.9)),
        ends=case.end_gap,
        outside=float(np.mean([outside_share(part.chosen, part.alternatives) for part in parts])),
        surprise=surprise(held_out_check(together, pooled)) if together.count > 1 else None,
        alternatives=float(np.median([effective_alternatives(p) for p in predicted])),
        disagreement=group.disagreement if len(case.groups()) > 1 else None,
        divided=float(group.divided(stated_signs(answer)).max()) if len(case.groups()) > 1 else None,
        coverage=_coverage(rng, case, group, prior),
        edge=edge_probability(pooled, prior.weights),
        truth=None if case.truth is None else truth_level(case.truth, answer, [*chain.from_iterable(ways.values())]),
        remarks=case.remarks,
        unsettled=case.unsettled,
    )
    return Answer(group, pooled, case.divisor, ways, numbers, case.space is not None)


def _other_ways(
    rng: np.random.Generator, case: Case, pooled: WeightDraws, prior: WeightPrior
) -> dict[str, tuple[WeightDraws, ...]]:
    """All demonstrations together under everything else that might have been chosen; names as in `Numbers`.

    Over an explored space the bandwidth is that of its kernel, and samplers are not asked: each sees a part of what all
    of them together, and the search, have found.
    """

    def drawn(choices: Choices | SeparateChoices) -> WeightDraws:
        return sample_weights(rng, choices, prior, 1024)

    likely, by_scale = pooled.by_scale(prior)
    found = {
        "models": (drawn(case.considered(Boltzmann())),),
        "scales": (_scaled_otherwise(rng, case, prior),),
        "prior": tuple(part for part, p in zip(by_scale, likely, strict=True) if p >= _LIKELY),
    }
    if case.space is not None:
        smoothed = [Region.mean(case.space.smoothed(factor)) for factor in _WIDTHS]
        found["bandwidths"] = tuple(drawn(Choices.over(region, case.chosen)) for region in smoothed)
        if len(case.space.regions[LESS.name]) > 1:
            parts = case.space.regions[LESS.name]
            found["explorations"] = tuple(drawn(Choices.over(part, case.chosen)) for part in parts)
        return found
    found["bandwidths"] = tuple(drawn(choices_from(LESS(w * case.sigma), case.chosen, case.rows)) for w in _WIDTHS)
    fewest = len(case.rows) if isinstance(case.rows, np.ndarray) else min(map(len, case.rows))
    if fewest >= 8:
        halves = _halves(rng, case.rows)
        found["explorations"] = tuple(drawn(choices_from(LESS(), case.chosen, half)) for half in halves)
    if case.others:
        found["samplers"] = tuple(drawn(choices_from(LESS(), case.chosen, rows)) for rows in case.others)
    return found


def _scaled_otherwise(rng: np.random.Generator, case: Case, prior: WeightPrior) -> WeightDraws:
    """With features scaled by their standard deviation; its weights in the units of the answer."""
    scale = case.divisor
    if case.space is None:
        by_std = _pooled(case.alternatives).std(axis=0)
    else:
        by_std = case.space.region(LESS.name).features.std(axis=0) * scale
    by_std = np.where(by_std > 0, by_std, scale)  # of a feature in which alternatives do not vary
    # the prior speaks of ranges: a standard deviation is a fraction of one
    by_std = by_std * np.exp(np.log(scale / by_std).mean())
    if case.space is None:
        choices = choices_from(LESS(), case.demonstrations / by_std, _divided(case.alternatives, by_std))
    else:  # volumes change by one factor, which changes nothing
        region = case.space.region(LESS.name)
        stretched = Region(region.features * (scale / by_std), region.log_w)
        choices = Choices.over(stretched, case.demonstrations / by_std)
    draws = sample_weights(rng, choices, prior, 1024)
    return WeightDraws(draws.omega * (scale / by_std), draws.log_weight, draws.pareto_k, draws.log_evidence)


def held_out_check(together: Choices | SeparateChoices, pooled: WeightDraws) -> PredictiveCheck:
    """Where each demonstration falls in what is predicted for it from the others."""
    without = np.exp(leave_one_out(pooled, together.log_likelihood(pooled.omega)).log_weight)
    if isinstance(together, Choices):
        p = predictive(together.alternatives, together.log_w, pooled.omega, without)
        return predictive_check(together.alternatives, p, together.chosen)
    found = [
        predictive_check(part.alternatives, predictive(part.alternatives, part.log_w, pooled.omega, own), part.chosen)
        for part, own in zip(together.parts, without, strict=True)
    ]
    return PredictiveCheck(np.concatenate([one.place for one in found]), np.concatenate([one.p_value for one in found]))


def _coverage(rng: np.random.Generator, case: Case, group: GroupDraws, prior: GroupPrior) -> float | None:
    """Of 90 % regions, for people like these who choose from everything that is known of the choice space.

    People who choose from one exploration are inferred with another. None where nothing can be said: each demonstration
    has its own alternatives, there is one exploration, or nothing is to be repeated.
    """
    regions = case.space.regions[LESS.name] if case.space else ()
    if not case.repetitions or not case.shared or len(regions) == 1:
        return None
    truths, count = group.group.resampled(rng, case.repetitions), len(case.demonstrations)
    if regions:
        options, known = regions[:2]
        return recover(
            rng, truths, options, lambda chosen: Choices.over(known, chosen), count, prior.weights, draws=512
        ).coverage()
    rows = _pooled(case.rows)
    found = calibrate(
        rng, {LESS.name: LESS(case.sigma)}, rows, count, case.repetitions, prior.weights, truths=truths,
        pool=np.concatenate([rows, *map(_pooled, case.others)]), count=512,
    )  # fmt: skip
    return found.recoveries[LESS.name, LESS.name].coverage()
