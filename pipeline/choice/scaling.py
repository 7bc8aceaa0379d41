"""Scales of a task's features, computed from its pool of alternatives and used by all models and kernels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import ArgumentError

ROUNDING = 1e-12  # a spread below this share of the largest value is rounding noise


@dataclass(frozen=True, eq=False)
class Spread:
    """How far the values of F features spread over some rows. Spreads of parts add up; add them in a fixed order.

    Attributes:
        count: number of rows.
        lower, upper: (F,) least and greatest value.
        mean, variance: (F,) population mean and variance.
    """

    count: int
    lower: FloatArray
    upper: FloatArray
    mean: FloatArray
    variance: FloatArray

    @classmethod
    def of(cls, features: FloatArray) -> Spread:
        """The spread of features (N, F)."""
        lower, upper = features.min(axis=0), features.max(axis=0)
        return cls(len(features), lower, upper, features.mean(axis=0), features.var(axis=0))

    def __add__(self, other: Spread) -> Spread:
        count = self.count + other.count
        share, step = other.count / count, other.mean - self.mean
        return Spread(
            count,
            np.minimum(self.lower, other.lower),
            np.maximum(self.upper, other.upper),
            self.mean + share * step,
            (1 - share) * self.variance + share * other.variance + share * (1 - share) * step**2,
        )

    @property
    def varies(self) -> BoolArray:
        """(F,) which features are not the same in all rows."""
        largest = np.maximum(np.abs(self.lower), np.abs(self.upper))
        return np.asarray(self.upper - self.lower > ROUNDING * largest)

    def scale(
        self, method: str | Mapping[str, float], names: Sequence[str], demonstrations: Spread | None = None
    ) -> FloatArray:
        """(F,) what each feature is divided by; see `feature_scale`."""
        if isinstance(method, Mapping):
            missing = [name for name in names if name not in method]
            if missing:
                raise ArgumentError(
                    f"features.scale gives constants for {', '.join(sorted(method))}; it lacks {', '.join(missing)}"
                )
            return np.array([method[name] for name in names], dtype=np.float64)
        if method not in ("range", "std", "none"):
            raise ArgumentError(
                f"features.scale is {method!r}; allowed are range, std, none, or a constant per feature"
            )
        if method == "none":
            return np.ones(len(names))
        wider = self if demonstrations is None else self + demonstrations
        scales = self.upper - self.lower if method == "range" else np.sqrt(self.variance)
        return np.where(self.varies, scales, np.where(wider.varies, wider.upper - wider.lower, 1.0))


def feature_scale(
    features: FloatArray,
    method: str | Mapping[str, float],
    names: Sequence[str],
    demonstrations: FloatArray | None = None,
) -> FloatArray:
    """What each feature is divided by.

    A feature that is the same for all alternatives tells nothing about choices among them, so its scale hardly matters.
    If demonstrations differ from the alternatives in it, the scale is the range over both, else 1.

    Args:
        features: (N, F) raw values over the task's whole pool of alternatives, so that all its sets share one scale.
        method: `range` (max - min), `std` (population standard deviation), `none` (1), or constants by name, of which
            those of other features are ignored.
        names: (F,) feature names.
        demonstrations: (n, F) raw values of the demonstrations; None if there are none.

    Returns:
        (F,) positive scales in the features' units.

    Raises:
        ArgumentError: the method is unknown, or a constant is missing.
    """
    further = None if demonstrations is None or not len(demonstrations) else Spread.of(demonstrations)
    return Spread.of(features).scale(method, names, further)
