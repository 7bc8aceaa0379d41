"""How far posteriors move when near-copies of a few alternatives are added to the sets."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.params import Duplicates
from pipeline.studies.robustness.problem import (
    Bandwidths,
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
from pipeline.vocabulary import ALL, BOLTZMANN, LESS, LESS_CLEAN_BANDWIDTH


def inject_duplicates(
    problem: Problem,
    samplings: tuple[ChoiceSets, ...],
    settings: Duplicates,
    bandwidth: str | float,
    stream: Callable[[str, str], np.random.Generator],
    progress: Callable[[Sequence[tuple[int, float]]], Iterable[tuple[int, float]]] = iter,
) -> pl.DataFrame:
    """Divergence from the posterior of the clean set to that of the set with near-copies.

    The models are Boltzmann, LESS that selects its bandwidth from the set with copies (`less`), and LESS that keeps the
    bandwidth of the clean set (`less-clean-bandwidth`). The same alternatives are copied, with the same noise before it
    is scaled, for every number of copies and every spread; a larger number of copies includes the smaller.

    Args:
        problem: demonstrations and hypotheses.
        samplings: the R clean samplings.
        settings: numbers and spreads of the copies.
        bandwidth: how LESS selects its bandwidth, or that bandwidth.
        stream: returns the random generator for a sampling's id and an anchor.
        progress: wraps the pairs of copies and spread while they are gone through, for example in a progress bar.

    Returns:
        One row per demonstration (or all), model, number of copies and spread: `sets` (R), `kl_from_clean` (nats, mean
        over the samplings of KL(clean || with copies)), `map_changed` (share of the samplings where the most probable
        theta is another one) and `bandwidth` (median; null for Boltzmann).
    """
    clean_widths = select_bandwidths(samplings, bandwidth)
    clean = {
        BOLTZMANN: _marginals(problem, samplings, boltzmann_score(problem)),
        LESS: _marginals(problem, samplings, less_score(problem, clean_widths.__getitem__)),
    }
    clean[LESS_CLEAN_BANDWIDTH] = clean[LESS]
    noises = {sets: _noises(sets, settings, stream) for sets in samplings}
    rows = []
    for copies, spread in progress(list(product(settings.copies, settings.spreads))):
        joined = tuple(_with_copies(sets, noises[sets], copies, spread) for sets in samplings)
        selected = select_bandwidths(joined, bandwidth)
        unchanged = dict(zip(joined, clean_widths.values(), strict=True))
        scores: dict[str, tuple[Score, Mapping[ChoiceSets, Bandwidths] | None]] = {
            BOLTZMANN: (boltzmann_score(problem), None),
            LESS: (less_score(problem, selected.__getitem__), selected),
            LESS_CLEAN_BANDWIDTH: (less_score(problem, unchanged.__getitem__), unchanged),
        }
        for model, (score, widths) in scores.items():
            moved = _marginals(problem, joined, score)
            rows.append(_rows(problem, clean[model], moved, widths, model, copies, spread))
    return pl.concat(rows)


Noise = Mapping[str, tuple[FloatArray, FloatArray]]
"""For each anchor, the rows that are copied (copied, F) and standard normal noise (copies, copied, F)."""


def _noises(sets: ChoiceSets, settings: Duplicates, stream: Callable[[str, str], np.random.Generator]) -> Noise:
    noises = {}
    for anchor, phi in sets.features.items():
        rng = stream(sets.set_id, anchor)
        picked = rng.choice(len(phi), size=settings.copied, replace=False)
        noises[anchor] = (phi[picked], rng.standard_normal((max(settings.copies), *phi[picked].shape)))
    return noises


def _with_copies(sets: ChoiceSets, noises: Noise, copies: int, spread: float) -> ChoiceSets:
    features = {}
    for anchor, phi in sets.features.items():
        originals, noise = noises[anchor]
        added = originals + spread * noise[:copies]
        features[anchor] = np.concatenate([phi, added.reshape(-1, phi.shape[1])])
    return replace(sets, features=features, log_proposals={})


def _marginals(problem: Problem, samplings: tuple[ChoiceSets, ...], score: Score) -> FloatArray:
    return theta_marginals(log_posteriors(log_likelihoods(problem, samplings, score)))


def _rows(
    problem: Problem, clean: FloatArray, moved: FloatArray, widths: Mapping[ChoiceSets, Bandwidths] | None,
    model: str, copies: int, spread: float,
) -> pl.DataFrame:  # fmt: skip
    people = problem.demonstrations
    divergence = (np.exp(clean) * (clean - moved)).sum(axis=2)
    width = None if widths is None else float(np.median([w for anchors in widths.values() for w in anchors.values()]))
    return pl.DataFrame(
        {
            "model": model,
            "demonstration_id": [*people.ids, ALL],
            "participant": [*people.participants, ALL],
            "copies": np.int64(copies),
            "spread": float(spread),
            "sets": np.int64(len(clean)),
            "kl_from_clean": divergence.mean(axis=0),
            "map_changed": (clean.argmax(axis=2) != moved.argmax(axis=2)).mean(axis=0),
            "bandwidth": pl.Series([width] * (len(people.ids) + 1), dtype=pl.Float64),
        }
    )
