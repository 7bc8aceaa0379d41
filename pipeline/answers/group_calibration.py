"""Simulation-based calibration of groups: their weights, their spread, their people and whoever comes next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.answers.calibration import choose
from pipeline.arrays import FloatArray
from pipeline.choice.models import Model
from pipeline.choice.validation import matrix
from pipeline.choice.weights import Choices, GroupPrior, sample_group
from pipeline.choice.weights.hierarchy import DEFAULT_GROUP


@dataclass(frozen=True, eq=False)
class GroupRecovery:
    """Places of the truth in the posteriors of simulated groups, each uniform if the inference is right.

    Attributes:
        group_place: (R, F) of the group's weights.
        spread_place: (R,) of the spread, ties broken at random.
        person_place: (R, P, F) of each person's weights.
        next_place: (R, F) of the weights of someone new from the group.
        pareto_k: (R,) of the draws.
    """

    group_place: FloatArray
    spread_place: FloatArray
    person_place: FloatArray
    next_place: FloatArray
    pareto_k: FloatArray


def calibrate_group(
    rng: np.random.Generator,
    model: Model,
    alternatives: ArrayLike,
    people: int,
    demonstrations: int,
    repetitions: int,
    prior: GroupPrior = DEFAULT_GROUP,
    count: int = 512,
) -> GroupRecovery:
    """Simulate groups of people with `demonstrations` each, drawn from the prior, and infer them.

    Arguments are those of `calibration.calibrate`; `people` is how many a group has.
    """
    rows = matrix("alternatives", alternatives)
    log_w = model.weigh(rows).log_w
    parts = list(zip(*_groups(rng, rows, log_w, people, demonstrations, repetitions, prior, count), strict=True))
    return GroupRecovery(*(np.array(values) for values in parts))


def _groups(
    rng: np.random.Generator,
    rows: FloatArray,
    log_w: FloatArray,
    people: int,
    demonstrations: int,
    repetitions: int,
    prior: GroupPrior,
    count: int,
) -> Iterator[tuple[FloatArray, float, FloatArray, FloatArray, float]]:
    for _ in range(repetitions):
        mu, spread, omega = prior.draw(rng, people + 1, rows.shape[1])
        chosen = [choose(rng, person, rows, log_w, demonstrations) for person in omega[:-1]]
        draws = sample_group(rng, [Choices(rows, log_w, rows[c], log_w[c]) for c in chosen], prior, count)
        weight = draws.group.weight
        below, same = weight @ (draws.spread < spread), weight @ (draws.spread == spread)
        yield (
            weight @ (draws.group.omega < mu),
            float(below + rng.random() * same),
            np.einsum("s,spf->pf", weight, draws.people < omega[:-1]),
            weight @ (draws.next_person(rng).omega < omega[-1]),
            draws.group.pareto_k,
        )
