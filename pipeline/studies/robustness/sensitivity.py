"""Does a conclusion hang on a choice? The measures of the robustness study with one choice at a time made otherwise."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
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
"""choice, setting, model, whether it is the study's own, log posteriors (R, n + 1, K'), median bandwidth."""


def vary_choices(
    problem: Problem,
    result: RobustnessResult,
    bandwidth: str | float,
    factors: Sequence[float],
    ratios: Mapping[str, FloatArray],
    scale: str,
    watched: Callable[[Sequence[Cell]], Iterable[Cell]] = iter,
) -> pl.DataFrame:
    """The measures under every setting of each choice, all others as in the study.

    Choices are the `bandwidth` (multiples of the one selected), its `selector`, the `scale` of the features, and what
    is done with `beta`: summed out (the study's own), kept (posteriors over theta and beta jointly) or fixed.
    Boltzmann has no bandwidth; its rows are repeated there so that each setting compares both models.

    Args:
        problem: of the study.
        result: of the study on this problem.
        bandwidth: the study's own selector, or the bandwidth it was given.
        factors: multiples of the selected bandwidth.
        ratios: per other scale of the features, what scaled features are multiplied by to be on that scale, (F,).
        scale: name of the study's own scale.
        watched: as in `compare_samplings`.

    Returns:
        `regime`, `choice`, `setting`, `model`, `set_size`, `is_default`, `bandwidth` (median over the samplings, in
        units of the setting's scale; null for Boltzmann) and the columns of `measures`.
    """
    rescaled = {name: problem.rescaled(ratio) for name, ratio in ratios.items()}
    rows = []
    for regime, size, samplings in watched(problem.cells):
        own = {model: result.likelihoods[regime, size, model] for model in (BOLTZMANN, LESS)}
        settings = [
            *_factors(problem, samplings, own, result, factors),
            *_selectors(problem, samplings, own, result, bandwidth),
            *_betas(problem, samplings, own, result),
        ]
        rows += _rows(problem, regime, size, settings)
        rows += _rows(problem, regime, size, _own(own, SCALE, scale, result, samplings))
        for name, other in rescaled.items():
            there = dict(other.by_size(regime))[size]
            rows += _rows(other, regime, size, _rescored(other, there, name, bandwidth))
    return pl.concat(rows)


def _factors(
    problem: Problem, samplings: tuple[ChoiceSets, ...], own: Mapping[str, FloatArray], result: RobustnessResult,
    factors: Sequence[float],
) -> Iterator[Setting]:  # fmt: skip
    for factor in factors:
        if factor == 1:
            yield from _own(own, FACTOR, "1", result, samplings)
            continue
        selected = {
            sets: {anchor: factor * value for anchor, value in result.bandwidths[sets].items()} for sets in samplings
        }
        yield from _both(problem, samplings, own, FACTOR, f"{factor:g}", selected)


def _selectors(
    problem: Problem, samplings: tuple[ChoiceSets, ...], own: Mapping[str, FloatArray], result: RobustnessResult,
    bandwidth: str | float,
) -> Iterator[Setting]:  # fmt: skip
    yield from _own(own, SELECTOR, f"{bandwidth}", result, samplings)
    for method in METHODS:
        if method != bandwidth:
            yield from _both(problem, samplings, own, SELECTOR, method, _selected(samplings, method))


def _betas(
    problem: Problem, samplings: tuple[ChoiceSets, ...], own: Mapping[str, FloatArray], result: RobustnessResult
) -> Iterator[Setting]:
    for model, likelihoods in own.items():
        width = None if model == BOLTZMANN else _median(result.bandwidths[sets] for sets in samplings)
        joint = log_posteriors(likelihoods)
        yield BETA, MARGINAL, model, True, theta_marginals(joint), width
        yield BETA, JOINT, model, False, joint.reshape(*joint.shape[:2], -1), width
        for b, beta in enumerate(problem.betas):
            fixed = log_posteriors(likelihoods[..., [b]])
            yield BETA, f"{beta:g}", model, False, theta_marginals(fixed), width


def _rescored(
    problem: Problem, samplings: tuple[ChoiceSets, ...], scale: str, bandwidth: str | float
) -> Iterator[Setting]:
    own = {BOLTZMANN: log_likelihoods(problem, samplings, boltzmann_score(problem))}
    yield from _both(problem, samplings, own, SCALE, scale, _selected(samplings, bandwidth))


def _own(
    own: Mapping[str, FloatArray],
    choice: str,
    setting: str,
    result: RobustnessResult,
    samplings: tuple[ChoiceSets, ...],
) -> Iterator[Setting]:
    for model, likelihoods in own.items():
        width = None if model == BOLTZMANN else _median(result.bandwidths[sets] for sets in samplings)
        yield choice, setting, model, True, theta_marginals(log_posteriors(likelihoods)), width


def _both(
    problem: Problem, samplings: tuple[ChoiceSets, ...], own: Mapping[str, FloatArray], choice: str, setting: str,
    selected: Mapping[ChoiceSets, Bandwidths],
) -> Iterator[Setting]:  # fmt: skip
    yield choice, setting, BOLTZMANN, False, theta_marginals(log_posteriors(own[BOLTZMANN])), None
    less = log_likelihoods(problem, samplings, less_score(problem, selected.__getitem__))
    yield choice, setting, LESS, False, theta_marginals(log_posteriors(less)), _median(selected.values())


def _selected(samplings: tuple[ChoiceSets, ...], method: str | float) -> dict[ChoiceSets, Bandwidths]:
    with warnings.catch_warnings():
        # that `literal` ends at its bound is known and shows in the table's bandwidths
        warnings.simplefilter("ignore", BandwidthWarning)
        return select_bandwidths(samplings, method)


def _median(selected: Iterable[Bandwidths]) -> float:
    return float(np.median([value for of_anchors in selected for value in of_anchors.values()]))


def _rows(problem: Problem, regime: str, size: int, settings: Iterable[Setting]) -> list[pl.DataFrame]:
    tables = []
    for choice, setting, model, is_default, posteriors, width in settings:
        table = _measures(problem, posteriors, setting)
        own = {
            "regime": regime, "choice": choice, "setting": setting, "model": model, "is_default": is_default,
        }  # fmt: skip
        tables.append(
            table.select(
                *(pl.lit(value).alias(name) for name, value in own.items()),
                pl.lit(size, pl.Int64).alias("set_size"),
                pl.lit(width, pl.Float64).alias("bandwidth"),
                pl.all(),
            )
        )
    return tables


def _measures(problem: Problem, posteriors: FloatArray, setting: str) -> pl.DataFrame:
    """The measures; those of accuracy are about theta and so missing for joint posteriors."""
    unknown = (None,) * (len(problem.demonstrations.ids) + 1)
    return measures(posteriors, problem.demonstrations, unknown if setting == JOINT else problem.truth_angles)
