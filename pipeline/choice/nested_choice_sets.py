"""Choices of many people, each from a set of their own, under nested logit: likelihood and estimation.

V_i = weights . phi_i and S_m = sum over a nest m of exp(V_i / l + log_w_i). P(i) = exp(V_i / l + log_w_i) / S_m * S_m^l
/ sum of S^l over the nests of the set. Without log weights it is nested logit as in `nested_logit`. With those of drawn
alternatives, log(times drawn) - log q, S_m estimates up to a factor of the set the sum over all alternatives of the
nest, drawn or not, as Guevara and Ben-Akiva (2013), Sampling of alternatives in multivariate extreme value models, do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.conditional_logit import ChoiceSets
from pipeline.choice.validation import vector
from pipeline.errors import ArgumentError

LEAST_DISSIMILARITY = 0.05


@dataclass(frozen=True)
class NestedChoiceSets:
    """Choice sets whose alternatives lie in nests.

    Attributes:
        sets: the choice sets.
        nests: (N,) number of the nest of each alternative, the same for alternatives of one nest of one set.

    Raises:
        ArgumentError: shapes do not fit.
    """

    sets: ChoiceSets
    nests: IndexArray

    def __post_init__(self) -> None:
        if self.nests.shape != (len(self.sets.features),):
            raise ArgumentError(f"nests are of {self.nests.size} alternatives; there are {len(self.sets.features)}.")

    def log_probabilities(self, weights: ArrayLike, dissimilarity: float, log_w: ArrayLike) -> FloatArray:
        """(n,) log probability of each choice.

        Args:
            weights: (F,) per unit of each feature.
            dissimilarity: l, above 0 and at most 1.
            log_w: (N,) log weights of the alternatives.
        """
        if not 0 < dissimilarity <= 1:
            raise ArgumentError(f"dissimilarity is {dissimilarity}; it must be above 0 and at most 1.")
        checked = vector("weights", weights, self.sets.features.shape[1])
        parameters = np.append(checked, dissimilarity)
        return self._parts(parameters, vector("log_w", log_w, len(self.nests)))[0]

    def estimate(
        self, log_w: ArrayLike, counts: ArrayLike | None = None, start: ArrayLike | None = None
    ) -> tuple[FloatArray, float]:
        """The weights (F,) and the dissimilarity of the greatest likelihood, from the start uphill.

        The likelihood may have several peaks. The dissimilarity is sought from 0.05 to 1.

        Args:
            log_w: (N,) log weights of the alternatives.
            counts: (n,) how often each choice counts; once if not given.
            start: (F + 1,) weights and dissimilarity to begin at; Boltzmann's weights and 0.7 if not given.

        Raises:
            ArgumentError: the search does not come to an end.
        """
        from scipy import optimize

        logs = vector("log_w", log_w, len(self.nests))
        often = np.ones(len(self.sets.starts)) if counts is None else vector("counts", counts, len(self.sets.starts))
        if start is None:
            start = np.append(self.sets.estimate(logs, often), 0.7)
        first = np.array(start, dtype=np.float64)
        # the dissimilarity first, so that its bounds remain bounds where steps of all parameters are of one length
        turned = np.append(len(first) - 1, np.arange(len(first) - 1))
        _, slopes = self._parts(first, logs)
        curvature = (slopes[:, turned].T * often) @ slopes[:, turned] / often.sum()
        curvature += 1e-12 * np.diag(np.maximum(np.diag(curvature), 1.0))
        steps = np.linalg.cholesky(np.linalg.inv(curvature))
        ends = (np.array([LEAST_DISSIMILARITY, 1.0]) - first[-1]) / steps[0, 0]

        def negative(moved: FloatArray) -> tuple[float, FloatArray]:
            log_p, slopes = self._parts(there(moved), logs)
            return -float(often @ log_p) / often.sum(), -(often @ slopes)[turned] @ steps / often.sum()

        def there(moved: FloatArray) -> FloatArray:
            parameters = first.copy()
            parameters[turned] += steps @ moved
            parameters[-1] = min(max(parameters[-1], LEAST_DISSIMILARITY), 1.0)
            return parameters

        found: Any = optimize.minimize(
            negative, np.zeros(len(first)), jac=True, method="L-BFGS-B",
            bounds=[tuple(ends), *[(None, None)] * (len(first) - 1)],
            options={"maxiter": 500, "ftol": 1e-13, "gtol": 1e-5},
        )  # fmt: skip
        best = there(found.x)
        if not found.success:
            raise ArgumentError(f"the search stopped at {best.tolist()} ({found.message}).")
        return best[:-1], float(best[-1])

    @cached_property
    def _layout(self) -> _Layout:
        return _Layout.of(self.sets, self.nests)

    def _parts(self, parameters: FloatArray, log_w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) log probabilities of the choices and (n, F + 1) their derivatives.

        With I_m = log S_m and means over nests under exp(V / l + log_w) / S_m:
        dI_m / dw = mean phi / l, and dI_m / dl = -mean V / l^2.
        """
        at, scale = self._layout, float(parameters[-1])
        values = at.features @ parameters[:-1]
        inner = values / scale + log_w[at.order]
        best = np.maximum.reduceat(inner, at.first)
        exponentials = np.exp(inner - np.repeat(best, at.sizes))
        sums = np.add.reduceat(exponentials, at.first)
        inclusive = best + np.log(sums)
        exponentials /= np.repeat(sums, at.sizes)
        slopes = np.empty((len(sums), len(parameters)))  # of I_m
        slopes[:, :-1] = np.add.reduceat(exponentials[:, None] * at.features, at.first) / scale
        slopes[:, -1] = -np.add.reduceat(exponentials * values, at.first) / scale**2
        outer = scale * inclusive
        top = np.maximum.reduceat(outer, at.first_nest)
        shares = np.exp(outer - np.repeat(top, at.nests_of_set))
        totals = np.add.reduceat(shares, at.first_nest)
        shares /= np.repeat(totals, at.nests_of_set)
        of_nests = scale * slopes  # of l I_m
        of_nests[:, -1] += inclusive
        of_all = np.add.reduceat(shares[:, None] * of_nests, at.first_nest)
        own = at.chosen_nest
        log_p = inner[at.chosen] - inclusive[own] + outer[own] - (top + np.log(totals))
        of_choice = np.column_stack([at.features[at.chosen] / scale, -values[at.chosen] / scale**2])
        return log_p, of_choice - slopes[own] + of_nests[own] - of_all


