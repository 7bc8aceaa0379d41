"""The log likelihood of demonstrations as a function of omega = beta theta, with its exact derivatives.

Each demonstration d is chosen from its own joined set, as in `pipeline.choice.likelihood`:

    f_d(omega) = omega . phi_d + log_w_dd - log sum_j exp(omega . phi_j + log_w_dj)
    gradient   = phi_d - E_d[phi]
    Hessian    = -Cov_d[phi]

with mean and covariance over the joined set under omega. The log weights do not depend on omega, so every f_d is
concave and so is their sum; with a Gaussian prior the posterior has one mode.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.explored import Region
from pipeline.choice.models import Model, WeightedSet
from pipeline.choice.validation import matrix, read_only, vector
from pipeline.errors import ArgumentError

_TERMS = 1_000_000  # exponentials held at once: 8 MB, which stays near the processor


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Log likelihood of all demonstrations together at G points, and how it changes there.

    Attributes:
        value: (G,).
        gradient: (G, F).
        curvature: (G, F, F) the negative Hessian, positive semi-definite.
    """

    value: FloatArray
    gradient: FloatArray
    curvature: FloatArray


class Likelihood(Protocol):
    """What sampling the weights needs to know of demonstrations."""

    @property
    def count(self) -> int:
        """How many there are."""

    @property
    def features(self) -> int:
        """F, the number of features."""

    def subset(self, demonstrations: Sequence[int]) -> Likelihood:
        """Some of the demonstrations."""

    def log_likelihood(self, omegas: ArrayLike) -> FloatArray:
        """(G, n) log probability of each demonstration at each of the points (G, F)."""

    def total(self, omegas: ArrayLike) -> FloatArray:
        """(G,) log probability of all demonstrations together."""

    def derivatives(self, omegas: ArrayLike) -> Derivatives:
        """Value, gradient and curvature of `total` at the points (G, F)."""


@dataclass(frozen=True, eq=False)
class SeparateChoices:
    """Demonstrations of which each has its own alternatives, as people have who start at different places.

    Attributes:
        parts: of each demonstration; each holds one.
    """

    parts: tuple[Choices, ...]

    def __post_init__(self) -> None:
        if not self.parts or any(part.count != 1 for part in self.parts):
            raise ArgumentError("parts must hold one demonstration each, and there must be one or more.")

    @property
    def count(self) -> int:
        """n, the number of demonstrations."""
        return len(self.parts)

    @property
    def features(self) -> int:
        """F, the number of features."""
        return self.parts[0].features

    def subset(self, demonstrations: Sequence[int]) -> SeparateChoices:
        """Some of the demonstrations, each with its alternatives."""
        return SeparateChoices(tuple(self.parts[n] for n in demonstrations))

    def log_likelihood(self, omegas: ArrayLike) -> FloatArray:
        """(G, n), as of `Choices`."""
        return np.concatenate([part.log_likelihood(omegas) for part in self.parts], axis=1)

    def total(self, omegas: ArrayLike) -> FloatArray:
        """(G,), as of `Choices`."""
        return np.asarray(self.log_likelihood(omegas).sum(axis=1))

    def derivatives(self, omegas: ArrayLike) -> Derivatives:
        """As of `Choices`: the sums over demonstrations."""
        found = [part.derivatives(omegas) for part in self.parts]
        return Derivatives(
            np.sum([one.value for one in found], axis=0),
            np.sum([one.gradient for one in found], axis=0),
            np.sum([one.curvature for one in found], axis=0),
        )


