"""Summaries of a task for figures and recordings: densities of its features, hypotheses in words, the replay."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pipeline.arrays import FloatArray, IntArray

_BLOCK_ELEMENTS = 4_000_000
_FRACTIONS = {Fraction(1, 2): "½", Fraction(1, 4): "¼", Fraction(3, 4): "¾", Fraction(1, 3): "⅓"}


@dataclass(frozen=True)
class DensityCurve:
    """The density of alternatives along one feature, with equal weights and with those of LESS.

    Attributes:
        feature: name of the feature.
        unit: its unit, as written after a number.
        grid: (G,) increasing, evenly spaced values in raw units.
        raw: (G,) density per raw unit if every alternative has the same weight.
        adjusted: (G,) density per raw unit if each alternative has its LESS weight.
        demonstrations: (n,) raw values of the demonstrations.
        over_time: how a value comes of a trajectory, in words such as `mean per waypoint`; empty if that is not said.
    """

    feature: str
    unit: str
    grid: FloatArray
    raw: FloatArray
    adjusted: FloatArray
    demonstrations: FloatArray
    over_time: str = ""


@dataclass(frozen=True)
class DensityMap:
    """The density of alternatives over two features.

    Attributes:
        features: names of the horizontal and the vertical feature.
        units: the units of both.
        x: (G,) increasing, evenly spaced values of the first, in raw units.
        y: (H,) increasing, evenly spaced values of the second, in raw units.
        density: (H, G) density per raw unit of both, row h at `y[h]`, column g at `x[g]`.
        adjusted: (H, G) the same if each alternative has its LESS weight; None if that is not known.
        demonstrations: (n, 2) raw values of the demonstrations.
        over_time: the same of both.
    """

    features: tuple[str, str]
    units: tuple[str, str]
    x: FloatArray
    y: FloatArray
    density: FloatArray
    demonstrations: FloatArray
    over_time: tuple[str, str] = ("", "")
    adjusted: FloatArray | None = None


def feature_grid(alternatives: FloatArray, demonstrations: FloatArray, bandwidth: float, size: int) -> FloatArray:
    """Evenly spaced values from two bandwidths below the least value of a feature to two above its largest.

    They do not go beyond zero if no value does: what the kernel puts there is where no trajectory can be.

    Args:
        alternatives: (N,) raw values.
        demonstrations: (n,) raw values.
        bandwidth: sigma of the kernel, in the feature's raw unit.
        size: number of values.

    Returns:
        (size,) values in raw units.
    """
    values = np.concatenate([alternatives, demonstrations])
    low, high = values.min() - 2 * bandwidth, values.max() + 2 * bandwidth
    if values.min() >= 0:
        low = max(low, 0.0)
    elif values.max() <= 0:
        high = min(high, 0.0)
    return np.linspace(low, high, size)


def density_1d(
    values: FloatArray, grid: FloatArray, bandwidth: float, log_weights: FloatArray | None = None
) -> FloatArray:
    """Kernel density of weighted values along one feature.

    f(x) = sum_i w_i N(x; v_i, sigma^2) with w_i = exp(log_w_i) / sum_j exp(log_w_j). With LESS's log weights this is
    the density "adjusted by LESS" of the paper's figure `density`; its kernel is the one that LESS itself uses.

    Args:
        values: (N,) feature values, raw units.
        grid: (G,) values at which the density is computed, raw units.
        bandwidth: sigma in raw units, which is the bandwidth of the scaled features times the feature's scale.
        log_weights: (N,) log weight of each value; all equal if not given.

    Returns:
        (G,) density per raw unit; it integrates to one over the whole line.

    Raises:
        ArgumentError: the bandwidth is not positive, or there is not one weight per value.
    """
    values, grid = np.asarray(values, dtype=np.float64), np.asarray(grid, dtype=np.float64)
    _check_bandwidth(bandwidth)
    weights = _weights(log_weights, values.size)
    density = np.zeros(grid.size)
    step = max(1, _BLOCK_ELEMENTS // grid.size)
    for start in range(0, values.size, step):
        block = slice(start, start + step)
        z = (grid[:, None] - values[block]) / bandwidth  # (G, block)
        density += np.exp(-0.5 * z * z) @ weights[block]
    density /= bandwidth * np.sqrt(2 * np.pi)
    return density


def density_curve(
    feature: str,
    unit: str,
    alternatives: FloatArray,
    demonstrations: FloatArray,
    bandwidth: float,
    less_log_weights: FloatArray,
    size: int = 200,
    over_time: str = "",
) -> DensityCurve:
    """Both densities of one feature; arguments as in `feature_grid` and `density_1d`."""
    grid = feature_grid(alternatives, demonstrations, bandwidth, size)
    return DensityCurve(
        feature=feature,
        unit=unit,
        grid=grid,
        raw=density_1d(alternatives, grid, bandwidth),
        adjusted=density_1d(alternatives, grid, bandwidth, less_log_weights),
        demonstrations=demonstrations,
        over_time=over_time,
    )


def density_map(
    features: tuple[str, str],
    units: tuple[str, str],
    alternatives: FloatArray,
    demonstrations: FloatArray,
    bandwidths: FloatArray,
    size: tuple[int, int] = (120, 90),
    over_time: tuple[str, str] = ("", ""),
    less_log_weights: FloatArray | None = None,
) -> DensityMap:
    """Kernel density of the alternatives over two features.

    f(x, y) = sum_i w_i N(x; x_i, sigma_x^2) N(y; y_i, sigma_y^2): with w_i = 1/N the marginal, over the other
    features, of the density that LESS divides by.

    Args:
        features: names of the two features.
        units: their units.
        alternatives: (N, 2) raw values.
        demonstrations: (n, 2) raw values.
        bandwidths: (2,) sigma in raw units of each.
        size: number of values along the horizontal and the vertical axis.
        over_time: of the two features.
        less_log_weights: (N,) log weight of each alternative under LESS, for the map that it leads to.

    Raises:
        ArgumentError: a bandwidth is not positive, or there is not one weight per alternative.
    """
    axes = [feature_grid(alternatives[:, i], demonstrations[:, i], float(bandwidths[i]), size[i]) for i in (0, 1)]
    count = len(alternatives)
    weights = [_weights(None, count)] + ([] if less_log_weights is None else [_weights(less_log_weights, count)])
    densities = [np.zeros((size[1], size[0])) for _ in weights]
    step = max(1, _BLOCK_ELEMENTS // sum(size))
    for start in range(0, len(alternatives), step):
        part = slice(start, start + step)
        block = alternatives[part]
        # the Gaussian is a product over features: two thin matrices instead of one value per cell and alternative
        along_x, along_y = (_kernel(axes[i], block[:, i], float(bandwidths[i])) for i in (0, 1))
        for density, weight in zip(densities, weights, strict=True):
            density += (along_y * weight[part]) @ along_x.T
    return DensityMap(features, units, axes[0], axes[1], densities[0], demonstrations, over_time, *densities[1:])


def theta_labels(thetas: FloatArray, names: Sequence[str]) -> tuple[str, ...]:
    """Each hypothesis in words: its weights relative to the largest one, without those that are zero.

    Weights that are all costs (none positive) are written without their sign, see `theta_meaning`.
    `(-1, -0.5, 0)` reads "efficiency + ½ table".

    Args:
        thetas: (K, F) weight vectors.
        names: (F,) feature names.

    Returns:
        (K,) labels, all different: if directions repeat, the weights themselves are written.

    Raises:
        ArgumentError: the number of names is not the number of columns.
    """
    thetas = np.asarray(thetas, dtype=np.float64)
    if thetas.ndim != 2 or thetas.shape[1] != len(names):
        raise ArgumentError(f"thetas must be (K, {len(names)}) for {', '.join(names)}; got shape {thetas.shape}.")
    signed = np.abs(thetas) if (thetas <= 0).all() else thetas
    largest = np.abs(signed).max(axis=1, keepdims=True)
    relative = np.divide(signed, largest, out=np.zeros_like(signed), where=largest > 0)
    labels = tuple(_words(row, names) for row in relative)
    if len(set(labels)) == len(labels):
        return labels
    return tuple(" ".join(f"{n} {w:.6g}" for n, w in zip(names, row, strict=True)) for row in signed)


def theta_meaning(thetas: FloatArray) -> str:
    """What the numbers in `theta_labels` mean."""
    if (np.asarray(thetas) <= 0).all():
        return "cost weights, relative to the largest"
    return "reward weights, relative to the largest"


def replay_samples(
    demonstrations: FloatArray, durations_s: FloatArray, steps: int = 5, pause_s: float = 0.5
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Demonstrations one after another on one time line, each with its recorded duration and linear between waypoints.

    Args:
        demonstrations: (n, T, J) waypoints, rad or m, evenly spaced in time.
        durations_s: (n,) s, positive.
        steps: number of samples from one waypoint to the next.
        pause_s: time from the end of one demonstration to the start of the next, s.

    Returns:
        (M, J) configurations, (M,) strictly increasing times in s from 0, and (M,) the row of each sample's
        demonstration, where M = n * ((T - 1) * steps + 1).

    Raises:
        ArgumentError: a duration is not positive, or there is not one per demonstration.
    """
    demonstrations, durations_s = np.asarray(demonstrations, np.float64), np.asarray(durations_s, np.float64)
    n, n_waypoints, n_joints = demonstrations.shape
    if durations_s.shape != (n,) or not (durations_s > 0).all():
        raise ArgumentError(f"durations_s must be {n} positive numbers, one per demonstration; got {durations_s}.")
    position = np.linspace(0.0, n_waypoints - 1.0, (n_waypoints - 1) * steps + 1)
    earlier = np.minimum(position.astype(np.int64), n_waypoints - 2)
    share = (position - earlier)[None, :, None]
    configurations = (1 - share) * demonstrations[:, earlier] + share * demonstrations[:, earlier + 1]
    starts_s = np.concatenate([[0.0], np.cumsum(durations_s + pause_s)[:-1]])
    times_s = starts_s[:, None] + durations_s[:, None] * position / (n_waypoints - 1)
    return configurations.reshape(-1, n_joints), times_s.ravel(), np.repeat(np.arange(n), position.size)


