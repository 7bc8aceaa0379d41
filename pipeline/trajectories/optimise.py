"""Stochastic trajectory optimisation for many cost weightings at once, whose candidates are replayed in one batch.

The search is an evolution strategy with weighted recombination and cumulative step-size adaptation (Hansen,
"The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772, equations 6, 40-44 and the constants of its table 1,
without the covariance update) over the coefficients of `sine_basis`. With decay 1 the sum of squared steps is a
multiple of the squared norm of the coefficients, so no covariance needs to be learned for that term.

All weightings are searched together in arrays, while the package `cma` (4.5) searches one at a time. For the 36 paths
of the default sampler for the table task, 120 populations of this strategy take 0.6 s and close 94 % of the gap in cost
between the straight path and the result of a long search. 60 populations of `cma` with a diagonal covariance take 0.8 s
and close 91 %.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import ArgumentError, StageError
from pipeline.trajectories.paths import (
    Anchor,
    frozen,
    require_anchor_within,
    require_positive,
    sine_basis,
    straight_path,
    within_limits,
)

Assess = Callable[[FloatArray], tuple[FloatArray, BoolArray]]
"""From waypoints (N, T, J) to cost terms (N, F), on comparable scales, and (N,) which paths are admissible."""


@dataclass(frozen=True)
class Search:
    """The effort of a search.

    By default there are 1,200 candidates per weighting. On the JACO arm, with efficiency, table and laptop as costs and
    12 random weightings, they closed 98 % of the gap in mean cost between the straight path and the result of 6,400
    candidates with 5 half waves.

    Attributes:
        modes: number of half waves per joint that are added to the straight path.
        step_rad: initial root mean square deviation of the candidates from the straight path.
        population: candidates per weighting and iteration, >= 4.
        iterations: number of populations.
    """

    modes: int = 3
    step_rad: float = 0.3
    population: int = 12
    iterations: int = 100

    def __post_init__(self) -> None:
        require_positive("step_rad", self.step_rad)
        if self.modes < 1 or self.population < 4 or self.iterations < 1:
            raise ArgumentError(
                f"modes is {self.modes}, population {self.population}, iterations {self.iterations}; "
                f"allowed are >= 1, >= 4 and >= 1."
            )


@dataclass(frozen=True, eq=False)
class Optimised:
    """The best admissible path that was tried for each weighting.

    Attributes:
        waypoints: (P, T, J), read-only.
        costs: (P,) weighted cost of each path.
        inadmissible: share of all candidates that left the joint limits or that the scene does not allow.
    """

    waypoints: FloatArray
    costs: FloatArray
    inadmissible: float


def optimise_paths(
    rngs: Sequence[np.random.Generator],
    anchor: Anchor,
    weights: FloatArray,
    assess: Assess,
    *,
    lower: FloatArray,
    upper: FloatArray,
    n_waypoints: int,
    search: Search = Search(),
) -> Optimised:
    """Find, for each row of `weights`, an admissible path of low weighted cost from start to goal.

    For row p it minimises weights_p . cost terms(path). A candidate that leaves the limits or is inadmissible takes no
    part in the recombination. Each weighting has its own random stream, so another row changes no result.

    Args:
        rngs: P random generators, one per row of `weights`.
        anchor: start and goal, joint positions (J,).
        weights: (P, F) weight of each cost term, usually >= 0.
        assess: from (N, T, J) paths within the limits to (N, F) cost terms and (N,) whether the scene allows each. It
            is one function, so that each path is replayed once.
        lower, upper: (J,) joint limits (rad), infinite for a continuous joint.
        n_waypoints: T.
        search: the effort.

    Raises:
        ArgumentError: generators and weights do not match, or the anchor is outside the limits.
        StageError: no admissible path was tried for some weighting.
    """
    weights = np.asarray(weights, dtype=np.float64)
    if weights.ndim != 2 or len(weights) != len(rngs) or not len(rngs):
        raise ArgumentError(f"weights has shape {weights.shape}; it must be (P, F) for the {len(rngs)} rngs, P >= 1.")
    require_anchor_within(anchor, lower, upper)
    line = straight_path(anchor, n_waypoints)
    basis = sine_basis(n_waypoints, search.modes, 1.0)

    def evaluate(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Paths (P, L, T, J) and weighted costs (P, L), infinite where a path is not allowed."""
        paths = line + np.einsum("kt,plkj->pltj", basis, z)
        flat = paths.reshape(-1, *line.shape)
        values = np.full(len(flat), np.inf)
        inside = within_limits(flat, lower, upper)
        if inside.any():
            weighting = np.repeat(np.arange(len(z)), z.shape[1])[inside]
            terms, allowed = assess(flat[inside])
            values[inside] = np.where(allowed, (weights[weighting] * terms).sum(axis=1), np.inf)
        return paths, values.reshape(z.shape[:2])

    shape = (search.modes, anchor.start.size)
    strategy = _EvolutionStrategy(len(weights), shape, search.population, search.step_rad)
    best_value = np.full(len(weights), np.inf)
    best_path = np.repeat(line[None], len(weights), axis=0)
    refused = 0
    rows = np.arange(len(weights))
    for _ in range(search.iterations):
        noise = np.stack([rng.standard_normal((search.population, *shape)) for rng in rngs])
        paths, values = evaluate(strategy.candidates(noise))
        refused += int(np.isinf(values).sum())
        best = values.argmin(axis=1)
        value = values[rows, best]
        better = value < best_value
        best_path[better] = paths[rows, best][better]
        best_value[better] = value[better]
        strategy.update(noise, values)
    if np.isinf(best_value).any():
        raise StageError(
            f"no admissible path was found for weights {weights[np.isinf(best_value)][0].tolist()} in "
            f"{search.iterations} populations of {search.population}; raise step_rad or move the start and goal."
        )
    return Optimised(
        frozen(best_path), frozen(best_value), refused / (search.iterations * best_value.size * search.population)
    )