@dataclass(frozen=True, eq=False)
class Choices:
    """n demonstrations and the N alternatives that each was chosen from.

    Attributes:
        alternatives: (N, F) scaled features.
        log_w: (N,) log weights of the alternatives among themselves.
        chosen: (n, F) scaled features of the demonstrations.
        chosen_log_w: (n,) log weight of each in its own choice set.
        joined_log_w: (n, N) log weights of the alternatives once each demonstration has joined them; None if nothing
            joins: the demonstrations are alternatives themselves, or points of an explored space.
    """

    alternatives: FloatArray
    log_w: FloatArray
    chosen: FloatArray
    chosen_log_w: FloatArray
    joined_log_w: FloatArray | None = None

    def __post_init__(self) -> None:
        rows = matrix("alternatives", self.alternatives)
        chosen = matrix("chosen", self.chosen, columns=rows.shape[1])
        checked = {
            "alternatives": rows,
            "log_w": vector("log_w", self.log_w, length=len(rows)),
            "chosen": chosen,
            "chosen_log_w": vector("chosen_log_w", self.chosen_log_w, length=len(chosen)),
        }
        if self.joined_log_w is not None:
            checked["joined_log_w"] = matrix("joined_log_w", self.joined_log_w, columns=len(rows))
            if len(checked["joined_log_w"]) != len(chosen):
                raise ArgumentError(
                    f"joined_log_w has {len(checked['joined_log_w'])} rows for {len(chosen)} demonstrations."
                )
        for name, value in checked.items():
            object.__setattr__(self, name, read_only(value))

    @classmethod
    def of_rows(cls, model: Model, rows: Sequence[int], alternatives: ArrayLike, similarity: Any = None) -> Choices:
        """Demonstrations that are alternatives: (n,) rows of the set.

        Args:
            model: the choice model.
            rows: which alternatives were chosen.
            alternatives: (N, F) scaled features.
            similarity: (N, D) what the model compares instead of the features.

        Raises:
            ArgumentError: an argument is out of range.
            BandwidthError: the model's bandwidth cannot be selected.
        """
        features = matrix("alternatives", alternatives)
        index = np.asarray(rows)
        whole = index.ndim == 1 and index.dtype.kind in "iu" and index.size > 0
        if not whole or not 0 <= index.min() <= index.max() < len(features):
            raise ArgumentError(f"rows is {rows!r}; one or more row numbers from 0 to {len(features) - 1} are needed.")
        log_w = model.weigh(features if similarity is None else similarity).log_w
        return cls(features, log_w, features[index], log_w[index])

    @classmethod
    def outside(cls, model: Model, demonstrations: ArrayLike, alternatives: ArrayLike) -> Choices:
        """Demonstrations (n, F) outside the set (N, F): each joins the alternatives, and its weight counts for all.

        Raises:
            ArgumentError: an argument is out of range.
            BandwidthError: the model's bandwidth cannot be selected.
        """
        features = matrix("alternatives", alternatives)
        return cls.joining(model.weigh(features), demonstrations, features)

    @classmethod
    def joining(cls, weights: WeightedSet, demonstrations: ArrayLike, alternatives: ArrayLike) -> Choices:
        """`outside` with weights of the alternatives that are at hand."""
        features = matrix("alternatives", alternatives)
        chosen = matrix("demonstrations", demonstrations, columns=features.shape[1])
        joined = [weights.joined(row[None]) for row in chosen]
        return cls(
            features,
            weights.log_w,
            chosen,
            np.array([own for _, own in joined]),
            np.stack([log_w for log_w, _ in joined]),
        )

    @classmethod
    def over(cls, region: Region, demonstrations: ArrayLike) -> Choices:
        """Demonstrations (n, F) chosen from an explored choice space, as in `region_log_likelihood`.

        They are densities with respect to what the region's sums integrate over. A demonstration has no part in the
        sum: among all trajectories it weighs nothing.

        Raises:
            ArgumentError: an argument is out of range.
        """
        chosen = matrix("demonstrations", demonstrations, columns=region.features.shape[1])
        return cls(region.features, region.log_w, chosen, np.zeros(len(chosen)))

    @cached_property
    def _origin(self) -> FloatArray:
        return np.asarray(self.alternatives.mean(axis=0))  # a common offset of the features would cost digits

    @cached_property
    def _rows(self) -> FloatArray:
        return np.ascontiguousarray((self.alternatives - self._origin).T)  # (F, N)

    @cached_property
    def _squares(self) -> FloatArray:
        return np.asarray((self._rows[:, None] * self._rows[None]).reshape(-1, len(self.alternatives)))  # (F F, N)

    @cached_property
    def _chosen(self) -> FloatArray:
        return np.asarray(self.chosen - self._origin)

    @cached_property
    def _ratios(self) -> FloatArray | None:
        return None if self.joined_log_w is None else np.exp(self.joined_log_w - self.log_w)

    @property
    def count(self) -> int:
        """n, the number of demonstrations."""
        return len(self.chosen)

    @property
    def features(self) -> int:
        """F, the number of features."""
        return int(self.alternatives.shape[1])

    def subset(self, demonstrations: Sequence[int]) -> Choices:
        """Some of the demonstrations, with the same alternatives."""
        index = list(demonstrations)
        joined = None if self.joined_log_w is None else self.joined_log_w[index]
        return Choices(self.alternatives, self.log_w, self.chosen[index], self.chosen_log_w[index], joined)

    def log_likelihood(self, omegas: ArrayLike) -> FloatArray:
        """(G, n) log probability of each demonstration at each of the points (G, F)."""
        points = matrix("omegas", omegas, columns=self.features)
        parts = [self._sums(points[block])[0] for block in self._blocks(len(points))]
        return np.concatenate(parts)

    def total(self, omegas: ArrayLike) -> FloatArray:
        """(G,) log probability of all demonstrations together."""
        return np.asarray(self.log_likelihood(omegas).sum(axis=1))

    def derivatives(self, omegas: ArrayLike) -> Derivatives:
        """Value, gradient and curvature of `total` at the points (G, F)."""
        points = matrix("omegas", omegas, columns=self.features)
        parts = [self._derivatives(points[block]) for block in self._blocks(len(points))]
        return Derivatives(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def _blocks(self, count: int) -> Iterator[slice]:
        step = max(_TERMS // len(self.alternatives), 1)
        for start in range(0, count, step):
            yield slice(start, start + step)

    def _sums(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(G, n) log likelihoods; (G, N) terms e; (G, n) normalisers of e and (G, n) shares of the demonstrations."""
        # einsum and not BLAS, whose sums depend on the number of threads
        terms = np.einsum("gf,fj->gj", points, self._rows) + self.log_w
        peak = terms.max(axis=1, keepdims=True)
        np.exp(np.subtract(terms, peak, out=terms), out=terms)
        own = np.einsum("gf,nf->gn", points, self._chosen) + self.chosen_log_w - peak
        if self._ratios is None:
            total = np.broadcast_to(terms.sum(axis=1, keepdims=True), own.shape)
            return own - np.log(total), terms, total, np.zeros_like(own)
        others = np.einsum("gj,nj->gn", terms, self._ratios)
        log_total = np.logaddexp(np.log(others), own)
        return own - log_total, terms, others, np.exp(own - log_total)

    def _derivatives(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        log_p, terms, others, share = self._sums(points)
        chosen, size, ratios = self._chosen, self.features, self._ratios
        if ratios is None:
            p = terms / terms.sum(axis=1, keepdims=True)
            mean = np.einsum("gj,fj->gf", p, self._rows)
            square = np.einsum("gj,kj->gk", p, self._squares).reshape(-1, size, size)
            curvature = square - mean[:, :, None] * mean[:, None, :]
            return log_p.sum(axis=1), chosen.sum(axis=0) - self.count * mean, self.count * curvature
        scaled = (1 - share) / others  # of the terms in each joined set
        first = np.stack([np.einsum("gj,nj->gn", terms * row, ratios) for row in self._rows], axis=2)
        mean = scaled[:, :, None] * first + share[:, :, None] * chosen
        p = terms * np.einsum("gn,nj->gj", scaled, ratios)
        square = np.einsum("gj,kj->gk", p, self._squares).reshape(-1, size, size)
        square += np.einsum("gn,nf,nh->gfh", share, chosen, chosen)
        curvature = square - np.einsum("gnf,gnh->gfh", mean, mean)
        return log_p.sum(axis=1), (chosen - mean).sum(axis=1), curvature