def _words(row: FloatArray, names: Sequence[str]) -> str:
    terms = ""
    for weight, name in zip(row, names, strict=True):
        if weight != 0:
            sign = (" − " if weight < 0 else " + ") if terms else ("−" if weight < 0 else "")
            terms += f"{sign}{_amount(abs(float(weight)))}{name}"
    return terms or "nothing"


def _amount(weight: float) -> str:
    """A weight as text: nothing for 1, a fraction if it is a simple one, else two digits."""
    if abs(weight - 1) < 1e-9:
        return ""
    fraction = Fraction(weight).limit_denominator(4)
    if abs(weight - fraction) < 1e-9 and fraction in _FRACTIONS:
        return f"{_FRACTIONS[fraction]} "
    return f"{weight:.2g} "


def _kernel(grid: FloatArray, values: FloatArray, bandwidth: float) -> FloatArray:
    _check_bandwidth(bandwidth)
    z = (grid[:, None] - values) / bandwidth
    kernel: FloatArray = np.exp(-0.5 * z * z) / (bandwidth * np.sqrt(2 * np.pi))
    return kernel


def _weights(log_weights: FloatArray | None, size: int) -> FloatArray:
    if log_weights is None:
        return np.full(size, 1.0 / size)
    log_weights = np.asarray(log_weights, dtype=np.float64)
    if log_weights.shape != (size,):
        raise ArgumentError(f"log_weights must be ({size},), one per value; got shape {log_weights.shape}.")
    weights = np.exp(log_weights - log_weights.max())
    normalised: FloatArray = weights / weights.sum()
    return normalised


def _check_bandwidth(bandwidth: Any) -> None:
    if not bandwidth > 0:
        raise ArgumentError(f"bandwidth must be a positive number in the feature's raw unit; got {bandwidth}.")
