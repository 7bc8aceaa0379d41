"""The routes of a few trips and the shares that models predict for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.studies.trips.choices import Part, drawn_sets, joined, pooled
from pipeline.studies.trips.drawn_paths import PathSet
from pipeline.studies.trips.estimation import Estimator
from pipeline.studies.trips.path_models import BY_SET, RECURSIVE_LOGIT, Kernels
from pipeline.studies.trips.roads import FEATURES, Roads
from pipeline.trajectories.network_walks import END

QUANTILES = (0.5, 0.75, 0.9)  # of travel time: which trips are shown
SAMPLER = "fast"


def example_routes(
    roads: Roads, seed: int, estimates: pl.DataFrame, exact: FloatArray, kernels: Kernels, sizes: Sequence[int]
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """The rows of trips_routes, each distinct path of some trips under each model, and of trips_route_links.

    The trips are those whose travel times are the quantiles of all. Shares are at the weights estimated from all trips;
    those of the recursive logit are probabilities among all paths, of which there are more than in the set.

    Args:
        roads: the network and the trips.
        seed: of the project.
        estimates: rows of trips_estimates.
        exact: (4,) weights of the recursive logit.
        kernels: of the first sampling for these sets.
        sizes: that of the sets, and after it the others that were drawn with them.
    """
    minutes = np.array([roads.features[path, 0].sum() for path in roads.paths])
    order = np.argsort(minutes, kind="stable")
    chosen = [int(order[int(share * (len(order) - 1))]) for share in QUANTILES]
    size = sizes[0]
    log_all = roads.recursive_logit().log_likelihoods(exact)
    tables, links = [], []
    for index in chosen:
        sets = next(iter(drawn_sets(roads, sizes, 0, seed, [index])))[1][size]
        paths = sets[SAMPLER]
        utilities = paths.features @ exact  # the path taken comes first, and its probability is known
        shares = {RECURSIVE_LOGIT: np.exp(log_all[index] + utilities - utilities[0])}
        for model in BY_SET:
            weights = estimates.filter(model=model, sampler=SAMPLER, set_size=size, sampling=0).row(0, named=True)
            own = [] if weights["own"] is None else [weights["own"]]
            parameters = np.array([*(weights[name] for name in FEATURES), *own])
            shares[model] = _shares(model, paths, pooled(sets), kernels, parameters)
        tables += [_rows(roads.trips[index], paths, model, share) for model, share in shares.items()]
        links.append(_links(roads, index, paths))
    return pl.concat(tables), pl.concat(links)


def _shares(model: str, paths: PathSet, pool: FloatArray, kernels: Kernels, parameters: FloatArray) -> FloatArray:
    """(N,) the probability of each path among those of the set."""
    part = Part.of(paths, pool, kernels)
    every = joined([part.with_first(row) for row in range(len(paths.features))])
    return np.exp(Estimator(every, model).log_p(parameters))


def _links(roads: Roads, index: int, paths: PathSet) -> pl.DataFrame:
    route, place = np.nonzero(paths.steps != END)
    links = roads.network.targets[paths.steps[route, place]] + 1
    return pl.DataFrame({"trip": [roads.trips[index]] * len(route), "route": route, "place": place + 1, "link": links})


def _rows(trip: int, paths: PathSet, model: str, shares: FloatArray) -> pl.DataFrame:
    return pl.DataFrame(
        {
            "trip": [trip] * len(shares),
            "model": model,
            "route": np.arange(len(shares)),
            "share": shares,
            "travel_time": paths.features[:, 0],
        }
    )
