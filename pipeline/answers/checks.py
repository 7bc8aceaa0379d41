"""The numbers behind a verdict, each from arrays: how far the answer holds under other choices, and whether people fit
in.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.spatial import cKDTree

from pipeline.answers.words import stated_signs
from pipeline.arrays import FloatArray
from pipeline.choice.metrics import angle_to
from pipeline.choice.prediction import PredictiveCheck
from pipeline.choice.validation import matrix
from pipeline.choice.weights import WeightDraws
from pipeline.choice.weights.prior import DEFAULT, WeightPrior
from pipeline.errors import ArgumentError


def departure(answer: WeightDraws, others: Sequence[WeightDraws]) -> float:
    """How far other ways of computing lead from the answer: the largest credible level at which one's direction lies.

    At 0.5 the other's mean direction is as far from ours as half of our own belief; beyond 0.9 it is a direction that
    our answer all but excludes. A stated sign that another contradicts counts as 1.

    Raises:
        ArgumentError: there are no others.
    """
    if not others:
        raise ArgumentError("others is empty; without another computation nothing was checked.")
    return max(1.0 if contradicted(answer, other) else answer.within(other.direction) for other in others)


def contradicted(answer: WeightDraws, other: WeightDraws) -> bool:
    """Whether the other holds a sign that the answer states for less probable than not."""
    signs = stated_signs(answer)
    return bool(np.any((signs != 0) & (np.where(signs > 0, other.positive, 1 - other.positive) < 0.5)))


def truth_level(truth: FloatArray, answer: WeightDraws, others: Sequence[WeightDraws] = ()) -> float:
    """Credible level at which the true direction lies, 1 if a stated sign is wrong.

    A sign is wrong if it is not that of the people's mean, or if a third of the people want the opposite. The level is
    the lowest over the answer and the other ways of computing it, as the angle that is said to hold the direction is
    the widest of theirs.

    Args:
        truth: (P, F) people's true directions.
        answer: whose direction and signs are judged.
        others: the other ways.
    """
    mean, signs = truth.mean(axis=0), stated_signs(answer)
    if bool(np.any((np.sign(mean) * signs < 0) | ((np.sign(truth) * signs < 0).mean(axis=0) >= 1 / 3))):
        return 1.0
    angle = angle_to(answer.direction, mean)
    return min(draws.nearer(answer.direction, angle) for draws in (answer, *others))


def end_gap(demonstrations: FloatArray, alternatives: FloatArray) -> float:
    """How far people start or end from where the alternatives do, relative to the way from start to goal.

    In space and not in joint angles: an arm with a joint to spare reaches one place in many ways.

    Args:
        demonstrations: (n, T, 3) m, positions of the end effector.
        alternatives: (N, T, 3) m; all have the same ends.

    Returns:
        The median over demonstrations of the greater gap of the two ends.

    Raises:
        ArgumentError: the alternatives end where they start.
    """
    ends, theirs = alternatives[0, [0, -1]], demonstrations[:, [0, -1]]
    way = float(np.linalg.norm(ends[1] - ends[0]))
    if not way > 0:
        raise ArgumentError("alternatives end where they start, so no gap can be compared with their way.")
    return float(np.median(np.linalg.norm(theirs - ends, axis=2).max(axis=1))) / way


def outside_share(demonstrations: ArrayLike, alternatives: ArrayLike) -> float:
    """Share of demonstrations farther from every alternative than 99 of 100 alternatives are from each other.

    Args:
        demonstrations: (n, F) scaled features.
        alternatives: (N, F) scaled features, N >= 2.
    """
    rows = matrix("alternatives", alternatives)
    chosen = matrix("demonstrations", demonstrations, columns=rows.shape[1])
    if len(rows) < 2:
        raise ArgumentError("alternatives has one row; two or more are needed to say how far apart they are.")
    tree = cKDTree(rows)
    apart = np.quantile(np.asarray(tree.query(rows, k=2)[0])[:, 1], 0.99)
    return float(np.mean(np.asarray(tree.query(chosen)[0]) > apart))


def surprise(check: PredictiveCheck, level: float = 0.05) -> float:
    """Probability that chance puts as many demonstrations beyond `level` in the feature where most are, of F
    features.
    """
    count, features = check.p_value.shape
    most = int(check.beyond(level).max())
    tail = 1.0 if most == 0 else float(special.bdtrc(most - 1, count, level))
    return float(min(1.0, features * tail))


def edge_probability(draws: WeightDraws, prior: WeightPrior = DEFAULT) -> float:
    """Posterior probability of the prior's largest scale: people more decided than it foresees would pile up there."""
    return float(draws.by_scale(prior)[0][-1])


def grid_edge_probability(marginal_beta: FloatArray) -> float:
    """Posterior probability of the grid's first and last beta."""
    if len(marginal_beta) < 3:
        raise ArgumentError(f"marginal_beta has {len(marginal_beta)} entries; a grid with an inside has three or more.")
    return float(marginal_beta[0] + marginal_beta[-1])
