"""Sensitivity of the robustness study: its measures with one of its choices changed at a time."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray, IntArray
from pipeline.choice import BandwidthWarning
from pipeline.choice.kernel.bandwidth import METHODS
from pipeline.studies.robustness.divergence import measures
from pipeline.studies.robustness.problem import (
    Bandwidths,
    Cell,
    ChoiceSets,
    Problem,
    boltzmann_score,
    less_score,
    log_likelihoods,
    log_posteriors,
    select_bandwidths,
    theta_marginals,
)
from pipeline.studies.robustness.samplings import RobustnessResult
from pipeline.vocabulary import BOLTZMANN, LESS

FACTOR, SELECTOR, SCALE, BETA = "bandwidth", "selector", "scale", "beta"
MARGINAL, JOINT = "marginal", "joint"
Setting = tuple[str, str, str, bool, FloatArray, float | None]
"""Choice, setting, model, whether the study itself uses it, log posteriors (R, n + 1, K'), median bandwidth."""


def vary_choices(
    problem: Problem,
    result: RobustnessResult,
    bandwidth: str | float,
    factors: Sequence[float],
    ratios: Mapping[str, FloatArray],
    scale: str,
    progress: Callable[[Sequence[Cell]], Iterable[Cell]] = iter,
) -> pl.DataFrame:
    """The measures under every setting of each choice, with all other choices as in the study.

    The choices are the `bandwidth` (multiples of the selected one), its `selector`, the `scale` of the features, and
    the treatment of `beta`: summed out (as in the study), kept (posteriors over theta and beta jointly) or fixed.
    Boltzmann has no bandwidth; its rows are repeated for each setting of one, so that each setting compares both
    models.

    Args:
        problem: demonstrations, samplings and hypotheses of the study.
        result: result of the study for this problem.
        bandwidth: how the study selects the bandwidth, or that bandwidth.
        factors: multiples of the selected bandwidth.
        ratios: for each other scale of the features, (F,) factors from the study's scaled features to that scale.
        scale: name of the scale that the study uses.
        progress: wraps the cells of the design while they are gone through, for example in a progress bar.

    Returns:
        `regime`, `choice`, `setting`, `model`, `set_size`, `is_default`, `bandwidth` (median over the samplings, in
        units of the setting's scale; null for Boltzmann), the columns of `measures`, and `map_changed` (share of the
        samplings in which the most probable theta is another one than as the study chose).
    """
    rescaled = {name: problem.rescaled(ratio) for name, ratio in ratios.items()}
    rows = []
    for regime, size, samplings in progress(problem.cells):
        likelihoods = {model: result.likelihoods[regime, size, model] for model in (BOLTZMANN, LESS)}
        settings = [
            *_factors(problem, samplings, likelihoods, result, factors),
            *_selectors(problem, samplings, likelihoods, result, bandwidth),
            *_betas(problem, samplings, likelihoods, result),
        ]
        usual = {model: _best(problem, theta_marginals(log_posteriors(one))) for model, one in likelihoods.items()}
        rows += _rows(problem, regime, size, settings, usual)
        rows += _rows(problem, regime, size, _unchanged(likelihoods, SCALE, scale, result, samplings), usual)
        for name, other in rescaled.items():
            other_samplings = dict(other.by_size(regime))[size]
            rows += _rows(other, regime, size, _rescored(other, other_samplings, name, bandwidth), usual)
    return pl.concat(rows)


def _factors(
    problem: Problem, samplings: tuple[ChoiceSets, ...], likelihoods: Mapping[str, FloatArray],
    result: RobustnessResult, factors: Sequence[float],
) -> Iterator[Setting]:  # fmt: skip
    for factor in factors:
        if factor == 1:
            yield from _unchanged(likelihoods, FACTOR, "1", result, samplings)
            continue
        selected = {
            sets: {anchor: factor * value for anchor, value in result.bandwidths[sets].items()} for sets in samplings
        }
        yield from _with_bandwidths(problem, samplings, likelihoods, FACTOR, f"{factor:g}", selected)


def _selectors(
    problem: Problem, samplings: tuple[ChoiceSets, ...], likelihoods: Mapping[str, FloatArray],
    result: RobustnessResult, bandwidth: str | float,
) -> Iterator[Setting]:  # fmt: skip
    yield from _unchanged(likelihoods, SELECTOR, f"{bandwidth}", result, samplings)
    for method in METHODS:
        if method != bandwidth:
            selected = _selected(samplings, method)
            yield from _with_bandwidths(problem, samplings, likelihoods, SELECTOR, method, selected)


def _betas(
    problem: Problem, samplings: tuple[ChoiceSets, ...], likelihoods: Mapping[str, FloatArray], result: RobustnessResult
) -> Iterator[Setting]:
    for model, values in likelihoods.items():
        width = _median_width(model, result, samplings)
        joint = log_posteriors(values)
        yield BETA, MARGINAL, model, True, theta_marginals(joint), width
        yield BETA, JOINT, model, False, joint.reshape(*joint.shape[:2], -1), width
        for b, beta in enumerate(problem.betas):
            fixed = log_posteriors(values[..., [b]])
            yield BETA, f"{beta:g}", model, False, theta_marginals(fixed), width


def _rescored(
    problem: Problem, samplings: tuple[ChoiceSets, ...], scale: str, bandwidth: str | float
) -> Iterator[Setting]:
    likelihoods = {BOLTZMANN: log_likelihoods(problem, samplings, boltzmann_score(problem))}
    yield from _with_bandwidths(problem, samplings, likelihoods, SCALE, scale, _selected(samplings, bandwidth))


def _unchanged(
    likelihoods: Mapping[str, FloatArray],
    choice: str,
    setting: str,
    result: RobustnessResult,
    samplings: tuple[ChoiceSets, ...],
) -> Iterator[Setting]:
    """The setting that the study itself uses, under both models."""
    for model, values in likelihoods.items():
        width = _median_width(model, result, samplings)
        yield choice, setting, model, True, theta_marginals(log_posteriors(values)), width


def _with_bandwidths(
    problem: Problem, samplings: tuple[ChoiceSets, ...], likelihoods: Mapping[str, FloatArray], choice: str,
    setting: str, selected: Mapping[ChoiceSets, Bandwidths],
) -> Iterator[Setting]:  # fmt: skip
    """A setting in which LESS has other bandwidths than in the study, under both models."""
    yield choice, setting, BOLTZMANN, False, theta_marginals(log_posteriors(likelihoods[BOLTZMANN])), None
    less = log_likelihoods(problem, samplings, less_score(problem, selected.__getitem__))
    yield choice, setting, LESS, False, theta_marginals(log_posteriors(less)), _median(selected.values())


def _selected(samplings: tuple[ChoiceSets, ...], method: str | float) -> dict[ChoiceSets, Bandwidths]:
    with warnings.catch_warnings():
        # `literal` warns that it ends at its bound, which the table's bandwidths show
        warnings.simplefilter("ignore", BandwidthWarning)
        return select_bandwidths(samplings, method)


def _median_width(model: str, result: RobustnessResult, samplings: tuple[ChoiceSets, ...]) -> float | None:
    return None if model == BOLTZMANN else _median(result.bandwidths[sets] for sets in samplings)


def _median(selected: Iterable[Bandwidths]) -> float:
    return float(np.median([value for bandwidths in selected for value in bandwidths.values()]))


def _best(problem: Problem, posteriors: FloatArray) -> IntArray:
    """(R, n + 1) the most probable theta, also of posteriors over theta and beta jointly."""
    found: IntArray = posteriors.argmax(axis=2) // (posteriors.shape[2] // len(problem.thetas))
    return found


def _rows(
    problem: Problem, regime: str, size: int, settings: Iterable[Setting], usual: Mapping[str, IntArray]
) -> list[pl.DataFrame]:
    tables = []
    for choice, setting, model, is_default, posteriors, width in settings:
        changed = (_best(problem, posteriors) != usual[model]).mean(axis=0)
        table = _measures(problem, posteriors, setting).with_columns(pl.Series("map_changed", changed))
        labels = {
            "regime": regime, "choice": choice, "setting": setting, "model": model, "is_default": is_default,
        }  # fmt: skip
        tables.append(
            table.select(
                *(pl.lit(value).alias(name) for name, value in labels.items()),
                pl.lit(size, pl.Int64).alias("set_size"),
                pl.lit(width, pl.Float64).alias("bandwidth"),
                pl.all(),
            )
        )
    return tables


def _measures(problem: Problem, posteriors: FloatArray, setting: str) -> pl.DataFrame:
    """The measures; those of accuracy are about theta alone, so joint posteriors do not have them."""
    no_truths = (None,) * (len(problem.demonstrations.ids) + 1)
    return measures(posteriors, problem.demonstrations, no_truths if setting == JOINT else problem.truth_angles)
