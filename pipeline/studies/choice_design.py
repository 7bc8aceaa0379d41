"""Which choice sets to ask people about: those whose answers are expected to tell most, computed without sampling.

A hypothesis is a model of choice, a weight vector theta and an inverse temperature beta. A person answers all sets with
the same hypothesis, so answers to several sets go together, and what one set tells hangs on those before it. With
p(y | h) the probability of the answers y and a prior of hypotheses, the expected information of y about the model is

I(model; y) = sum_{m, y} p(m, y) log [ p(m, y) / (p(m) p(y)) ],

and likewise about theta. Both are exact: y runs over all combinations of answers.

Source: Lindley (1956), On a measure of the information provided by an experiment; Myung and Pitt (2009), Optimal
experimental design for model discrimination.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log, sqrt

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError

MOST_COMBINATIONS = 4096
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Design:
    """Choice sets in the order in which they were picked.

    Attributes:
        sets: their places among the candidates.
        about_model, about_theta: nats that one person's answers to the sets so far are expected to tell.
        answers: (M, Y) probability of each combination of answers to all of them under each model.
    """

    sets: list[int]
    about_model: list[float]
    about_theta: list[float]
    answers: FloatArray


def answer_probabilities(features: FloatArray, log_w: FloatArray, thetas: FloatArray, betas: FloatArray) -> FloatArray:
    """(M, K, B, k) the probability of each option under each hypothesis.

    Args:
        features: (k, F) scaled features of the options.
        log_w: (M, k) log weights of the options under each model.
        thetas: (K, F).
        betas: (B,).
    """
    utilities = betas[:, None] * np.einsum("kf,nf->kn", thetas, features)[:, None]  # (K, B, k)
    terms = utilities + log_w[:, None, None]
    terms -= terms.max(axis=-1, keepdims=True)
    p = np.exp(terms)
    return np.asarray(p / p.sum(axis=-1, keepdims=True))


def information(joint: FloatArray) -> float:
    """Nats that a column tells about the row, of a table of joint probabilities."""
    rows, columns = joint.sum(axis=1, keepdims=True), joint.sum(axis=0, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(joint > _TINY, joint * np.log(joint / (rows * columns)), 0.0)
    return max(float(terms.sum()), 0.0)


def design(candidates: Sequence[FloatArray], count: int, theta_share: float = 0.0) -> Design:
    """Pick sets one after the other, each the one that adds most to those before it.

    What counts is (1 - s) I(model; y) / log M + s I(theta; y) / log K, with the share s of theta. Models, thetas and
    betas are equally probable beforehand. Of equal sets the first is taken.

    Args:
        candidates: for each set the (M, K, B, k) probabilities from `answer_probabilities`.
        count: how many sets are picked.
        theta_share: s, from 0 to 1.

    Raises:
        ArgumentError: an argument is out of range, or the answers have more than 4,096 combinations.
    """
    if not candidates or not 1 <= count <= len(candidates):
        raise ArgumentError(f"{count} sets are to be picked of {len(candidates)}; give at least one, and no more.")
    if not 0 <= theta_share <= 1:
        raise ArgumentError(f"theta_share is {theta_share}; it must be from 0 to 1.")
    models, thetas, betas, _ = candidates[0].shape
    if models < 2:
        raise ArgumentError("one model alone cannot be told from others; give at least two.")
    so_far = np.full((models, thetas, betas, 1), 1.0 / (models * thetas * betas))  # joint with the answers
    picked, about_model, about_theta = list[int](), list[float](), list[float]()
    left = list(range(len(candidates)))
    for _ in range(count):
        largest = max(candidates[index].shape[-1] for index in left)
        if so_far.shape[-1] * largest > MOST_COMBINATIONS:
            raise ArgumentError(
                f"{count} sets of {largest} options have more than {MOST_COMBINATIONS:,} combinations of answers; ask "
                "for fewer sets or options."
            )
        scored = [(*_told(so_far, candidates[index]), index) for index in left]
        gains = [(1 - theta_share) * m / log(models) + theta_share * t / log(max(thetas, 2)) for m, t, _ in scored]
        model, theta, index = scored[int(np.argmax(np.round(gains, 12)))]
        picked.append(index)
        about_model.append(model)
        about_theta.append(theta)
        left.remove(index)
        so_far = (so_far[..., None] * candidates[index][..., None, :]).reshape(models, thetas, betas, -1)
    return Design(picked, about_model, about_theta, so_far.sum(axis=(1, 2)) * models)


def log_evidence(probabilities: Sequence[FloatArray], answers: Sequence[Sequence[tuple[int, int]]]) -> FloatArray:
    """(M,) log probability of people's answers under each model, nats; each person has a theta and a beta of their own.

    Args:
        probabilities: of each set, from `answer_probabilities`.
        answers: for each person, pairs of a set and the option chosen from it.
    """
    models = probabilities[0].shape[0]
    total = np.zeros(models)
    for person in answers:
        log_p = np.zeros(probabilities[0].shape[:3])
        for index, option in person:
            log_p += np.log(np.maximum(probabilities[index][..., option], _TINY))
        flat = log_p.reshape(models, -1)
        top = flat.max(axis=1)
        total += top + np.log(np.exp(flat - top[:, None]).mean(axis=1))
    return total


def people_to_tell(answers: FloatArray, truth: int, other: int, level: float = 0.05, power: float = 0.8) -> int | None:
    """How many people make a likelihood ratio test reject `other` with this power, if `truth` is right.

    Of the log likelihood ratio of one person, mean and variance are exact under both; its sum over people is taken as
    normal. People differ in theta and beta as the prior does. None if the two predict the same.

    Args:
        answers: (M, Y) from `Design`.
        truth, other: rows of it.
        level, power: of the test.
    """
    from scipy.special import ndtri

    p, q = np.maximum(answers[truth], _TINY), np.maximum(answers[other], _TINY)
    ratio = np.log(p / q)
    apart = float((p - q) @ ratio)  # by how much its mean differs
    if apart < 1e-12:
        return None
    under_truth, under_other = (sqrt(max(float(at @ ratio**2 - (at @ ratio) ** 2), 0.0)) for at in (p, q))
    reach = float(ndtri(1 - level)) * under_other + float(ndtri(power)) * under_truth
    return max(ceil((reach / apart) ** 2), 1)


def candidate_sets(features: FloatArray, options: int, count: int, rng: np.random.Generator) -> list[list[int]]:
    """Sets of alternatives, each with some that are alike and some that are not.

    A set holds one alternative, some of its nearest neighbours, and for the rest others from anywhere. No set stands
    twice. Where models of similarity disagree, it is on sets with near-duplicates; random sets of many rarely have any.

    Args:
        features: (N, F) scaled.
        options: of each set.
        count: at most so many sets.
        rng: source of chance.

    Raises:
        ArgumentError: there are too few alternatives.
    """
    from scipy.spatial import cKDTree

    rows = np.unique(features, axis=0, return_index=True)[1]
    rows.sort()
    if not 2 <= options <= len(rows):
        raise ArgumentError(f"sets of {options} are wanted of {len(rows)} different alternatives; take 2 to as many.")
    tree = cKDTree(features[rows])
    found: dict[tuple[int, ...], None] = {}
    for attempt in range(20 * count):
        if len(found) == count:
            break
        alike = 1 + attempt % (options - 1) if options > 2 else 2 - attempt % 2
        first = int(rng.integers(len(rows)))
        _, near = tree.query(features[rows[first]], k=alike)
        group = [int(index) for index in np.atleast_1d(near)]
        others = np.setdiff1d(np.arange(len(rows)), group)
        rest = rng.choice(others, options - len(group), replace=False)
        found[tuple(int(rows[index]) for index in (*group, *rest.tolist()))] = None
    return [list(one) for one in found]


def _told(so_far: FloatArray, candidate: FloatArray) -> tuple[float, float]:
    """Nats that the answers so far and one more tell about the model, and about theta."""
    about_model = np.einsum("mkby,mkbo->myo", so_far, candidate, optimize=True)
    about_theta = np.einsum("mkby,mkbo->kyo", so_far, candidate, optimize=True)
    return information(about_model.reshape(len(about_model), -1)), information(
        about_theta.reshape(len(about_theta), -1)
    )
