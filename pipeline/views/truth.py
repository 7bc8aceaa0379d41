"""What simulated people truly want, where the recordings say it: to be marked in every picture of what was inferred."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.choice.metrics import angle_to
from pipeline.studies.robustness.divergence import true_direction

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pipeline.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Truth:
    """What people truly want.

    Attributes:
        people: (n, F) unit vectors of reward weights on scaled features, one for each demonstration.
        mean: (F,) the unit vector of their mean.
        nearest: the hypothesis that is nearest to it in angle.
        apart_rad: that angle.
    """

    people: FloatArray
    mean: FloatArray
    nearest: int
    apart_rad: float


def known_truth(
    stated: Iterable[str | None], features: tuple[str, ...], scale: FloatArray, thetas: FloatArray
) -> Truth | None:
    """The truth, if the recording of every demonstration says it.

    Args:
        stated: for each demonstration, the column `true_theta` of the table `demonstrations`.
        features: names of the F features.
        scale: (F,) what raw values are divided by.
        thetas: (K, F) the hypotheses.
    """
    texts = list(stated)
    if not texts or any(text is None for text in texts):
        return None
    people = [true_direction(json.loads(str(text)), features, scale) for text in texts]
    known = [one for one in people if one is not None]
    mean = np.sum(known, axis=0)
    if len(known) < len(people) or not mean.any():
        return None
    mean = mean / np.linalg.norm(mean)
    angles = [angle_to(theta, mean) if theta.any() else np.pi for theta in np.asarray(thetas)]
    nearest = int(np.argmin(angles))
    return Truth(np.stack(known), mean, nearest, float(angles[nearest]))
