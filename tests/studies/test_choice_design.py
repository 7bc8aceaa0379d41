"""Designs of choice sets against brute force over every answer, hypothesis and order."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.choice import LESS, log_probabilities
from pipeline.errors import ArgumentError
from pipeline.studies.choice_design import (
    answer_probabilities,
    candidate_sets,
    design,
    information,
    log_evidence,
    people_to_tell,
)

RNG = np.random.default_rng(3)
THETAS = np.array([[1.0, 0.0], [0.0, 1.0], [0.6, -0.8]])
BETAS = np.array([0.5, 3.0])


def candidate(features: FloatArray) -> FloatArray:
    less = LESS(bandwidth=0.3).log_weights(features)
    return answer_probabilities(features, np.stack([np.zeros(len(features)), less]), THETAS, BETAS)


CANDIDATES = [candidate(RNG.normal(size=(size, 2)) * spread) for size, spread in ((3, 1), (3, 0.2), (2, 1), (3, 2))]


def by_hand(sets: list[int], label: int) -> float:
    """I(label; y), with plain loops over hypotheses and answers; label 0 is the model and 1 is theta."""
    joint: dict[tuple[int, tuple[int, ...]], float] = {}
    shape = CANDIDATES[0].shape[:3]
    total = math.prod(shape)
    for h in itertools.product(*map(range, shape)):
        for answers in itertools.product(*(range(CANDIDATES[s].shape[-1]) for s in sets)):
            p = math.prod(float(CANDIDATES[s][(*h, answer)]) for s, answer in zip(sets, answers, strict=True)) / total
            joint[h[label], answers] = joint.get((h[label], answers), 0.0) + p
    rows: dict[int, float] = {}
    columns: dict[tuple[int, ...], float] = {}
    for (row, column), p in joint.items():
        rows[row] = rows.get(row, 0.0) + p
        columns[column] = columns.get(column, 0.0) + p
    return sum(p * math.log(p / (rows[row] * columns[column])) for (row, column), p in joint.items())


def test_probabilities_are_those_of_the_models() -> None:
    features = RNG.normal(size=(4, 2))
    found = answer_probabilities(features, LESS(0.3).log_weights(features)[None], THETAS, BETAS)
    for k, theta in enumerate(THETAS):
        for b, beta in enumerate(BETAS):
            np.testing.assert_allclose(np.log(found[0, k, b]), log_probabilities(LESS(0.3), features, theta, beta))


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_each_set_is_the_one_that_adds_most_and_its_information_is_exact(share: float) -> None:
    made = design(CANDIDATES, 3, share)
    chosen: list[int] = []
    for step, index in enumerate(made.sets):

        def worth(one: int) -> float:
            sets = [*chosen, one]
            return (1 - share) * by_hand(sets, 0) / math.log(2) + share * by_hand(sets, 1) / math.log(3)

        left = [one for one in range(len(CANDIDATES)) if one not in chosen]
        assert index == max(left, key=worth)
        chosen.append(index)
        assert made.about_model[step] == pytest.approx(by_hand(chosen, 0), abs=1e-12)
        assert made.about_theta[step] == pytest.approx(by_hand(chosen, 1), abs=1e-12)
    np.testing.assert_allclose(made.answers.sum(axis=1), 1)


def test_information_of_known_tables() -> None:
    assert information(np.array([[0.5, 0.0], [0.0, 0.5]])) == pytest.approx(math.log(2))
    assert information(np.full((2, 3), 1 / 6)) == 0


def test_as_many_people_as_said_have_the_power() -> None:
    answers = design(CANDIDATES, 2).answers
    needed = people_to_tell(answers, 1, 0)
    assert needed is not None
    assert needed > 5
    rng, ratio = np.random.default_rng(1), np.log(answers[1] / answers[0])

    def sums(row: int) -> FloatArray:
        return np.asarray(ratio[rng.choice(answers.shape[1], (4000, needed), p=answers[row])].sum(axis=1))

    critical = np.quantile(sums(0), 0.95)
    assert (sums(1) > critical).mean() == pytest.approx(0.8, abs=0.05)
    assert people_to_tell(answers[[0, 0]], 0, 1) is None


def test_evidence_is_the_average_over_each_persons_hypotheses() -> None:
    answers = [[(0, 2), (2, 1)], [(0, 0)], []]
    found = log_evidence(CANDIDATES, answers)
    for model in range(2):
        first = np.mean(CANDIDATES[0][model, ..., 2] * CANDIDATES[2][model, ..., 1])
        assert found[model] == pytest.approx(math.log(first) + math.log(CANDIDATES[0][model, ..., 0].mean()))


def test_candidates_hold_near_ones_and_are_the_same_again() -> None:
    features = np.concatenate([RNG.normal(size=(50, 2)), RNG.normal(size=(50, 2))])
    features[7] = features[3]
    sets = candidate_sets(features, 4, 60, np.random.default_rng(5))
    assert len({tuple(one) for one in sets}) == len(sets) == 60
    assert all(len(set(one)) == 4 and not {3, 7} <= set(one) for one in sets)
    assert sets == candidate_sets(features, 4, 60, np.random.default_rng(5))
    nearest = sorted(np.linalg.norm(features - features[sets[2][0]], axis=1))[1:4]
    closest = [float(np.linalg.norm(features[sets[2][0]] - features[one])) for one in sets[2][1:3]]
    assert closest[0] in nearest
    assert len(candidate_sets(features[:3], 2, 60, np.random.default_rng(5))) <= 6


def test_what_cannot_be_designed_is_refused() -> None:
    with pytest.raises(ArgumentError, match="5 sets are to be picked of 4"):
        design(CANDIDATES, 5)
    with pytest.raises(ArgumentError, match="theta_share is 2"):
        design(CANDIDATES, 1, 2.0)
    with pytest.raises(ArgumentError, match="at least two"):
        design([CANDIDATES[0][:1]], 1)
    wide = [np.full((2, 1, 1, 9), 1 / 9)] * 5
    with pytest.raises(ArgumentError, match="more than 4,096 combinations"):
        design(wide, 4)
    with pytest.raises(ArgumentError, match="of 2 different alternatives"):
        candidate_sets(np.array([[0.0], [0.0], [1.0]]), 3, 5, np.random.default_rng(0))
