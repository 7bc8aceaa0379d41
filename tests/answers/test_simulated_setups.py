"""A verdict of "trust" never goes with a missed truth. `python -m benchmarks.verdicts` tries ten of each kind."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.answers.assessment import assess
from pipeline.answers.simulated_setups import KINDS, make, possible, region
from pipeline.answers.verdict import Trust, judge


@cache
def verdict_and_miss(kind: str, seed: int) -> tuple[Trust, bool]:
    setup = make(kind, seed)
    answer = assess(np.random.default_rng([seed, 1]), replace(setup.case, repetitions=20))
    return judge(answer.numbers).trust, setup.missed(answer)


@pytest.mark.parametrize("kind", KINDS)
def test_a_missed_truth_is_never_trusted(kind: str) -> None:
    trust, missed = verdict_and_miss(kind, 0)
    assert not (trust is Trust.TRUST and missed)


@pytest.mark.parametrize(
    "kind",
    ["8 to 24 alternatives", "people beyond the alternatives", "wrong ends", "narrow sampler, no other to compare"],
)
def test_what_is_broken_is_not_trusted(kind: str) -> None:
    assert all(verdict_and_miss(kind, seed)[0] is not Trust.TRUST for seed in (0, 1))


def test_set_ups_are_what_they_say() -> None:
    assert possible(region(np.random.default_rng(0), 500)).all()
    two = make("two groups", 3)
    assert {-1.0, 1.0} == set(np.sign(two.omega @ two.omega[0]))
    assert len(make("one to three people", 3).case.demonstrations) <= 3
    assert not make("narrow sampler, no other to compare", 3).case.other_samplers
    again = make("sound", 3)
    np.testing.assert_array_equal(make("sound", 3).case.demonstrations, again.case.demonstrations)


def test_nothing_is_checked_that_was_not_given() -> None:
    setup = make("sound", 0)
    bare = replace(setup.case, other_samplers=(), end_gap=None, repetitions=0)
    numbers = assess(np.random.default_rng(0), bare).numbers
    assert (numbers.samplers, numbers.ends, numbers.coverage, numbers.truth, numbers.remarks) == (None,) * 5
    assert judge(numbers).trust is not Trust.TRUST


def test_one_demonstration_of_one_person_is_answered_with_care() -> None:
    setup = make("sound", 0)
    one = replace(setup.case, demonstrations=setup.case.demonstrations[:1], people=["p0"], repetitions=0)
    answer = assess(np.random.default_rng(0), one)
    assert answer.numbers.surprise is None
    assert answer.numbers.disagreement is None
    assert judge(answer.numbers).trust is not Trust.TRUST
