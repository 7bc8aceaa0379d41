"""One verdict per task, by stated rules from named numbers: trust, be careful, do not trust.

Each rule asks a question about one number. The verdict is the worst that a line allows: a number beyond a rule's
gravest bound means do not trust; any other "no" means be careful, and so does a needed rule that was not checked.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace


class Trust(enum.Enum):
    """The verdict."""

    TRUST = "trust"
    CAREFUL = "be careful"
    NOT = "do not trust"


class Outcome(enum.Enum):
    """What a rule found."""

    YES = "yes"
    NO = "no"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True)
class Numbers:
    """What was measured; None where it was not.

    Departures are credible levels, see `checks.departure`: 0 is no difference, 1 a stated preference that flips.

    Attributes:
        pareto_k: of the draws behind the answer.
        effective_draws: that they are worth.
        stated: preferences whose sign is sure.
        cap_deg: angle within which the direction lies with probability 0.9, whichever way it is computed.
        models: departure of the other choice models.
        explorations: of independent explorations of the choice space, or of halves of the alternatives.
        unsettled: how far the explorations' posteriors of all together, under either model, are apart or have changed
            in the last round, in multiples of what is tolerated.
        samplers: of alternatives from other samplers.
        bandwidths: of half and twice the bandwidth.
        scales: of other scales of the features.
        prior: of other scales of the prior.
        ends: gap between people's ends and those of the alternatives, relative to the way, see `checks.end_gap`.
        outside: share of demonstrations beyond the alternatives.
        surprise: probability of the demonstrations' predictive p values by chance.
        alternatives: effective number that the prediction rests on.
        disagreement: probability that someone new wants the opposite of the group.
        divided: probability that a third of people or more want the opposite of a preference that is stated.
        coverage: of 90 % regions in simulated repetitions of this task.
        edge: probability of the largest beta that was foreseen.
        truth: credible level at which the true direction lies, 1 if a stated sign is wrong; only of simulated people.
        remarks: recordings that were refused, cut off or repaired.
    """

    pareto_k: float | None = None
    effective_draws: float | None = None
    stated: float | None = None
    cap_deg: float | None = None
    models: float | None = None
    explorations: float | None = None
    samplers: float | None = None
    bandwidths: float | None = None
    scales: float | None = None
    prior: float | None = None
    ends: float | None = None
    outside: float | None = None
    surprise: float | None = None
    alternatives: float | None = None
    disagreement: float | None = None
    divided: float | None = None
    coverage: float | None = None
    edge: float | None = None
    truth: float | None = None
    remarks: float | None = None
    unsettled: float | None = None


@dataclass(frozen=True)
class Rule:
    """A question whose answer is yes if the number lies within bounds.

    Attributes:
        question: in words.
        least, most: bounds of the number for a yes.
        gravest: beyond this, on the side of the "no", do not trust; None if a "no" only calls for care.
        needed: whether trust needs a "yes", so that "not checked" is not enough.
        form: how the number is printed.
    """

    question: str
    least: float = float("-inf")
    most: float = float("inf")
    gravest: float | None = None
    needed: bool = True
    form: str = "{:.2f}"


RULES: Mapping[str, Rule] = {
    "truth": Rule("Is the answer near the truth?", most=0.99, gravest=0.99, needed=False),
    "stated": Rule("Is a preference sure enough to be stated?", least=1, form="{:.0f}"),
    "cap_deg": Rule("Is the direction known to better than 45 degrees?", most=45, form="{:.0f} deg"),
    "pareto_k": Rule("Are the draws' weights well-behaved (Pareto k)?", most=0.7, gravest=0.7),
    "effective_draws": Rule("Are there enough effective draws?", least=100, gravest=100, form="{:.0f}"),
    "ends": Rule("Do people start and end where the alternatives do?", most=0.2, gravest=0.4),
    "outside": Rule("Do people stay within the alternatives?", most=0.1, gravest=0.25),
    "alternatives": Rule("Does the answer rest on enough alternatives?", least=30, gravest=15, form="{:.0f}"),
    "surprise": Rule("Do people do what is predicted for them?", least=0.02, gravest=0.001, form="{:.3f}"),
    "explorations": Rule("Do other explorations agree?", most=0.7, gravest=0.95),
    "samplers": Rule("Do other samplers agree?", most=0.7, gravest=0.95),
    "models": Rule("Do the models agree?", most=0.9),
    "bandwidths": Rule("Do other bandwidths agree?", most=0.9),
    "scales": Rule("Do other scales of the features agree?", most=0.9),
    "prior": Rule("Do other priors agree?", most=0.9),
    "disagreement": Rule("Do people want the same?", most=0.1),
    "divided": Rule("Do most people share what is stated?", most=0.05),
    "coverage": Rule("Do simulated repetitions cover the truth?", least=0.8, gravest=0.6),
    "edge": Rule("Are people less decided than the prior's limit?", most=0.5),
    "remarks": Rule("Were all recordings taken as they are?", most=0, needed=False, form="{:.0f}"),
}


_OVER_SPACE: Mapping[str, str] = {
    "outside": "Do people stay within what is possible?",
    "alternatives": "Does the answer rest on enough of the space?",
    "bandwidths": "Do other widths of the kernel agree?",
}
OVER_SPACE: Mapping[str, Rule] = {
    **{
        name: replace(rule, question=_OVER_SPACE.get(name, rule.question))
        for name, rule in RULES.items()
        if name != "samplers"
    },
    "unsettled": Rule(
        "Have the explorations converged, under both models?", most=1, needed=False, form="{:.1f} times the tolerance"
    ),
}
"""The rules for an answer over an explored choice space, which holds whatever any sampler draws."""


@dataclass(frozen=True)
class Line:
    """One rule and what it found.

    Attributes:
        name: of the number.
        question: of the rule.
        outcome: yes, no or not checked.
        number: None if not checked.
        trust: the best verdict that this line allows.
        rule: that was asked.
    """

    name: str
    question: str
    outcome: Outcome
    number: float | None
    trust: Trust
    rule: Rule

    def __str__(self) -> str:
        if self.number is None:
            return f"{self.question} not checked"
        return f"{self.question} {self.outcome.value} ({self.rule.form.format(self.number)})"


@dataclass(frozen=True)
class Verdict:
    """The answer's verdict and its lines, in the order of `RULES`."""

    trust: Trust
    lines: tuple[Line, ...]

    @property
    def reasons(self) -> tuple[Line, ...]:
        """The lines that keep it from trust, the gravest first."""
        order = [Trust.NOT, Trust.CAREFUL]
        return tuple(line for trust in order for line in self.lines if line.trust is trust)


