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
    return answer.verdict.trust, setup.missed(answer)


@pytest.mark.parametrize("kind", KINDS)
def test_a_missed_truth_is_never_trusted(kind: str) -> None:
    trust, missed = verdict_and_miss(kind, 0)
    assert not (trust is Trust.TRUST and missed)


@pytest.mark.parametrize(
    "kind",
    [
        "8 to 24 alternatives",
        "people beyond the alternatives",
        "wrong ends",
        "narrow sampler, no other to compare",
        "explored, people beyond the space",
        "explored, wrong ends",
    ],
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


def test_an_explored_space_replaces_the_alternatives_and_asks_no_sampler() -> None:
    case = replace(make("explored", 1).case, repetitions=8)
    answer = assess(np.random.default_rng(0), case)
    unlike = replace(case, alternatives=np.asarray(case.alternatives)[:20] ** 3, scale=case.divisor)
    others = assess(np.random.default_rng(0), unlike)
    assert answer.numbers.samplers is None
    assert "samplers" not in {line.name for line in answer.verdict.lines}
    assert answer.numbers.coverage is not None
    assert answer.numbers.explorations is not None
    np.testing.assert_array_equal(answer.group.group.omega, others.group.group.omega)

    assert case.space is not None
    regions = {name: some[:1] for name, some in case.space.regions.items()}
    once = assess(np.random.default_rng(0), replace(case, space=replace(case.space, regions=regions)))
    assert (once.numbers.explorations, once.numbers.coverage) == (None, None)
    assert once.verdict.trust is not Trust.TRUST
