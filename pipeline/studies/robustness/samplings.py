"""Section 5 of the paper: do posteriors depend on which alternatives happened to be sampled?

The same measures are computed for two regimes. In `independent`, the paper's regime, samplings differ by chance alone.
In `sampler-shift` each sampling comes from another sampler, which is what LESS is meant to withstand. `known-density`
is the part of it whose samplers have a known density, where Boltzmann can also be corrected by importance weights.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.studies.robustness.divergence import measures
from pipeline.studies.robustness.importance import effective_sample_size, weighted_score
from pipeline.studies.robustness.problem import (
    Bandwidths,
    Cell,
    ChoiceSets,
    Problem,
    Score,
    boltzmann_score,
    less_score,
    log_likelihoods,
    log_posteriors,
    select_bandwidths,
    theta_marginals,
)
from pipeline.vocabulary import (
    ALL,
    BOLTZMANN,
    BOLTZMANN_APART,
    BOLTZMANN_WEIGHTED,
    BOLTZMANN_WEIGHTED_APART,
    KNOWN_DENSITY,
    LESS,
    SAMPLER_SHIFT,
)

COMPARED = (BOLTZMANN, LESS, BOLTZMANN_WEIGHTED)  # models whose choice sets the demonstration joins, so they compare


@dataclass(frozen=True, eq=False)
class RobustnessResult:
    """Tables of the study.

    Attributes:
        robustness: for each regime, model, demonstration (or all) and set size, the columns of `measures`.
        posteriors: for each regime, model, demonstration (or all) and sampling, the posterior over theta.
        sets: for each regime, sampling and anchor, `bandwidth` and, where the density is known, the
            `effective_sample_size` of the importance weights.
        likelihoods: for each regime, set size and model, (R, n, K, B) log likelihoods.
        bandwidths: for each sampling, the bandwidths of its anchors.
    """

    robustness: pl.DataFrame
    posteriors: pl.DataFrame
    sets: pl.DataFrame
    likelihoods: Mapping[tuple[str, int, str], FloatArray]
    bandwidths: Mapping[ChoiceSets, Bandwidths]


def compare_samplings(
    problem: Problem, bandwidth: str | float, progress: Callable[[Sequence[Cell]], Iterable[Cell]] = iter
) -> RobustnessResult:
    """Posteriors under every sampling and model, and how much they differ.

    Args:
        problem: with the regimes INDEPENDENT and SAMPLER_SHIFT, either or both.
        bandwidth: how LESS selects the bandwidth of each set, or that bandwidth.
        progress: wraps the cells of the design while they are gone through, for example in a progress bar.

    Raises:
        StageError: a demonstration has no alternatives.
        BandwidthError: a set has fewer than two distinct rows.
    """
    selected = select_bandwidths([sets for samplings in problem.regimes.values() for sets in samplings], bandwidth)
    boltzmann, less = boltzmann_score(problem), less_score(problem, selected.__getitem__)
    likelihoods: dict[tuple[str, int, str], FloatArray] = {}
    rows: list[pl.DataFrame] = []
    posteriors: list[pl.DataFrame] = []
    for regime, size, samplings in progress(problem.cells):
        scores: dict[str, Score] = {BOLTZMANN: boltzmann, LESS: less}
        for model, score in scores.items():
            values = log_likelihoods(problem, samplings, score)
            likelihoods[regime, size, model] = values
            marginals = theta_marginals(log_posteriors(values))
            rows.append(_measured(problem, marginals, regime, size, model))
            posteriors.append(_posterior_rows(problem, marginals, samplings, regime, size, model))
        with_density = [r for r, sets in enumerate(samplings) if sets.log_proposals]
        if regime == SAMPLER_SHIFT and len(with_density) > 1:
            subset = tuple(samplings[r] for r in with_density)
            for model in scores:
                part = theta_marginals(log_posteriors(likelihoods[regime, size, model][with_density]))
                rows.append(_measured(problem, part, KNOWN_DENSITY, size, model))
            corrections = {
                BOLTZMANN_WEIGHTED: weighted_score(problem, weighted=True, joined=True),
                BOLTZMANN_WEIGHTED_APART: weighted_score(problem, weighted=True, joined=False),
                BOLTZMANN_APART: weighted_score(problem, weighted=False, joined=False),
            }
            for model, score in corrections.items():
                marginals = theta_marginals(log_posteriors(log_likelihoods(problem, subset, score)))
                rows.append(_measured(problem, marginals, KNOWN_DENSITY, size, model))
                posteriors.append(_posterior_rows(problem, marginals, subset, KNOWN_DENSITY, size, model))
    return RobustnessResult(pl.concat(rows), pl.concat(posteriors), _set_rows(problem, selected), likelihoods, selected)


def _measured(problem: Problem, marginals: FloatArray, regime: str, size: int, model: str) -> pl.DataFrame:
    table = measures(marginals, problem.demonstrations, problem.truth_angles)
    return table.select(
        pl.lit(regime).alias("regime"), pl.lit(model).alias("model"), pl.lit(size, pl.Int64).alias("set_size"), pl.all()
    )


def _posterior_rows(
    problem: Problem, marginals: FloatArray, samplings: tuple[ChoiceSets, ...], regime: str, size: int, model: str
) -> pl.DataFrame:
    people = problem.demonstrations
    r, g, k = marginals.shape
    group_index = np.tile(np.repeat(np.arange(g), k), r)
    # `gather` lets rows share their texts; if numpy repeated them, each row would have a copy
    return pl.DataFrame(
        {
            "regime": regime,
            "model": model,
            "set_size": np.int64(size),
            "set_id": pl.Series([sets.set_id for sets in samplings]).gather(np.repeat(np.arange(r), g * k)),
            "demonstration_id": pl.Series([*people.ids, ALL]).gather(group_index),
            "participant": pl.Series([*people.participants, ALL]).gather(group_index),
            "theta_id": np.tile(np.arange(k), r * g),
            "theta": np.tile(problem.thetas, (r * g, 1)),
            "log_posterior": marginals.ravel(),
            "posterior": np.exp(marginals).ravel(),
        }
    )


def _set_rows(problem: Problem, selected: Mapping[ChoiceSets, Bandwidths]) -> pl.DataFrame:
    rows = [
        {
            "regime": regime,
            "anchor": anchor,
            "set_size": sets.set_size,
            "set_id": sets.set_id,
            "bandwidth": bandwidth,
            "effective_sample_size": effective_sample_size(-sets.log_proposals[anchor])
            if anchor in sets.log_proposals
            else None,
        }
        for regime, samplings in problem.regimes.items()
        for sets in samplings
        for anchor, bandwidth in selected[sets].items()
    ]
    return pl.DataFrame(rows, schema_overrides={"effective_sample_size": pl.Float64})
