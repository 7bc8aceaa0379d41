"""One scale for the features of a task, found on its pool of alternatives, before any model or kernel sees them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ArgumentError

Array = NDArray[np.float64]


def feature_scale(features: Array, method: str | Mapping[str, float], names: Sequence[str]) -> Array:
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
        scale: Array = np.ptp(features, axis=0)
    elif method == "std":
        scale = np.std(features, axis=0)
    else:
        raise ArgumentError(f"features.scale is {method!r}; allowed are range, std, none, or a constant per feature")
    for name, value in zip(names, scale, strict=True):
        # a spread below rounding is no spread: what is left would be noise blown up to size one
        if not value > 1e-12 * np.abs(features[:, names.index(name)]).max():
            raise ArgumentError(
                f"feature {name!r} is the same for all {len(features)} alternatives, so it cannot be scaled; "
                "leave it out, sample wider, or give features.scale as constants"
            )
    return scale
