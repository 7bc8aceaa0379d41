"""What the demonstrator wanted: the posterior over theta and beta, and the choices it predicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.likelihood import ChoiceSet, log_likelihood
from pipeline.choice.logspace import log_sum_exp, normalised, peak
from pipeline.choice.models import Model
from pipeline.choice.validation import inverse_temperatures, matrix, read_only
from pipeline.errors import ArgumentError


@dataclass(frozen=True)
class Posterior:
    """A belief over reward weights theta and inverse temperatures beta.

    Attributes:
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        log_probability: (K, B) joint log posterior; its exponentials sum to one.
    """

    thetas: FloatArray
    betas: FloatArray
    log_probability: FloatArray

    def __post_init__(self) -> None:
        for name in ("thetas", "betas", "log_probability"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def log_marginal_theta(self) -> FloatArray:
        """(K,) log posterior of each theta, summed over beta."""
        return log_sum_exp(self.log_probability, axis=1)

    @property
    def marginal_theta(self) -> FloatArray:
        """(K,) posterior probability of each theta."""
        return np.asarray(np.exp(self.log_marginal_theta))

    @property
    def map_index(self) -> int:
        """Row of the most probable theta; the first one if several are equal."""
        return int(np.argmax(self.log_marginal_theta))

    @property
    def map_theta(self) -> FloatArray:
        """(F,) the most probable theta, summed over beta; the first one if several are equal."""
        return np.asarray(self.thetas[self.map_index])


def infer(
    model: Model,
    demonstrations: ArrayLike,
    alternatives: ArrayLike,
    thetas: ArrayLike,
    betas: ArrayLike = (1.0,),
    log_prior: ArrayLike | None = None,
    similarity: Any = None,
    demonstration_similarity: Any = None,
) -> Posterior:
    """The posterior over hypotheses given all demonstrations together.

    b'(theta, beta) is proportional to b(theta, beta) prod_d p(d | theta, beta), as demonstrations are independent.

    >>> from pipeline.choice import Boltzmann
    >>> posterior = infer(Boltzmann(), [2], [[0.0], [1.0], [2.0]], thetas=[[-1.0], [1.0]])
    >>> posterior.marginal_theta.round(4)
    array([0.1192, 0.8808])
    >>> posterior.map_theta
    array([1.])

    Args:
        model: the choice model.
        demonstrations: (n, F) scaled features of trajectories outside the set, or (n,) integer rows of it.
        alternatives: (N, F) scaled features of the choice set.
        thetas: (K, F) reward weights; a cost has a negative weight.
        betas: (B,) inverse temperatures, positive.
        log_prior: (K, B), or (K,) the same for all betas; need not be normalised; uniform if not given.
        similarity: (N, D) what the model compares instead of features: waypoints, a link incidence matrix.
        demonstration_similarity: (n, D) the same for demonstrations outside the set.

    Returns:
        The posterior.

    Raises:
        ArgumentError: an argument is out of range.
        BandwidthError: the model's bandwidth cannot be selected.

    Source: paper, "Inference and Prediction with LESS", the Bayesian update.
    """
    likelihood = log_likelihood(
        model, demonstrations, alternatives, thetas, betas, similarity, demonstration_similarity
    )
    return posterior_from(likelihood, thetas, betas, log_prior)


def infer_sequential(
    model: Model,
    demonstrations: ArrayLike,
    alternatives: ArrayLike,
    thetas: ArrayLike,
    betas: ArrayLike = (1.0,),
    log_prior: ArrayLike | None = None,
    similarity: Any = None,
    demonstration_similarity: Any = None,
) -> tuple[Posterior, ...]:
    """The posterior after each demonstration in turn; the last one is that of `infer`.

    Arguments and errors are those of `infer`.

    Returns:
        n posteriors.
    """
    likelihood = log_likelihood(
        model, demonstrations, alternatives, thetas, betas, similarity, demonstration_similarity
    )
    return tuple(posterior_from(likelihood[: count + 1], thetas, betas, log_prior) for count in range(len(likelihood)))


def posterior_from(
    log_likelihoods: ArrayLike, thetas: ArrayLike, betas: ArrayLike = (1.0,), log_prior: ArrayLike | None = None
) -> Posterior:
    """The posterior from log likelihoods that were computed before, of one demonstration or of several.

    Args:
        log_likelihoods: (n, K, B), some or all of the rows of `log_likelihood` (no row gives the prior), or (K, B),
            their sum.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        log_prior: (K, B), or (K,) the same for all betas; uniform if not given.

    Returns:
        The posterior.

    Raises:
        ArgumentError: shapes do not fit, or no hypothesis is possible.
    """
    theta, beta = matrix("thetas", thetas), inverse_temperatures(betas)
    shape = (len(theta), len(beta))
    likelihoods = np.asarray(log_likelihoods, dtype=np.float64)
    if likelihoods.ndim not in (2, 3) or likelihoods.shape[-2:] != shape or np.isnan(likelihoods).any():
        raise ArgumentError(
            f"log_likelihoods has shape {likelihoods.shape}; (n, {shape[0]}, {shape[1]}) or their sum "
            f"{shape} without NaN is needed."
        )
    likelihoods = likelihoods.reshape(-1, *shape)
    # A demonstration far from the set is improbable under every hypothesis. Its largest log likelihood cancels in the
    # posterior, so it is subtracted first: left in, it would cost the other demonstrations their digits.
    log_joint = checked_prior(log_prior, shape) + (likelihoods - peak(likelihoods, axis=(1, 2))).sum(axis=0)
    if not np.max(log_joint) > -np.inf:
        raise ArgumentError("log_prior excludes every hypothesis under which the demonstrations are possible.")
    return Posterior(theta, beta, normalised(log_joint))


def predict(posterior: Posterior, model: Model, alternatives: ArrayLike, similarity: Any = None) -> FloatArray:
    """Probability that each alternative is chosen, averaged over the posterior.

    p(i) = sum_{theta, beta} b(theta, beta) p(i | theta, beta)

    >>> from pipeline.choice import Boltzmann
    >>> posterior = infer(Boltzmann(), [1], [[0.0], [1.0]], thetas=[[-1.0], [1.0]])
    >>> predict(posterior, Boltzmann(), [[0.0], [1.0]]).round(4)
    array([0.3932, 0.6068])

    Args:
        posterior: the belief b.
        model: the choice model.
        alternatives: (N, F) scaled features.
        similarity: (N, D) what the model compares instead of the features.

    Returns:
        (N,) probabilities that sum to one.

    Raises:
        ArgumentError: an argument is out of range.
        BandwidthError: the model's bandwidth cannot be selected.

    Source: paper, "Inference and Prediction with LESS", the prediction.
    """
    choice = ChoiceSet.of(model, alternatives, posterior.thetas, posterior.betas, similarity)
    offsets = posterior.log_probability.reshape(-1) - choice.log_normaliser()[0]
    probabilities = np.empty(len(choice.features))
    for block in choice.blocks():
        terms = choice.utilities(choice.features[block]) + choice.weights.log_w[block]
        probabilities[block] = np.exp(log_sum_exp(terms + offsets[:, None], axis=0))
    return probabilities


def checked_prior(log_prior: ArrayLike | None, shape: tuple[int, int]) -> FloatArray:
    """`log_prior` as a normalised (K, B) array.

    Raises:
        ArgumentError: it has another shape, holds NaN or +inf, or excludes every hypothesis.
    """
    if log_prior is None:
        return np.full(shape, -np.log(shape[0] * shape[1]))
    prior = np.asarray(log_prior, dtype=np.float64)
    if prior.shape not in (shape, shape[:1]):
        raise ArgumentError(f"log_prior has shape {prior.shape}; {shape} or {shape[:1]} is needed.")
    if not np.all(prior < np.inf) or not np.any(prior > -np.inf):
        raise ArgumentError("log_prior holds NaN or +inf, or only -inf; finite logs, and -inf for excluded ones.")
    full = np.broadcast_to(prior if prior.ndim == 2 else prior[:, None], shape)
    return normalised(np.asarray(full))
