"""The study of real trips: estimates, held-out scores and how much both depend on the sampler."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType

import numpy as np
import polars as pl

from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.recursive_logit import RecursiveLogit
from pipeline.errors import ArgumentError
from pipeline.studies.trips.choices import Drawn, draw_all
from pipeline.studies.trips.drawn_paths import SAMPLERS
from pipeline.studies.trips.examples import example_routes
from pipeline.studies.trips.path_models import BOLTZMANN_CORRECTED, BY_SET, OWN_FEATURE, RECURSIVE_LOGIT
from pipeline.studies.trips.roads import FEATURES, Roads
from pipeline.trajectories.random_streams import child_rng

SAMPLINGS: Mapping[int, int] = MappingProxyType({10: 3, 30: 3, 100: 2, 300: 2, 1000: 1})
"""How many samplings there are of sets of each size."""
FOLDS = 5
SHOWN_SIZE = 100  # about how large the sets are whose routes are shown
START = (-2.0, -1.0, -1.0, -4.0)  # a place at which the sum over all paths is finite
PUBLISHED = (-2.494, -0.933, -0.411, -4.459)
"""Weights that Fosgerau, Frejinger and Karlstrom (2013) print for this network, in the order of `FEATURES`."""


@dataclass(frozen=True)
class TripsStudy:
    """The tables of the study; each is called `trips_` and the name of the field."""

    exact: pl.DataFrame
    estimates: pl.DataFrame
    held_out: pl.DataFrame
    scores: pl.DataFrame
    angles: pl.DataFrame
    routes: pl.DataFrame
    route_links: pl.DataFrame


def run_trips(roads: Roads, seed: int, samplings: Mapping[int, int] = SAMPLINGS) -> TripsStudy:
    """All of it, set size by set size and sampling by sampling.

    Args:
        roads: the network and the trips.
        seed: of the project.
        samplings: how many samplings there are of each set size.

    Raises:
        ArgumentError: a model cannot be estimated.
    """
    logit = roads.recursive_logit()
    folds = folds_of(len(roads.trips), seed)
    exact = logit.estimate(START)
    exact_folds = [logit.estimate(exact.weights, (~held).astype(np.float64)).weights for held in folds]
    estimates, held_out = [], []
    for size, count in samplings.items():
        for sampling in range(count):
            for sampler, drawn in draw_all(roads, size, sampling, seed).items():
                about = {"sampler": sampler, "set_size": size, "sampling": sampling}
                for model in BY_SET:
                    weights, scores = _estimated(drawn, model, folds)
                    estimates.append(about | _estimate(model, weights, drawn, logit))
                    held_out.append(_by_trip(roads, about, model, scores))
                known = _scores(drawn, BOLTZMANN_CORRECTED, exact_folds, folds)
                held_out.append(_by_trip(roads, about, RECURSIVE_LOGIT, known))
    by_trip, table = pl.concat(held_out), pl.DataFrame(estimates)
    shown = min(samplings, key=lambda size: abs(size - SHOWN_SIZE))
    published = logit.log_likelihoods(PUBLISHED)
    return TripsStudy(
        pl.DataFrame(
            {
                "feature": FEATURES,
                "estimate": exact.weights,
                "standard_error": exact.standard_errors,
                "published": PUBLISHED,
                "log_likelihood": [exact.log_likelihood] * len(FEATURES),
                "log_likelihood_published": [float(published.sum())] * len(FEATURES),
            }
        ),
        table,
        by_trip,
        summed_up(by_trip),
        angles_between_samplers(table),
        *example_routes(roads, seed, table, exact.weights, shown),
    )


def folds_of(count: int, seed: int) -> list[BoolArray]:
    """Which trips are held out in each of the folds; each is in one."""
    order = child_rng(seed, "trips", "folds").permutation(count)
    return [np.isin(np.arange(count), order[first::FOLDS]) for first in range(FOLDS)]


def summed_up(held_out: pl.DataFrame) -> pl.DataFrame:
    """The mean score of each model, sampler and set size, and its difference from corrected Boltzmann, with errors.

    The error over trips is that of the mean over trips of their means over samplings, that over samplings is that of
    the mean of samplings. The first contains what differs between draws from trip to trip. The second adds what all
    trips of a sampling share; it is missing where there is one sampling. The interval of 95 % takes both.
    """
    keys = ["sampler", "set_size", "sampling", "trip"]
    reference = held_out.filter(model=BOLTZMANN_CORRECTED).select(*keys, reference="log_predictive")
    rows = held_out.join(reference, on=keys, how="inner", maintain_order="left").with_columns(
        difference=pl.col("log_predictive") - pl.col("reference")
    )
    keys = ["model", "sampler", "set_size"]
    table = None
    for column in ("log_predictive", "difference"):
        trips = rows.group_by(*keys, "trip", maintain_order=True).agg(pl.col(column).mean())
        by_sampling = rows.group_by(*keys, "sampling", maintain_order=True).agg(pl.col(column).mean())
        over_trips = trips.group_by(keys, maintain_order=True).agg(
            pl.col(column).mean().alias(column), (pl.col(column).std() / pl.len().sqrt()).alias(f"{column}_error_trips")
        )
        over_samplings = by_sampling.group_by(keys, maintain_order=True).agg(
            (pl.col(column).std() / pl.len().sqrt()).alias(f"{column}_error_samplings"),
            pl.len().alias("samplings"),
        )
        both = over_trips.join(over_samplings, on=keys).with_columns(
            half=1.96
            * (pl.col(f"{column}_error_trips") ** 2 + pl.col(f"{column}_error_samplings").fill_null(0.0) ** 2).sqrt()
        )
        both = both.with_columns(
            (pl.col(column) - pl.col("half")).alias(f"{column}_lower"),
            (pl.col(column) + pl.col("half")).alias(f"{column}_upper"),
        ).drop("half")
        table = both if table is None else table.join(both.drop("samplings"), on=keys)
    assert table is not None
    return table.sort(keys)


def angles_between_samplers(estimates: pl.DataFrame) -> pl.DataFrame:
    """The angle between the weights that a model has from two samplers: its mean and spread over samplings."""
    rows = []
    for (model, size, sampling), part in sorted(estimates.group_by("model", "set_size", "sampling")):
        weights = {row["sampler"]: np.array([row[name] for name in FEATURES]) for row in part.to_dicts()}
        for one, other in combinations(SAMPLERS, 2):
            angle = np.degrees(angle_between(weights[one], weights[other]))
            rows.append((model, size, sampling, one, other, angle))
    table = pl.DataFrame(
        rows, schema=["model", "set_size", "sampling", "sampler", "other_sampler", "angle_deg"], orient="row"
    )
    return (
        table.group_by("model", "set_size", "sampler", "other_sampler", maintain_order=True)
        .agg(pl.col("angle_deg").mean(), pl.col("angle_deg").std().alias("spread_deg"))
        .sort("model", "set_size", "sampler", "other_sampler")
    )


def angle_between(a: FloatArray, b: FloatArray) -> float:
    """The angle between two vectors in rad."""
    cosine = float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _estimated(drawn: Drawn, model: str, folds: list[BoolArray]) -> tuple[FloatArray, FloatArray]:
    """The weights from all trips, and (n,) the score of each trip under the weights from the other folds."""
    sets, log_w = drawn.sets(model), drawn.log_w[model]
    weights = sets.estimate(log_w)
    parts = [sets.estimate(log_w, (~held).astype(np.float64), weights) for held in folds]
    return weights, _scores(drawn, model, parts, folds)


def _scores(drawn: Drawn, model: str, weights: list[FloatArray], folds: list[BoolArray]) -> FloatArray:
    sets, log_w = drawn.sets(model), drawn.log_w[model]
    scores = np.empty(len(sets.starts))
    for part, held in zip(weights, folds, strict=True):
        scores[held] = sets.log_probabilities(part, log_w)[sets.chosen][held]
    return scores


def _estimate(model: str, weights: FloatArray, drawn: Drawn, logit: RecursiveLogit) -> dict[str, object]:
    own = float(weights[-1]) if model in OWN_FEATURE else None
    sets = drawn.sets(model)
    inside = float(sets.log_probabilities(weights, drawn.log_w[model])[sets.chosen].sum())
    exact = None
    if own is None:
        try:
            exact = float(logit.log_likelihoods(weights).sum())
        except ArgumentError:  # the sum over all paths is infinite at these weights
            exact = None
    named = dict(zip(FEATURES, weights.tolist(), strict=False))
    return {"model": model, **named, "own": own, "log_likelihood": inside, "log_likelihood_all_paths": exact}


def _by_trip(roads: Roads, about: Mapping[str, object], model: str, scores: FloatArray) -> pl.DataFrame:
    columns = {name: pl.lit(value) for name, value in about.items()}
    return pl.DataFrame({"trip": roads.trips, "log_predictive": scores}).with_columns(model=pl.lit(model), **columns)