class _EvolutionStrategy:
    """(mu/mu_w, lambda) evolution strategy with cumulative step-size adaptation, for P problems of one shape."""

    def __init__(self, problems: int, shape: tuple[int, int], population: int, step: float) -> None:
        n = shape[0] * shape[1]
        parents = population // 2
        self._recombination = np.zeros(population)  # by rank, best first
        self._recombination[:parents] = np.log((population + 1) / 2) - np.log(np.arange(1, parents + 1))
        self._recombination /= self._recombination.sum()
        mass = 1 / (self._recombination**2).sum()  # mu_eff
        self._learning = (mass + 2) / (n + mass + 5)  # c_sigma
        self._damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / (n + 1)) - 1) + self._learning  # d_sigma
        self._expected_length = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))  # E |N(0, I)|
        self._mean = np.zeros((problems, *shape))
        self._evolution = np.zeros((problems, *shape))  # p_sigma
        self._step = np.full((problems, 1, 1), step)

    def candidates(self, noise: FloatArray) -> FloatArray:
        """(P, L, K, J) candidates from standard normals of the same shape."""
        points: FloatArray = self._mean[:, None] + self._step[:, None] * noise
        return points

    def update(self, noise: FloatArray, values: FloatArray) -> None:
        """Update mean and step size from the values (P, L) of the candidates of `noise`; infinite ones do not count."""
        order = np.argsort(values, axis=1, kind="stable")
        share = np.zeros_like(values)
        np.put_along_axis(share, order, np.broadcast_to(self._recombination, values.shape), axis=1)
        share[np.isinf(values)] = 0.0
        total = share.sum(axis=1)
        moved = total > 0  # a problem without one allowed candidate stays as it is
        share = share[moved] / total[moved, None]
        jump = np.einsum("pl,plkj->pkj", share, noise[moved])
        mass = 1 / (share**2).sum(axis=1)[:, None, None]
        self._mean[moved] += self._step[moved] * jump
        c = self._learning
        self._evolution[moved] = (1 - c) * self._evolution[moved] + np.sqrt(c * (2 - c) * mass) * jump
        length = np.sqrt((self._evolution[moved] ** 2).sum(axis=(1, 2), keepdims=True))
        self._step[moved] *= np.exp(c / self._damping * (length / self._expected_length - 1))


def random_weights(rng: np.random.Generator, count: int, features: int) -> FloatArray:
    """(count, features) cost weights: unit vectors, uniformly distributed among those without negative entries."""
    w = np.abs(rng.standard_normal((count, features)))
    unit: FloatArray = w / np.linalg.norm(w, axis=1, keepdims=True)
    return unit
