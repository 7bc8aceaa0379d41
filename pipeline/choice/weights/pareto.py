"""Pareto-smoothed importance sampling: weights with a tame tail, and the number that says whether to trust them.

Source: Vehtari, Simpson, Gelman, Yao and Gabry, "Pareto smoothed importance sampling", arXiv 1507.02646; the fit is
    that
of Zhang and Stephens (2009), "A new and efficient estimation method for the generalized Pareto distribution".
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.errors import ArgumentError


def largest_good_shape(count: int) -> float:
    """Above which shape the weights of so many draws are not to be trusted: 1 - 1 / log10(S), at most 0.7."""
    return min(0.7, 1 - 1 / math.log10(count))


def pareto_smoothed(log_ratios: FloatArray) -> tuple[FloatArray, float]:
    """Smooth the largest importance ratios.

    Args:
        log_ratios: (S,) log of target over proposal, up to a constant.

    Returns:
        (S,) normalised log weights, and the shape k of the tail: up to `largest_good_shape` they can be trusted;
        infinite if fewer than five ratios differ in the tail, so that no tail can be fitted.

    Raises:
        ArgumentError: ratios are not finite, apart from -inf.
    """
    ratios = np.asarray(log_ratios, dtype=np.float64)
    if ratios.ndim != 1 or not ratios.size or not np.all(ratios < np.inf) or not ratios.max() > -np.inf:
        raise ArgumentError("log_ratios must be a vector of finite numbers, or -inf for draws that are impossible.")
    count = len(ratios)
    log_w = ratios - ratios.max()
    tail = math.ceil(min(0.2 * count, 3 * math.sqrt(count)))
    if count <= tail:
        return log_w - log_sum_exp(log_w), math.inf
    order = np.argsort(log_w, kind="stable")
    cutoff = max(float(log_w[order[-tail - 1]]), math.log(np.finfo(np.float64).tiny))
    inside = order[log_w[order] > cutoff]
    if len(inside) <= 4:
        return log_w - log_sum_exp(log_w), math.inf
    excess = np.exp(log_w[inside]) - math.exp(cutoff)
    shape, scale = _fitted(excess)
    if math.isfinite(shape):
        quantiles = (np.arange(len(inside)) + 0.5) / len(inside)
        log_w[inside] = np.log(_pareto_quantiles(quantiles, shape, scale) + math.exp(cutoff))
        log_w = np.minimum(log_w, 0.0)  # none above the largest raw ratio
    return log_w - log_sum_exp(log_w), shape


def effective_draws(log_weights: FloatArray) -> float:
    """Kish's effective number of draws, 1 / sum w^2 for normalised weights."""
    normalised = log_weights - log_sum_exp(log_weights)
    return float(np.exp(-log_sum_exp(2 * normalised)))


def _fitted(excess: FloatArray) -> tuple[float, float]:
    """Shape and scale of the generalised Pareto distribution of `excess`, sorted upwards, positive."""
    count = len(excess)
    grid = 30 + int(math.sqrt(count))
    places = 1 - np.sqrt(grid / (np.arange(1.0, grid + 1) - 0.5))
    places /= 3 * excess[int(count / 4 + 0.5) - 1]
    places += 1 / excess[-1]
    shapes = np.log1p(-places[:, None] * excess).mean(axis=1)
    log_profile = count * (np.log(-places / shapes) - shapes - 1)
    weights = np.exp(log_profile - log_sum_exp(log_profile))
    kept = weights >= 10 * np.finfo(np.float64).eps
    weights, places = weights[kept] / weights[kept].sum(), places[kept]
    place = float((places * weights).sum())
    shape = float(np.log1p(-place * excess).mean())
    scale = -shape / place
    return (count * shape + 5) / (count + 10), scale  # ten draws' worth of belief in a shape of 1/2


def _pareto_quantiles(probabilities: FloatArray, shape: float, scale: float) -> FloatArray:
    if abs(shape) < np.finfo(np.float64).eps:
        return np.asarray(-scale * np.log1p(-probabilities))
    return np.asarray(scale * np.expm1(-shape * np.log1p(-probabilities)) / shape)
