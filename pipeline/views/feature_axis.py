"""How a feature stands on an axis: the one rule for the viewer and for figures.

A feature that sums over waypoints is shown as its mean per waypoint, so that the height above a table reads in the
metres of the table and not in forty times as many. The robot is at its first waypoint before it moves, so a sum over T
waypoints has T - 1 terms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.vocabulary import GREATEST, LEAST, MEAN, SUM

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pipeline.arrays import FloatArray

_SAID: Mapping[str, str] = {SUM: "mean per waypoint", MEAN: "mean", LEAST: "least", GREATEST: "greatest"}


@dataclass(frozen=True)
class FeatureAxis:
    """The axis of a feature.

    Attributes:
        feature: name of the feature.
        unit: its unit, as written after a number.
        said: how a number on the axis comes of a trajectory, in words; empty if that is not said.
        per: what raw values are divided by.
    """

    feature: str
    unit: str
    said: str = ""
    per: float = 1.0

    @property
    def label(self) -> str:
        """The label of the axis."""
        return with_unit(self.feature, self.unit, self.said)

    def shown(self, raw: ArrayLike) -> FloatArray:
        """Raw values, or bandwidths, as they stand on the axis."""
        return np.asarray(raw, dtype=np.float64) / self.per


def feature_axis(feature: str, unit: str, over_time: str, waypoints: int) -> FeatureAxis:
    """The axis of a feature.

    Args:
        feature: its name.
        unit: its unit.
        over_time: one of `OVER_TIME`: how its raw value comes of a trajectory.
        waypoints: number of waypoints of a trajectory.
    """
    per = float(max(1, waypoints - 1)) if over_time == SUM else 1.0
    return FeatureAxis(feature, unit, _SAID.get(over_time, over_time), per)


def with_unit(name: str, unit: str, said: str = "") -> str:
    """A quantity with its unit in parentheses, and how it comes of a trajectory."""
    inside = ", ".join(filter(None, [unit.replace("^2", "²").replace("^3", "³"), said]))
    return f"{name} ({inside})" if inside else name
