"""One scale for the features of a task, found on its pool of alternatives, before any model or kernel sees them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError


@dataclass(frozen=True, eq=False)
class Spread:
    """How far the values of F features spread over some rows. Spreads of parts add up; add them in a fixed order.

    Attributes:
        count: number of rows.
        lower, upper: (F,) least and greatest value.
        mean, variance: (F,) of the rows.
    """

    count: int
    lower: FloatArray
    upper: FloatArray
    mean: FloatArray
    variance: FloatArray

    @classmethod
    def of(cls, features: FloatArray) -> Spread:
        """Of the rows of (N, F)."""
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

    def scale(self, method: str | Mapping[str, float], names: Sequence[str]) -> FloatArray:
        """What each feature is divided by; see `feature_scale`."""
        if isinstance(method, Mapping):
            missing = [name for name in names if name not in method]
            if missing:
                raise ArgumentError(
                    f"features.scale gives constants for {', '.join(sorted(method))}; it lacks {', '.join(missing)}"
                )
            return np.array([method[name] for name in names], dtype=np.float64)
        if method == "none":
            return np.ones(len(names))
        if method == "range":
            scale = self.upper - self.lower
        elif method == "std":
            scale = np.sqrt(self.variance)
        else:
            raise ArgumentError(
                f"features.scale is {method!r}; allowed are range, std, none, or a constant per feature"
            )
        largest = np.maximum(np.abs(self.lower), np.abs(self.upper))
        for name, value, most in zip(names, scale, largest, strict=True):
            # a spread below rounding is no spread: what is left would be noise blown up to size one
            if not value > 1e-12 * most:
                raise ArgumentError(
                    f"feature {name!r} is the same for all {self.count} alternatives, so it cannot be scaled; "
                    "leave it out, sample wider, or give features.scale as constants"
                )
        return np.asarray(scale)


def feature_scale(features: FloatArray, method: str | Mapping[str, float], names: Sequence[str]) -> FloatArray:
    """What each feature is divided by.

    Args:
        features: (N, F) raw values over the task's whole pool of alternatives, so that all its sets share one scale.
        method: `range` (max - min), `std` (population standard deviation), `none` (1), or a constant per name (others are not looked at).
        names: (F,) feature names.

    Returns:
        (F,) positive scales in the features' units.

    Raises:
        ArgumentError: a feature does not vary over the pool, so that it cannot be scaled (nor tell anything), the
            method is unknown, or a constant is missing.
    """
    return Spread.of(features).scale(method, names)
