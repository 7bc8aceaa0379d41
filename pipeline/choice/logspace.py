"""Sums of exponentials and logs that neither overflow nor raise warnings."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray


def log_sum_exp(values: FloatArray, axis: int | tuple[int, ...] | None = None) -> FloatArray:
    """log sum exp(values) along `axis`; -inf where every term is -inf, and never an overflow."""
    shift = peak(values, axis)
    total = np.sum(np.exp(values - shift), axis=axis, keepdims=True)
    return np.asarray(np.squeeze(log(total) + shift, axis=axis))


def peak(values: FloatArray, axis: int | tuple[int, ...] | None = None) -> FloatArray:
    """The largest value along `axis`, whose length becomes 1; 0 where all are -inf, as -inf - -inf would be NaN."""
    largest = np.max(values, axis=axis, keepdims=True)
    return np.asarray(np.where(np.isfinite(largest), largest, 0.0))


def log(values: FloatArray) -> FloatArray:
    """log(values), where log(0) is -inf and raises no warning."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(values))


def normalised(log_values: FloatArray) -> FloatArray:
    """`log_values` shifted so that their exponentials sum to one over all axes."""
    return np.asarray(log_values - log_sum_exp(log_values))
