"""Nested logit: alternatives that resemble one another share a nest, and nests compete with one another.

Ben-Akiva (1973); Train, Discrete Choice Methods with Simulation (2009), section 4.2. Like LESS it keeps near-duplicates
from drowning out the rest, by groups instead of by a density.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.validation import inverse_temperatures, matrix, positive
from pipeline.errors import ArgumentError


@dataclass(frozen=True)
class Nests:
    """A partition of a choice set.

    Attributes:
        index: (N,) the nest of each alternative, 0 to M - 1; nests are numbered in the order of their first rows.
        diameter: two alternatives of a nest are at most this far apart, in scaled features.
    """

    index: IndexArray
    diameter: float

    @property
    def count(self) -> int:
        """M."""
        return int(self.index.max()) + 1


def nests_of(features: ArrayLike, diameter: float) -> Nests:
    """Group alternatives by complete linkage, so that no two of a nest are farther apart than `diameter`.

    Args:
        features: (N, F) scaled features.
        diameter: > 0, in scaled features.

    Raises:
        ArgumentError: an argument is out of range.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    rows, widest = matrix("features", features), positive("diameter", diameter)
    if len(rows) == 1:
        return Nests(np.zeros(1, dtype=np.intp), widest)
    labels = fcluster(linkage(rows, "complete"), widest, criterion="distance")
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return Nests(np.argsort(np.argsort(first))[inverse], widest)


def nested_log_likelihood(
    demonstrations: ArrayLike,
    alternatives: ArrayLike,
    nests: Nests,
    thetas: ArrayLike,
    betas: ArrayLike = (1.0,),
    dissimilarity: float = 0.5,
) -> FloatArray:
    """Log probability of each demonstration, which joins the set, under nested logit.

    P(i) = exp(V_i / l) / S_m(i) * S_m(i)^l / sum_m S_m^l, with V_i = beta theta . phi_i, S_m the sum of exp(V_j / l)
    over the nest m, and the same dissimilarity l for every nest. With l = 1 it is Boltzmann; as l goes to 0 a nest
    weighs as much as its best alternative alone.

    A demonstration joins the nest whose farthest alternative is nearest to it, if that is within the nests' diameter;
    else it is a nest of its own.

    Args:
        demonstrations: (n, F) scaled features of trajectories outside the set.
        alternatives: (N, F) scaled features.
        nests: of the alternatives.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        dissimilarity: l, above 0 and at most 1.

    Returns:
        (n, K, B) log likelihoods.

    Raises:
        ArgumentError: an argument is out of range.
    """
    rows = matrix("alternatives", alternatives)
    shown = matrix("demonstrations", demonstrations, columns=rows.shape[1])
    directions, temperatures = matrix("thetas", thetas, columns=rows.shape[1]), inverse_temperatures(betas)
    if not 0 < dissimilarity <= 1:
        raise ArgumentError(f"dissimilarity is {dissimilarity}; it must be above 0 and at most 1.")
    if nests.index.shape != (len(rows),):
        raise ArgumentError(f"nests are of {nests.index.size} alternatives; there are {len(rows)}.")
    order = np.argsort(nests.index, kind="stable")
    starts = np.searchsorted(nests.index[order], np.arange(nests.count))
    joined = _joined(shown, rows[order], starts, nests.diameter)
    omegas = (directions[:, None] * temperatures[:, None]).reshape(-1, rows.shape[1])
    utilities = np.einsum("hf,nf->hn", omegas, rows[order]) / dissimilarity
    best = np.maximum.reduceat(utilities, starts, axis=1)
    exponentials = np.exp(utilities - np.repeat(best, np.diff([*starts, len(rows)]), axis=1))
    inclusive = best + np.log(np.add.reduceat(exponentials, starts, axis=1))  # (H, M) log S_m
    own = np.einsum("hf,nf->hn", omegas, shown) / dissimilarity
    found = np.empty((len(shown), len(omegas)))
    for i, nest in enumerate(joined):
        others = inclusive if nest < 0 else np.delete(inclusive, nest, axis=1)
        with_it = own[:, i] if nest < 0 else np.logaddexp(inclusive[:, nest], own[:, i])
        of_nests = dissimilarity * np.column_stack([others, with_it])
        found[i] = own[:, i] - with_it + of_nests[:, -1] - log_sum_exp(of_nests, axis=1)
    return found.reshape(len(shown), len(directions), len(temperatures))


def _joined(shown: FloatArray, rows: FloatArray, starts: IndexArray, diameter: float) -> list[int]:
    """For each demonstration the nest that it joins, -1 for none; `rows` stand nest by nest."""
    distances = np.sqrt(((shown[:, None] - rows) ** 2).sum(axis=2))
    farthest = np.maximum.reduceat(distances, starts, axis=1)
    nearest = farthest.argmin(axis=1)
    within = farthest[np.arange(len(shown)), nearest] <= diameter
    return [int(nest) if fits else -1 for nest, fits in zip(nearest, within, strict=True)]
