from __future__ import annotations

from dataclasses import replace

import pytest

from pipeline.answers.tables import answer_lines, answer_rows
from pipeline.answers.verdict import OVER_SPACE, RULES, Numbers, Outcome, Trust, judge, names
from pipeline.answers.words import Preference

SOUND = Numbers(
    pareto_k=0.2, effective_draws=900, stated=2, cap_deg=15, models=0.3, explorations=0.2, samplers=0.3, bandwidths=0.1,
    scales=0.1, prior=0.1, ends=0.02, outside=0.0, surprise=0.5, alternatives=120, disagreement=0.01, divided=0.01,
    coverage=0.9, edge=0.1, remarks=0,
)  # fmt: skip


def test_every_number_has_a_rule_and_every_rule_a_number() -> None:
    assert set(names()) == set(RULES) | set(OVER_SPACE)


def test_all_yes_is_trust_with_or_without_the_truth() -> None:
    assert judge(SOUND).trust is Trust.TRUST
    assert judge(SOUND).reasons == ()
    assert judge(replace(SOUND, truth=0.4)).trust is Trust.TRUST
    assert judge(replace(SOUND, truth=1.0)).trust is Trust.NOT


@pytest.mark.parametrize("name", [name for name, rule in RULES.items() if rule.needed])
def test_what_was_not_checked_is_not_trusted(name: str) -> None:
    verdict = judge(replace(SOUND, **{name: None}))
    assert verdict.trust is Trust.CAREFUL
    assert [line.outcome for line in verdict.reasons] == [Outcome.NOT_CHECKED]


@pytest.mark.parametrize("name", RULES)
def test_a_number_beyond_its_bound_is_a_no_and_beyond_the_gravest_no_trust(name: str) -> None:
    rule = RULES[name]
    upwards = rule.most < float("inf")
    step = 1e-6 if upwards else -1e-6
    edge = rule.most if upwards else rule.least
    for value, expected in ((edge, Outcome.YES), (edge + step, Outcome.NO)):
        (line,) = (line for line in judge(replace(SOUND, **{name: value})).lines if line.name == name)
        assert line.outcome is expected
    far = 1e9 if upwards else -1e9
    verdict = judge(replace(SOUND, **{name: far}))
    assert verdict.trust is (Trust.CAREFUL if rule.gravest is None else Trust.NOT)


@pytest.mark.parametrize("name", [name for name, rule in RULES.items() if rule.gravest is not None])
def test_not_a_number_is_never_a_yes(name: str) -> None:
    assert judge(replace(SOUND, **{name: float("nan")})).trust is Trust.NOT


def test_between_the_bounds_care_is_called_for() -> None:
    assert judge(replace(SOUND, samplers=0.8)).trust is Trust.CAREFUL
    assert judge(replace(SOUND, samplers=0.96)).trust is Trust.NOT
    assert judge(replace(SOUND, coverage=0.7)).trust is Trust.CAREFUL
    assert judge(replace(SOUND, coverage=0.5)).trust is Trust.NOT


def test_the_gravest_reason_comes_first() -> None:
    verdict = judge(replace(SOUND, models=0.95, outside=0.5, coverage=None))
    assert [line.name for line in verdict.reasons] == ["outside", "models", "coverage"]
    assert str(verdict.reasons[0]) == "Do people stay within the alternatives? no (0.50)"
    assert str(verdict.reasons[2]) == "Do simulated repetitions cover the truth? not checked"


def test_ten_lines() -> None:
    found = [Preference("table", "stay low", -9.0, (-11.0, -7.0), 1.0)]
    lines = answer_lines(answer_rows("table", found, judge(Numbers())))
    assert len(lines) == 10
    assert lines[0] == "table: stay low"
    assert lines[2] == "be careful"
    assert lines[-1].startswith("  and ")
    assert answer_lines(answer_rows("table", found, judge(SOUND)))[-1] == "trust"