@dataclass(frozen=True)
class _Layout:
    """The alternatives with those of each nest next to one another, set after set.

    Attributes:
        order: (N,) rows of the choice sets in this order; everything else is in it.
        features: (N, F).
        first, sizes: (M,) first row of each nest, and how many it has.
        first_nest, nests_of_set: (n,) first nest of each set, and how many it has.
        chosen, chosen_nest: (n,) row and nest of each choice.
    """

    order: IndexArray
    features: FloatArray
    first: IndexArray
    sizes: IndexArray
    first_nest: IndexArray
    nests_of_set: IndexArray
    chosen: IndexArray
    chosen_nest: IndexArray

    @classmethod
    def of(cls, sets: ChoiceSets, nests: IndexArray) -> _Layout:
        count = len(nests)
        set_of = np.repeat(np.arange(len(sets.starts)), np.diff(np.append(sets.starts, count)))
        order = np.lexsort((nests, set_of))
        begins = np.ones(count, dtype=bool)
        begins[1:] = (np.diff(nests[order]) != 0) | (np.diff(set_of[order]) != 0)
        first = np.flatnonzero(begins)
        nest_of = np.cumsum(begins) - 1
        place = np.empty(count, dtype=np.intp)
        place[order] = np.arange(count)
        first_nest = np.searchsorted(set_of[order][first], np.arange(len(sets.starts)))
        chosen = place[sets.chosen]
        return cls(
            order, sets.features[order], first, np.diff(np.append(first, count)), first_nest,
            np.diff(np.append(first_nest, len(first))), chosen, nest_of[chosen],
        )  # fmt: skip
