"""Simulated set-ups, sound and broken ones, whose truth is known: does a verdict of "trust" ever go with a missed
truth?

Three features live in a bounded region of the unit cube. People choose from the whole region in proportion to
exp(omega . phi), as LESS does in the limit; the analyst sees alternatives that some sampler drew from it, or has
explored the region.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.answers.assessment import Answer, Case
from pipeline.answers.calibration import choose
from pipeline.answers.words import stated_signs
from pipeline.arrays import FloatArray
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.explored import ExploredSpace, Region, region_log_weights
from pipeline.choice.metrics import angle_to
from pipeline.choice.weights import Choices
from pipeline.choice.weights.laplace import find_modes

_POOL = 6000
_COVERED, _KERNEL = 3000, 0.05  # rows of an exploration, and the width of its kernel in scaled features


@dataclass(frozen=True, eq=False)
class SetUp:
    """A case and the truth behind it.

    Attributes:
        kind: what was done.
        case: what the analyst has.
        omega: (P, F) the people's weights, on the raw features.
    """

    kind: str
    case: Case
    omega: FloatArray

    def missed(self, answer: Answer) -> bool:
        """Whether an answer claims what is not so.

        It does if a stated sign is not that of the people's mean weight, or is wrong for a third of them, or if the
        direction of their mean weights is farther from the answer's than the angle within which it lies with
        probability 0.99.
        """
        omega = self.omega * answer.scale
        mean, signs = omega.mean(axis=0), stated_signs(answer.group.group)
        wrong = (np.sign(mean) * signs < 0) | ((np.sign(omega) * signs < 0).mean(axis=0) >= 1 / 3)
        return bool(wrong.any()) or angle_to(answer.group.group.direction, mean) > answer.cap(0.99)


def make(kind: str, seed: int) -> SetUp:
    """A set-up of one of `KINDS`."""
    return _MAKERS[kind](np.random.default_rng([seed, *kind.encode()]), kind)


def possible(phi: FloatArray) -> np.ndarray:
    """Whether features are in the region: a detour of some length is needed to stay low or far."""
    return np.asarray(phi[:, 0] > 0.5 * (phi[:, 1] - 0.6) ** 2 + 0.4 * (0.7 - phi[:, 2]).clip(0) ** 2 + 0.05)


def region(
    rng: np.random.Generator, count: int, a: FloatArray | float = 1.0, b: FloatArray | float = 1.0
) -> FloatArray:
    """(count, 3) points of the region, by rejection from independent beta distributions; (1, 1) is uniform."""
    found = np.empty((0, 3))
    while len(found) < count:
        drawn = rng.beta(np.broadcast_to(a, 3), np.broadcast_to(b, 3), size=(4 * count, 3))
        found = np.concatenate([found, drawn[possible(drawn)]])
    return found[:count]


def _people(rng: np.random.Generator, count: int, decided: tuple[float, float] = (5, 18)) -> FloatArray:
    direction = rng.standard_normal(3)
    mean = direction / np.linalg.norm(direction) * rng.uniform(*decided)
    return np.asarray(mean + rng.uniform(0.3, 2.5) * rng.standard_normal((count, 3)))


def _demonstrations(rng: np.random.Generator, omega: FloatArray, pool: FloatArray) -> FloatArray:
    """One choice by each person, with a little of a hand's imprecision."""
    rows = [int(choose(rng, person, pool, np.zeros(len(pool)), 1)[0]) for person in omega]
    return np.asarray(pool[rows] + 0.003 * rng.standard_normal((len(omega), 3)))


def _sampled(rng: np.random.Generator, count: int) -> FloatArray:
    """What a broad sampler draws: everywhere, but not evenly."""
    return region(rng, count, rng.uniform(0.7, 1.4, 3), rng.uniform(0.7, 1.4, 3))


def _sound(rng: np.random.Generator, kind: str, people: int = 24, alternatives: int = 600) -> SetUp:
    omega = _people(rng, people)
    demonstrations = _demonstrations(rng, omega, region(rng, _POOL))
    others = tuple(_sampled(rng, alternatives) for _ in range(2))
    names = [f"p{n}" for n in range(people)]
    case = Case(_sampled(rng, alternatives), demonstrations, names, others, end_gap=0.03)
    return SetUp(kind, case, omega)


def _few_people(rng: np.random.Generator, kind: str) -> SetUp:
    return _sound(rng, kind, people=int(rng.integers(1, 4)))


def _few_alternatives(rng: np.random.Generator, kind: str) -> SetUp:
    return _sound(rng, kind, alternatives=int(rng.integers(8, 25)))


def _narrow(rng: np.random.Generator, count: int) -> FloatArray:
    """A sampler that sees one corner of the region."""
    most = rng.uniform(0.4, 0.7, 3)
    found = region(rng, 40 * count)
    inside = found[(found < most).all(axis=1)]
    return inside[:count] if len(inside) >= count // 4 else region(rng, count, 6.0, 6.0)


def _narrow_checked(rng: np.random.Generator, kind: str) -> SetUp:
    sound = _sound(rng, kind)
    return replace(sound, case=replace(sound.case, alternatives=_narrow(rng, 600)))


def _narrow_unchecked(rng: np.random.Generator, kind: str) -> SetUp:
    sound = _narrow_checked(rng, kind)
    return replace(sound, case=replace(sound.case, other_samplers=()))


