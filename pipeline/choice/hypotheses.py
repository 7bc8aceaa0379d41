"""The reward directions theta over which a posterior is formed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice.kernel.unique_rows import distinct_rows
from pipeline.choice.validation import vector
from pipeline.errors import ArgumentError


def theta_grid(per_feature_values: Sequence[Sequence[float]], sign: int = -1) -> FloatArray:
    """Unit directions from all combinations of per-feature weights, without zero and without duplicates.

    >>> theta_grid([[0, 0.5, 1]] * 3).shape
    (19, 3)

    Args:
        per_feature_values: F sequences of weights, e.g. {0, 1/2, 1} each.
        sign: -1 if the weights are costs (R = beta theta . phi, so a cost has a negative theta), 1 if rewards.

    Returns:
        (K, F) unit vectors, in the order in which `itertools.product` first meets their directions.

    Raises:
        ArgumentError: no feature, a feature without values, values that are not finite, no direction but zero, or
            a sign other than -1 and 1.
    """
    if sign not in (-1, 1):
        raise ArgumentError(f"sign is {sign!r}; it is -1 for costs or 1 for rewards.")
    if len(per_feature_values) == 0:
        raise ArgumentError("per_feature_values is empty; one sequence of weights per feature is needed.")
    values = [vector(f"per_feature_values[{index}]", weights) for index, weights in enumerate(per_feature_values)]
    weights = np.array(list(itertools.product(*values)))
    weights = weights[np.any(weights != 0, axis=1)]
    if len(weights) == 0:
        raise ArgumentError("per_feature_values holds only zeros; a direction needs one weight that is not zero.")
    scaled = weights / np.abs(weights).max(axis=1, keepdims=True)  # so that the norm cannot overflow
    directions = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    # Rounded first: two weight vectors of one direction may differ in their last digits.
    index = distinct_rows(directions.round(12)).index
    first_rows = np.sort(np.unique(index, return_index=True)[1])
    return np.asarray(sign * directions[first_rows] + 0.0)  # -0.0 becomes 0.0
