"""Weights in words: what a cost or a wish for a feature means for how to move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.choice.weights import WeightDraws
from pipeline.errors import ArgumentError

SURE = 0.975  # probability of its sign from which on a preference is stated

_LESS_AND_MORE = {
    "efficiency": ("be brief", "take detours"),
    "path_length": ("go the short way", "go the long way"),
    "height": ("stay low", "stay high"),
    "tilt": ("keep level", "tilt"),
}


@dataclass(frozen=True)
class Preference:
    """What is believed about one feature.

    Attributes:
        feature: its name.
        words: what the more probable sign asks for, e.g. "stay low".
        weight: posterior mean of omega, in nats per unit of scaled feature; negative for a cost.
        interval: (2,) central 0.9 interval of omega.
        probability: that the sign is right.
    """

    feature: str
    words: str
    weight: float
    interval: tuple[float, float]
    probability: float

    @property
    def stated(self) -> bool:
        """Whether the sign is sure enough to be said."""
        return self.probability >= SURE

    def __str__(self) -> str:
        low, high = self.interval
        if not self.stated:
            return f"{self.feature}: not known ({self.words}: probability {self.probability:.2f})"
        return f"{self.words} ({self.feature} {self.weight:+.1f}, 90 % between {low:+.1f} and {high:+.1f})"


def wording(kind: str, name: str, place: str | None, wished: bool) -> str:
    """What it means to want less of a feature, or more if it is `wished`.

    >>> wording("height", "table", None, wished=False)
    'stay low'
    >>> wording("proximity", "near", "laptop", wished=False)
    'keep away from the laptop'

    Args:
        kind: of the feature, as in params.yaml; an unknown one is put by its name.
        name: of the feature.
        place: the object of a proximity.
        wished: whether more of it is better.
    """
    if kind == "proximity":
        return f"pass close to the {place or name}" if wished else f"keep away from the {place or name}"
    less, more = _LESS_AND_MORE.get(kind, (f"less {name}", f"more {name}"))
    return more if wished else less


def preferences(draws: WeightDraws, features: Mapping[str, Mapping[str, object]]) -> tuple[Preference, ...]:
    """Every feature's preference, what is stated first, then by the size of the weight.

    Args:
        draws: of omega on the scaled features.
        features: the F features in order: name -> kind and its arguments, as in params.yaml.

    Raises:
        ArgumentError: there are not F features.
    """
    if len(features) != draws.omega.shape[1]:
        raise ArgumentError(f"features has {len(features)} names for weights of {draws.omega.shape[1]}.")
    found = []
    mean, positive, intervals = draws.mean, draws.positive, draws.interval(0.9)
    for column, (name, spec) in enumerate(features.items()):
        wished = bool(positive[column] > 0.5)
        place = spec.get("object")
        words = wording(str(spec.get("kind")), name, None if place is None else str(place), wished)
        probability = float(max(positive[column], 1 - positive[column]))
        low, high = (float(value) for value in intervals[column])
        found.append(Preference(name, words, float(mean[column]), (low, high), probability))
    order = sorted(range(len(found)), key=lambda index: (not found[index].stated, -abs(found[index].weight)))
    return tuple(found[index] for index in order)


def stated_signs(draws: WeightDraws) -> np.ndarray:
    """(F,) -1 or 1 where the sign of a weight is stated, else 0."""
    positive = draws.positive
    return np.where(positive >= SURE, 1, np.where(positive <= 1 - SURE, -1, 0))


def sentence(found: Sequence[Preference]) -> str:
    """The stated preferences in one phrase, the strongest first.

    >>> sentence([])
    'nothing is known yet'
    """
    words = [preference.words for preference in found if preference.stated]
    return ", ".join(words) if words else "nothing is known yet"
