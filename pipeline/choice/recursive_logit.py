"""Boltzmann over all paths of a network, cycles included, with its exact normaliser.

A path is a row of states from an origin to a destination, a state without a way out. Its utility is the sum over its
steps, and log p(path) = weights . (sum of its features) - log z_d(o), where z_d(o) is the sum of exp(utility) over all
paths from the origin o to the destination d. With M_kl = exp(utility of the step k -> l), z_d solves z = M z + b_d.

Source: Fosgerau, Frejinger and Karlstrom (2013), A link based network route choice model with unrestricted choice set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, sparse
from scipy.sparse import linalg

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.validation import matrix, vector
from pipeline.errors import ArgumentError

_COLUMNS = 16  # solved for at once; SuperLU takes fifty times as long for some hundreds, as they leave the cache


@dataclass(frozen=True)
class Paths:
    """Paths that were taken, as far as the model needs them.

    Attributes:
        origins: (n,) first states.
        destinations: (n,) last states; no step leaves them.
        features: (n, F) sums of the steps' features over each path.
    """

    origins: IndexArray
    destinations: IndexArray
    features: FloatArray


@dataclass(frozen=True)
class Estimate:
    """Weights of the greatest likelihood.

    Attributes:
        weights: (F,) per unit of each feature.
        standard_errors: (F,) from the outer product of the paths' scores.
        log_likelihood: at the weights, in nats.
    """

    weights: FloatArray
    standard_errors: FloatArray
    log_likelihood: float


class RecursiveLogit:
    """The model on one network, for one list of paths.

    Args:
        sources: (A,) state that each step leaves.
        targets: (A,) state that it reaches.
        features: (A, F) of the steps.
        paths: that were taken.

    Raises:
        ArgumentError: shapes do not fit, a step stands twice, or a path ends in a state that can be left.
    """

    def __init__(self, sources: ArrayLike, targets: ArrayLike, features: ArrayLike, paths: Paths) -> None:
        self._features = matrix("features", features)
        self._sources, self._targets = np.asarray(sources, dtype=np.intp), np.asarray(targets, dtype=np.intp)
        if self._sources.shape != (len(self._features),) or self._targets.shape != self._sources.shape:
            raise ArgumentError("sources, targets and features need one entry for each step.")
        if len(np.unique(np.stack([self._sources, self._targets]), axis=1).T) < len(self._sources):
            raise ArgumentError("a step stands twice in sources and targets; keep one.")
        if np.isin(paths.destinations, self._sources).any():
            raise ArgumentError("a path ends in a state that can be left; give each destination a state of its own.")
        self._states = int(max(self._sources.max(), self._targets.max(), paths.origins.max())) + 1
        self._ends, self._end_of_path = np.unique(paths.destinations, return_inverse=True)
        self._at = (paths.origins, self._end_of_path)
        self._paths = paths

    def log_likelihoods(self, weights: ArrayLike) -> FloatArray:
        """(n,) log probability of each path, in nats.

        Raises:
            ArgumentError: the sum over all paths is infinite at these weights, or a path has no way to its end.
        """
        return self._log_likelihoods(self._solve(self._weights(weights))[1], self._weights(weights))

    def scores(self, weights: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """(n,) log probabilities and (n, F) their exact derivatives by the weights.

        d log z / d weight_f = z' / z, where z' solves z' = M z' + (dM / d weight_f) z + db / d weight_f.

        Raises:
            ArgumentError: as `log_likelihoods`.
        """
        checked = self._weights(weights)
        solver, values = self._solve(checked)
        gradients = self._paths.features.copy()
        for index, feature in enumerate(self._features.T):
            slopes, end_slopes = self._matrices(np.exp(self._features @ checked) * feature)
            derivative = _solved(solver, np.asarray(slopes @ values + end_slopes.toarray()))
            gradients[:, index] -= derivative[self._at] / values[self._at]
        return self._log_likelihoods(values, checked), gradients

    def gradient(self, weights: ArrayLike, counts: ArrayLike) -> tuple[float, FloatArray]:
        """The log likelihood and its derivatives (F,), by one more solve with the transpose instead of one a feature.

        Args:
            weights: (F,) per unit of each feature.
            counts: (n,) how often each path counts.

        Raises:
            ArgumentError: as `log_likelihoods`.
        """
        checked, often = self._weights(weights), vector("counts", counts, len(self._paths.features))
        solver, values = self._solve(checked)
        pull = np.zeros_like(values)
        np.add.at(pull, self._at, often / values[self._at])
        pull = _solved(solver, pull, "T")
        shares = np.exp(self._features @ checked)  # becomes how often each step is expected in the paths
        inner = ~np.isin(self._targets, self._ends)
        sources, targets = self._sources[inner], self._targets[inner]
        shares[inner] *= np.einsum("ad,ad->a", pull[sources], values[targets])
        shares[~inner] *= pull[self._sources[~inner], np.searchsorted(self._ends, self._targets[~inner])]
        total = float(often @ self._log_likelihoods(values, checked))
        return total, often @ self._paths.features - shares @ self._features

    def estimate(self, start: ArrayLike, counts: ArrayLike | None = None) -> Estimate:
        """The weights of the greatest likelihood.

        Args:
            start: (F,) weights at which the sum over all paths is finite, such as -2 for each cost.
            counts: (n,) how often each path counts; once if not given. 0 leaves a path out.

        Raises:
            ArgumentError: `start` is no such place, or the search does not come to an end; the message has the last
                weights.
        """
        checked = self._weights(start)
        often = np.ones(len(self._paths.features)) if counts is None else vector("counts", counts)
        _, gradients = self.scores(checked)
        # a little more than the covariance, so that a feature which never varies leaves it positive definite
        curvature = _covariance(gradients, often) * often.sum() + 1e-9 * np.eye(len(checked))
        found: Any = optimize.minimize(
            self._objective, checked, args=(often,), jac=True, method="BFGS",
            options={"hess_inv0": curvature, "gtol": 1e-5},
        )  # fmt: skip
        if np.abs(found.jac).max() > 1e-4:
            raise ArgumentError(f"the search stopped at the weights {found.x.tolist()} ({found.message}).")
        log_likelihoods, gradients = self.scores(found.x)
        errors = np.sqrt(np.diag(_covariance(gradients, often)))
        return Estimate(found.x, errors, float(often @ log_likelihoods))

    def _objective(self, weights: FloatArray, counts: FloatArray) -> tuple[float, FloatArray]:
        try:
            value, gradient = self.gradient(weights, counts)
        except ArgumentError:  # the line search stepped to where the sum over paths is infinite
            return np.inf, np.zeros(len(weights))
        return -value / counts.sum(), -gradient / counts.sum()

    def _weights(self, weights: ArrayLike) -> FloatArray:
        return vector("weights", weights, self._features.shape[1])

    def _matrices(self, entries: FloatArray) -> tuple[sparse.csc_array, sparse.csc_array]:
        """The entries of steps as a matrix between states, and of those into destinations as columns."""
        inner = ~np.isin(self._targets, self._ends)
        column = np.searchsorted(self._ends, self._targets[~inner])
        between = sparse.csc_array(
            (entries[inner], (self._sources[inner], self._targets[inner])), shape=(self._states, self._states)
        )
        into = sparse.csc_array(
            (entries[~inner], (self._sources[~inner], column)), shape=(self._states, len(self._ends))
        )
        return between, into

    def _solve(self, weights: FloatArray) -> tuple[Any, FloatArray]:
        """The factorised I - M, and z (states, destinations)."""
        utilities = self._features @ weights
        if utilities.max() > 700:
            raise ArgumentError(
                f"weights {weights.tolist()} give a step a utility of {utilities.max():g}; 700 at most."
            )
        steps, ends = self._matrices(np.exp(utilities))
        try:
            solver = linalg.splu(sparse.csc_matrix(sparse.eye_array(self._states) - steps))
        except RuntimeError:
            raise ArgumentError(_infinite(weights)) from None
        values = _solved(solver, ends.toarray())
        # A positive solution of z = M z + b exists exactly if the sum over all paths is finite (M is not negative).
        if values.min() < -1e-9 * values.max() or not (values[self._at] > 0).all():
            raise ArgumentError(_infinite(weights))
        return solver, values

    def _log_likelihoods(self, values: FloatArray, weights: FloatArray) -> FloatArray:
        log_sums = np.log(values[self._at])
        return np.asarray(self._paths.features @ weights - log_sums)


def _solved(solver: Any, right: FloatArray, trans: str = "N") -> FloatArray:
    """(states, D) solutions for right sides (states, D), the same bit for bit as if solved for all at once."""
    parts = [right[:, start : start + _COLUMNS] for start in range(0, right.shape[1], _COLUMNS)]
    return np.concatenate([solver.solve(np.ascontiguousarray(part), trans=trans) for part in parts], axis=1)


def _infinite(weights: FloatArray) -> str:
    return (
        f"weights {weights.tolist()}: the sum over all paths is infinite there, or a path has no way to its end; "
        "give costs more negative weights."
    )


def _covariance(scores: FloatArray, counts: FloatArray) -> FloatArray:
    """(F, F) the inverse of the outer product of the scores (Berndt, Hall, Hall and Hausman, 1974)."""
    inverse = np.linalg.pinv((scores.T * counts) @ scores, hermitian=True)
    return np.asarray((inverse + inverse.T) / 2)