def judge(numbers: Numbers, rules: Mapping[str, Rule] = RULES) -> Verdict:
    """The verdict from named numbers; of an answer over an explored space by `OVER_SPACE`.

    >>> judge(Numbers()).trust.value
    'be careful'
    >>> judge(Numbers(outside=0.5)).trust.value
    'do not trust'
    """
    lines = tuple(_line(name, rule, getattr(numbers, name)) for name, rule in rules.items())
    found = {line.trust for line in lines}
    worst = next((trust for trust in (Trust.NOT, Trust.CAREFUL) if trust in found), Trust.TRUST)
    return Verdict(worst, lines)


def _line(name: str, rule: Rule, number: float | None) -> Line:
    if number is None:
        return Line(name, rule.question, Outcome.NOT_CHECKED, None, Trust.CAREFUL if rule.needed else Trust.TRUST, rule)
    if rule.least <= number <= rule.most:
        return Line(name, rule.question, Outcome.YES, number, Trust.TRUST, rule)
    # a NaN is within no bounds, so it is a no, and as grave as can be
    grave = rule.gravest is not None and not (rule.gravest <= number < rule.least or rule.most < number <= rule.gravest)
    return Line(name, rule.question, Outcome.NO, number, Trust.NOT if grave else Trust.CAREFUL, rule)


def names() -> tuple[str, ...]:
    """The names of all numbers, in the order of `Numbers`."""
    return tuple(field.name for field in fields(Numbers))