def _two_groups(rng: np.random.Generator, kind: str) -> SetUp:
    sound = _sound(rng, kind)
    side = np.where(np.arange(len(sound.omega)) < rng.integers(8, 13), -1.0, 1.0)
    omega = sound.omega * side[:, None]
    demonstrations = _demonstrations(rng, omega, region(rng, _POOL))
    return SetUp(kind, replace(sound.case, demonstrations=demonstrations), omega)


def _beyond(rng: np.random.Generator, kind: str) -> SetUp:
    """People choose from a space twice as wide in every feature as what the alternatives show of it."""
    sound = _sound(rng, kind)
    wide = rng.uniform(-0.5, 1.5, size=(8 * _POOL, 3))
    return replace(sound, case=replace(sound.case, demonstrations=_demonstrations(rng, sound.omega, wide)))


def _wrong_ends(rng: np.random.Generator, kind: str) -> SetUp:
    """People start or end elsewhere, which shifts their features; poses tell, features may not.

    A gap of the ends is taken to shift features by half as much, relative to the way and to the features' ranges.
    """
    sound = _sound(rng, kind)
    shift = rng.uniform(0.08, 0.25, 3) * rng.choice([-1, 1], 3)
    gap = 2 * float(np.linalg.norm(shift))
    return replace(sound, case=replace(sound.case, demonstrations=sound.case.demonstrations - shift, end_gap=gap))


def _boltzmann_people(rng: np.random.Generator, kind: str) -> SetUp:
    """People choose from trajectories as the analyst's sampler draws them, unevenly: the other model is right.

    Had they an unevenness of their own that no sampler shares, it would look like a preference, and nothing could tell.
    """
    sound = _sound(rng, kind)
    a, b = rng.uniform(1, 4, size=(2, 3))
    demonstrations = _demonstrations(rng, sound.omega, region(rng, _POOL, a, b))
    case = replace(sound.case, alternatives=region(rng, 600, a, b), demonstrations=demonstrations)
    return replace(sound, case=case)


def _hidden_feature(rng: np.random.Generator, kind: str) -> SetUp:
    """People care most for something that is not among the features.

    What moves with a feature looks like a wish for that feature, and nothing in the data can tell them apart. The truth
    is therefore what the features can say: the weights with which people's expected features are what they are.
    """
    sound = _sound(rng, kind)
    pool = region(rng, _POOL)
    hidden = np.sin(3 * pool @ rng.standard_normal(3)) + pool[:, rng.integers(3)]
    utility = pool @ sound.omega.T + (rng.choice([-1, 1]) * rng.uniform(6, 15) * hidden)[:, None]
    p = np.exp(utility - utility.max(axis=0))
    p /= p.sum(axis=0)
    rows = [int(rng.choice(_POOL, p=column)) for column in p.T]
    described = [_described(pool, column) for column in p.T]
    return SetUp(kind, replace(sound.case, demonstrations=pool[rows]), np.stack(described))


def _described(pool: FloatArray, p: FloatArray) -> FloatArray:
    """(F,) the weights under which the expected features are those of the choices `p` (M,)."""
    nothing = np.zeros(len(pool))
    choices = Choices(pool, nothing, (p @ pool)[None], np.zeros(1))
    return np.asarray(find_modes(choices, np.zeros((1, pool.shape[1])), np.array([100.0])).omega[0])


def _explored(maker: Callable[[np.random.Generator, str], SetUp]) -> Callable[[np.random.Generator, str], SetUp]:
    """The same people, and an analyst who has explored the region twice; what a sampler drew is the base measure."""

    def make_one(rng: np.random.Generator, kind: str) -> SetUp:
        made = maker(rng, kind)
        case = made.case
        known = [region(rng, _COVERED) / case.divisor for _ in range(2)]
        draws = np.asarray(case.alternatives) / case.divisor
        regions = {
            LESS.name: tuple(Region(rows, region_log_weights(rows, _KERNEL)) for rows in known),
            Boltzmann.name: (Region(draws, np.full(len(draws), -np.log(len(draws)))),),
        }
        return replace(made, case=replace(case, other_samplers=(), space=ExploredSpace(regions, _KERNEL)))

    return make_one


_MAKERS: dict[str, Callable[[np.random.Generator, str], SetUp]] = {
    "sound": _sound,
    "sound, 60 people": lambda rng, kind: _sound(rng, kind, people=60),
    "one to three people": _few_people,
    "8 to 24 alternatives": _few_alternatives,
    "narrow sampler": _narrow_checked,
    "narrow sampler, no other to compare": _narrow_unchecked,
    "two groups": _two_groups,
    "people beyond the alternatives": _beyond,
    "wrong ends": _wrong_ends,
    "people follow the other model": _boltzmann_people,
    "a feature is missing": _hidden_feature,
    "explored": _explored(_sound),
    "explored, 60 people": _explored(lambda rng, kind: _sound(rng, kind, people=60)),
    "explored, one to three people": _explored(_few_people),
    "explored, two groups": _explored(_two_groups),
    "explored, people beyond the space": _explored(_beyond),
    "explored, wrong ends": _explored(_wrong_ends),
    "explored, people follow the other model": _explored(_boltzmann_people),
    "explored, a feature is missing": _explored(_hidden_feature),
}
KINDS = tuple(_MAKERS)
