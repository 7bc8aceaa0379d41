"""The trajectory that is best for what is believed: expected cost over draws of the weights, and its regret.

For a linear reward the expectation over omega is the reward of the mean omega, so one search with the mean weights
finds the plan; searches with single draws show how it would change, and say what is lost by not knowing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.errors import ArgumentError
from pipeline.trajectories.optimise import Assess, Search, optimise_paths
from pipeline.trajectories.paths import Anchor, frozen

DEFAULT_SEARCH = Search()


@dataclass(frozen=True, eq=False)
class Plan:
    """A planned trajectory and what is known of it. Rewards are omega . phi, in nats.

    Attributes:
        waypoints: (T, J) of the plan, read-only.
        features: (F,) scaled.
        expected_reward: over the draws.
        regret: (S,) reward that a draw's own best known trajectory would have more than the plan, >= 0. What is known
            are the trajectories of this search and the candidates, so it is a lower bound, tight for the draws that
            were searched.
        expected_regret: its mean under the draws' weights.
        alternatives: (C, T, J) the best trajectory for each searched draw: the plan's spread over the belief.
        alternative_features: (C, F) scaled.
        searched: (C,) rows of the draws they belong to.
        change: (C,) root mean square distance of each from the plan over joints and waypoints (rad for hinges).
        inadmissible: share of all candidates that left the limits or that the scene does not allow.
    """

    waypoints: FloatArray
    features: FloatArray
    expected_reward: float
    regret: FloatArray
    expected_regret: float
    alternatives: FloatArray
    alternative_features: FloatArray
    searched: IndexArray
    change: FloatArray
    inadmissible: float


def plan_in_expectation(
    rngs: Sequence[np.random.Generator],
    anchor: Anchor,
    omegas: FloatArray,
    weights: FloatArray,
    assess: Assess,
    *,
    lower: FloatArray,
    upper: FloatArray,
    n_waypoints: int,
    candidates: FloatArray | None = None,
    restarts: int = 3,
    search: Search = DEFAULT_SEARCH,
) -> Plan:
    """Plan for a belief over weights, within the limits and what the scene allows.

    The mean weights are searched `restarts` times, a few draws spread over the belief once each; the plan is the
    best in expectation of everything that was found. To let every draw count alike, however decided, give unit vectors.

    Args:
        rngs: `restarts` generators, and one more for each draw to be searched.
        anchor: start and goal, joint positions (J,).
        omegas: (S, F) draws of the weights on the scaled features; a cost is negative.
        weights: (S,) of the draws.
        assess: (N, T, J) -> (N, F) scaled features and (N,) whether the path is allowed; see `bounded`.
        lower, upper: (J,) joint limits.
        n_waypoints: T.
        candidates: (C, T, J) paths that are known already, e.g. the alternatives; those that are allowed compete too.
        restarts: searches with the mean weights, >= 1.
        search: how hard to search.

    Raises:
        ArgumentError: shapes do not fit, or there are fewer generators than restarts.
        StageError: no admissible path was found.
    """
    draws, share = np.asarray(omegas, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    if draws.ndim != 2 or share.shape != draws.shape[:1] or not share.sum() > 0 or not np.all(share >= 0):
        raise ArgumentError(
            f"omegas has shape {draws.shape} and weights {share.shape}; (S, F) and (S,), none negative, are needed."
        )
    if not 1 <= restarts <= len(rngs):
        raise ArgumentError(f"restarts is {restarts}; it must be between 1 and the number of rngs, {len(rngs)}.")
    share = share / share.sum()
    mean = share @ draws
    searched = spread_rows(draws, share, len(rngs) - restarts)
    wanted = np.concatenate([np.repeat(mean[None], restarts, axis=0), draws[searched]])
    # each search minimises costs of one size, whatever the draw's: the strategy's steps do not depend on it
    size = np.maximum(np.linalg.norm(wanted, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    found = optimise_paths(
        rngs, anchor, -wanted / size, assess, lower=lower, upper=upper, n_waypoints=n_waypoints, search=search
    )
    paths, features = found.waypoints, assess(found.waypoints)[0]
    if candidates is not None:
        terms, allowed = assess(candidates)
        paths, features = np.concatenate([paths, candidates[allowed]]), np.concatenate([features, terms[allowed]])
    best = int((features @ mean).argmax())
    rewards = draws @ features.T
    regret = rewards.max(axis=1) - rewards[:, best]
    own = features @ draws[searched].T  # a draw's best may have been found in another's search
    alternatives = own.argmax(axis=0)
    change = np.sqrt(((paths[alternatives] - paths[best]) ** 2).mean(axis=(1, 2)))
    return Plan(
        waypoints=frozen(paths[best]),
        features=frozen(features[best]),
        expected_reward=float(features[best] @ mean),
        regret=frozen(regret),
        expected_regret=float(share @ regret),
        alternatives=frozen(paths[alternatives]),
        alternative_features=frozen(features[alternatives]),
        searched=searched,
        change=frozen(change),
        inadmissible=found.inadmissible,
    )


def bounded(assess: Assess, least: FloatArray, greatest: FloatArray) -> Assess:
    """`assess` that also refuses paths whose scaled features leave the box from `least` to `greatest`, both (F,).

    Without a bound on effort a belief that people like to waste it has no best path. Give the box of the alternatives,
    or of the declared choice space.
    """

    def inside(waypoints: FloatArray) -> tuple[FloatArray, BoolArray]:
        features, allowed = assess(waypoints)
        return features, allowed & ((features >= least) & (features <= greatest)).all(axis=1)

    return inside


def spread_rows(draws: FloatArray, weights: FloatArray, count: int) -> IndexArray:
    """(count,) rows at even steps of probability along the direction in which the draws vary most.

    Raises:
        ArgumentError: `count` is negative.
    """
    if count < 0:
        raise ArgumentError(f"count is {count}; it must be 0 or more.")
    share = weights / weights.sum()
    centred = draws - share @ draws
    _, vectors = np.linalg.eigh(np.einsum("s,sf,sg->fg", share, centred, centred))
    axis = vectors[:, -1] * np.sign(vectors[np.abs(vectors[:, -1]).argmax(), -1])
    order = np.argsort(draws @ axis, kind="stable")
    places = (np.arange(count) + 0.5) / max(count, 1)
    picked = np.searchsorted(np.cumsum(share[order]), places)
    return np.asarray(order[np.minimum(picked, len(order) - 1)])
