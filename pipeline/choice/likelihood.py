"""Log likelihoods of demonstrations under every hypothesis.

A demonstration outside the choice set joins it: it is chosen from the alternatives and itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.log_sum_exp import BLOCK, LogSumExp
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.models import Model, WeightedSet
from pipeline.choice.validation import inverse_temperatures, matrix
from pipeline.errors import ArgumentError

# Joined weights that are held at once, for a group of demonstrations: 256 MB.
_GROUP = 32_000_000
# The most that a joining trajectory may change a log weight of the set. Under LESS it is at most log 2.
_LARGEST_CHANGE = 300.0


def log_probabilities(
    model: Model, alternatives: ArrayLike, theta: ArrayLike, beta: float = 1.0, similarity: Any = None
) -> FloatArray:
    """Log choice probability of each alternative under one hypothesis.

    log p(i | theta, beta) = beta theta . phi_i + log_w_i - logsumexp_j (beta theta . phi_j + log_w_j)

    >>> from pipeline.choice import Boltzmann
    >>> np.exp(log_probabilities(Boltzmann(), [[0.0], [0.0]], theta=[1.0]))
    array([0.5, 0.5])

    Args:
        model: the choice model.
        alternatives: (N, F) scaled features.
        theta: (F,) reward weights; a cost has a negative weight.
        beta: inverse temperature, positive.
        similarity: (N, D) what the model compares instead of the features.

    Returns:
        (N,) log probabilities.

    Raises:
        ArgumentError: an argument is out of range.
        BandwidthError: the model's bandwidth cannot be selected.
    """
    choice = ChoiceSet.of(model, alternatives, np.atleast_2d(np.asarray(theta)), [beta], similarity)
    utilities = choice.utilities(choice.features)[0] + choice.weights.log_w
    return np.asarray(utilities - log_sum_exp(utilities))


def log_likelihood(
    model: Model,
    demonstrations: ArrayLike,
    alternatives: ArrayLike,
    thetas: ArrayLike,
    betas: ArrayLike = (1.0,),
    similarity: Any = None,
    demonstration_similarity: Any = None,
) -> FloatArray:
    """Log probability of each demonstration under each hypothesis.

    A demonstration outside the set is chosen from the alternatives and itself: its weight is part of the
    normaliser, and the weights of the alternatives are those of the joined set. Each demonstration joins by itself.

    Args:
        model: the choice model.
        demonstrations: (n, F) scaled features of trajectories outside the set, or (n,) integer rows of it.
        alternatives: (N, F) scaled features of the choice set.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        similarity: (N, D) what the model compares instead of the features of the alternatives.
        demonstration_similarity: (n, D) the same for demonstrations outside the set.

    Returns:
        (n, K, B) log likelihoods.

    Raises:
        ArgumentError: an argument is out of range.
        BandwidthError: the model's bandwidth cannot be selected.
    """
    choice = ChoiceSet.of(model, alternatives, thetas, betas, similarity)
    rows = _rows(demonstrations, len(choice.features))
    if rows is not None:
        if demonstration_similarity is not None:
            raise ArgumentError("demonstration_similarity is given with rows of the set; leave it out.")
        flat = _log_likelihood_of_rows(choice, rows)
    else:
        features = matrix("demonstrations", demonstrations, columns=choice.features.shape[1])
        flat = _log_likelihood_outside(choice, features, _outside(choice, features, demonstration_similarity))
    return flat.reshape(len(flat), len(choice.thetas), len(choice.betas))


@dataclass(frozen=True)
class ChoiceSet:
    """Alternatives, their weights under a model, and the hypotheses, all checked.

    Attributes:
        features: (N, F) scaled features of the alternatives.
        weights: log weights of the alternatives under the model.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        similarity: (N, D) what the model compares instead of the features, or None.
    """

    features: FloatArray
    weights: WeightedSet
    thetas: FloatArray
    betas: FloatArray
    similarity: Any

    @classmethod
    def of(
        cls, model: Model, alternatives: ArrayLike, thetas: ArrayLike, betas: ArrayLike, similarity: Any
    ) -> ChoiceSet:
        """Check the arguments by name and weigh the alternatives."""
        features = matrix("alternatives", alternatives)
        theta = matrix("thetas", thetas, columns=features.shape[1])
        beta = inverse_temperatures(betas)
        with np.errstate(over="ignore"):
            largest = beta.max() * np.abs(theta).sum(axis=1).max() * np.abs(features).max()
        if not largest < np.finfo(np.float64).max / 4:
            raise ArgumentError("betas, thetas and alternatives multiply beyond the largest double; scale them down.")
        compared = features if similarity is None else _compared("similarity", similarity, len(features))
        return cls(features, model.weigh(compared), theta, beta, similarity)

    def utilities(self, features: FloatArray) -> FloatArray:
        """(K B, M) beta theta . phi minus its largest value over the set: small differences keep their digits."""
        gains = self._rewards(features) - self._best_rewards[:, None]
        return np.asarray((gains[:, None, :] * self.betas[:, None]).reshape(-1, len(features)))

    def _rewards(self, features: FloatArray) -> FloatArray:
        """(K, M) theta . (phi - phi_0), with phi_0 the least value of each feature: a common offset costs no digits."""
        # einsum, because sums by BLAS depend on the number of threads.
        return np.asarray(np.einsum("kf,mf->km", self.thetas, features - self._origin))

    @cached_property
    def _origin(self) -> FloatArray:
        return np.asarray(self.features.min(axis=0))

    @cached_property
    def _best_rewards(self) -> FloatArray:
        best = np.full(len(self.thetas), -np.inf)
        for block in self.blocks():
            np.maximum(best, self._rewards(self.features[block]).max(axis=1), out=best)
        return best

    def blocks(self) -> Iterator[slice]:
        """Slices of alternatives whose utilities fit into one block."""
        step = max(BLOCK // (len(self.thetas) * len(self.betas)), 1)
        for start in range(0, len(self.features), step):
            yield slice(start, start + step)

    def log_normaliser(self, joined: FloatArray | None = None) -> FloatArray:
        """(n, K B) logsumexp over the alternatives with the weights (n, N) of each joined set; or (1, K B) without.

        One exponential per alternative and hypothesis serves all demonstrations: joining changes each weight by a
        bounded ratio, so the largest terms of the set without demonstrations stay far from underflow.
        """
        log_w = self.weights.log_w
        parts = (
            LogSumExp.of(
                self.utilities(self.features[block]) + log_w[block],
                None if joined is None else np.exp(joined[:, block] - log_w[block]),
            )
            for block in self.blocks()
        )
        return reduce(add, parts).value


def _log_likelihood_of_rows(choice: ChoiceSet, rows: IndexArray) -> FloatArray:
    chosen = choice.utilities(choice.features[rows]) + choice.weights.log_w[rows]
    return np.asarray((chosen - choice.log_normaliser().T).T)


def _log_likelihood_outside(choice: ChoiceSet, features: FloatArray, compared: Any) -> FloatArray:
    """(n, K B) log likelihoods, computed for groups of demonstrations whose joined weights fit into memory."""
    utilities = choice.utilities(features).T
    log_likelihoods = np.empty_like(utilities)
    step = max(_GROUP // len(choice.features), 1)
    for start in range(0, len(features), step):
        group = range(start, min(start + step, len(features)))
        joined = [choice.weights.joined(compared[[index]]) for index in group]
        chosen = utilities[group] + np.array([log_w for _, log_w in joined])[:, None]
        weights = np.array([log_w for log_w, _ in joined])
        change = float(np.abs(weights - choice.weights.log_w).max())
        if not change <= _LARGEST_CHANGE:
            raise ArgumentError(
                f"model changes a log weight of the set by {change:g} when a demonstration joins it; up to "
                f"{_LARGEST_CHANGE:g} can be resolved, so weigh the joined set as a set of its own."
            )
        others = choice.log_normaliser(weights)
        log_likelihoods[group] = chosen - np.logaddexp(others, chosen)
    return log_likelihoods


def _rows(demonstrations: ArrayLike, count: int) -> IndexArray | None:
    """(n,) rows of the set, or None if the demonstrations are given by their features."""
    array = np.asarray(demonstrations)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        return None
    if array.size == 0 or array.min() < 0 or array.max() >= count:
        raise ArgumentError(
            f"demonstrations holds rows {array.tolist()[:5]}; one or more rows between 0 and {count - 1} are needed."
        )
    return array.astype(np.intp)


def _outside(choice: ChoiceSet, features: FloatArray, similarity: Any) -> Any:
    """(n, D) what the model compares for demonstrations outside the set."""
    if (similarity is None) != (choice.similarity is None):
        raise ArgumentError(
            "similarity and demonstration_similarity go together for demonstrations outside the set; "
            "give both or neither."
        )
    return features if similarity is None else _compared("demonstration_similarity", similarity, len(features))


def _compared(name: str, similarity: Any, count: int) -> Any:
    """`similarity` as a dense array or a sparse one that can be indexed by rows, one row per trajectory."""
    array = similarity.tocsr() if hasattr(similarity, "tocsr") else matrix(name, similarity)
    if array.ndim != 2 or array.shape[0] != count:
        raise ArgumentError(f"{name} has shape {array.shape}; two axes with {count} rows are needed.")
    return array
