"""The study of real trips: estimates, held-out scores and how much both depend on the sampler."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations, product
from types import MappingProxyType

import numpy as np
import polars as pl

from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.recursive_logit import RecursiveLogit
from pipeline.errors import ArgumentError
from pipeline.studies.statistics import crossed_lead
from pipeline.studies.trips.choices import WORKERS, Drawn, draw_all, drawers
from pipeline.studies.trips.drawn_paths import SAMPLERS
from pipeline.studies.trips.estimation import Estimator
from pipeline.studies.trips.examples import example_routes
from pipeline.studies.trips.path_models import BOLTZMANN_CORRECTED, MODELS, RECURSIVE_LOGIT
from pipeline.studies.trips.roads import FEATURES, Roads
from pipeline.trajectories.random_streams import child_rng

SAMPLINGS: Mapping[int, int] = MappingProxyType({10: 5, 30: 5, 100: 5, 300: 4, 1000: 3})
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


def run_trips(
    roads: Roads,
    seed: int,
    samplings: Mapping[int, int] = SAMPLINGS,
    tracked: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> TripsStudy:
    """All of it, sampling by sampling, each with sets of all sizes.

    Many trips are drawn in further processes, which import the program that was started; so a script of your own needs
    its call under `if __name__ == "__main__":`.

    Args:
        roads: the network and the trips.
        seed: of the project.
        samplings: how many samplings there are of each set size.
        tracked: goes through the samplings, and may show how far it is.

    Raises:
        ArgumentError: a model cannot be estimated.
        BrokenProcessPool: a process was ended from outside, or could not begin.
    """
    logit = roads.recursive_logit()
    folds = folds_of(len(roads.trips), seed)
    exact = logit.estimate(START)
    with ThreadPoolExecutor(WORKERS) as pool:
        others = pool.map(lambda held: logit.estimate(exact.weights, (~held).astype(np.float64)), folds)
        exact_folds = [one.weights for one in others]
    estimates: list[dict[str, object]] = []
    held_out: list[pl.DataFrame] = []
    shown = min(samplings, key=lambda size: abs(size - SHOWN_SIZE))
    with drawers(len(roads.trips)) as drawing, ThreadPoolExecutor(WORKERS) as pool:
        for sampling in tracked(range(max(samplings.values()))):
            sizes = [size for size, count in samplings.items() if sampling < count]
            drew = draw_all(roads, sizes, sampling, seed, drawing)
            if sampling == 0:
                kernels = drew.kernels[shown]

            def one(key: tuple[int, str, str], drawn: Mapping[int, Mapping[str, Drawn]] = drew.drawn) -> _Fit:
                size, sampler, model = key
                return _fit(drawn[size][sampler], model, folds, exact_folds, logit)

            keys = list(product(sizes, SAMPLERS, MODELS))
            for (size, sampler, model), fit in zip(keys, pool.map(one, keys), strict=True):
                about = {"sampler": sampler, "set_size": size, "sampling": sampling}
                held_out.append(_by_trip(roads, about, model, fit.held_out))
                if fit.parameters is not None:
                    estimates.append(about | _estimate(model, fit))
    by_trip, table = pl.concat(held_out), pl.DataFrame(estimates)
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
        *example_routes(roads, seed, table, exact.weights, kernels, [shown, *samplings]),
    )


def folds_of(count: int, seed: int) -> list[BoolArray]:
    """Which trips are held out in each of the folds; each is in one."""
    order = child_rng(seed, "trips", "folds").permutation(count)
    return [np.isin(np.arange(count), order[first::FOLDS]) for first in range(FOLDS)]


def summed_up(held_out: pl.DataFrame) -> pl.DataFrame:
    """The mean score of each model, sampler and set size, and its difference from corrected Boltzmann, with errors.

    The error over trips is that of the mean over trips of their means over samplings, that over samplings is that of
    the mean of samplings. The interval of 95 % is over both, as crossed random effects (`crossed_lead`). Where there
    is one sampling, it is over trips alone.
    """
    keys = ["sampler", "set_size", "sampling", "trip"]
    reference = held_out.filter(model=BOLTZMANN_CORRECTED).select(*keys, reference="log_predictive")
    rows = held_out.join(reference, on=keys, how="inner", maintain_order="left").with_columns(
        difference=pl.col("log_predictive") - pl.col("reference")
    )
    table = []
    for (model, sampler, size), part in rows.sort("sampling", "trip").group_by(
        "model", "sampler", "set_size", maintain_order=True
    ):
        count = part["sampling"].n_unique()
        row: dict[str, object] = {"model": model, "sampler": sampler, "set_size": size}
        for column in ("log_predictive", "difference"):
            row |= _interval(column, part[column].to_numpy().reshape(count, -1))
        table.append(row | {"samplings": count})
    order = pl.DataFrame(table).sort("model", "sampler", "set_size")
    names = ["model", "sampler", "set_size", *(c for c in order.columns if c.startswith("log_predictive")), "samplings"]
    return order.select(*names, *(c for c in order.columns if c.startswith("difference")))


def _interval(name: str, values: FloatArray) -> dict[str, float | None]:
    """The mean of (samplings, trips) values under `name`, with its errors and its interval."""
    from scipy.special import stdtrit

    samplings, trips = values.shape
    mean, over_trips = float(values.mean()), float(values.mean(axis=0).std(ddof=1)) / trips**0.5
    over_samplings = None
    half = float(stdtrit(trips - 1, 0.975)) * over_trips
    low, high = mean - half, mean + half
    if samplings > 1:
        over_samplings = float(values.mean(axis=1).std(ddof=1)) / samplings**0.5
        lead = crossed_lead(values)
        low, high = lead.low, lead.high
    return {
        name: mean, f"{name}_error_trips": over_trips, f"{name}_error_samplings": over_samplings,
        f"{name}_lower": low, f"{name}_upper": high,
    }  # fmt: skip


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


@dataclass(frozen=True)
class _Fit:
    """What one model made of one set of draws; the recursive logit has no parameters of its own there."""

    parameters: FloatArray | None
    log_likelihood: float
    log_likelihood_all_paths: float | None
    held_out: FloatArray


def _fit(
    drawn: Drawn, model: str, folds: list[BoolArray], exact_folds: list[FloatArray], logit: RecursiveLogit
) -> _Fit:
    """The parameters from all trips, and the score of each trip under the parameters from the other folds."""
    estimator = Estimator(drawn, model)
    if model == RECURSIVE_LOGIT:
        return _Fit(None, float("nan"), None, estimator.held_out(exact_folds, folds))
    parameters = estimator.fit()
    parts = [estimator.fit((~held).astype(np.float64), parameters) for held in folds]
    inside, over_all = float(estimator.log_p(parameters).sum()), None
    if len(parameters) == len(FEATURES):
        try:
            over_all = float(logit.log_likelihoods(parameters).sum())
        except ArgumentError:  # the sum over all paths is infinite at these weights
            over_all = None
    return _Fit(parameters, inside, over_all, estimator.held_out(parts, folds))


def _estimate(model: str, fit: _Fit) -> dict[str, object]:
    assert fit.parameters is not None
    weights = fit.parameters.tolist()
    return {
        "model": model, **dict(zip(FEATURES, weights, strict=False)),
        "own": weights[-1] if len(weights) > len(FEATURES) else None,
        "log_likelihood": fit.log_likelihood, "log_likelihood_all_paths": fit.log_likelihood_all_paths,
    }  # fmt: skip


def _by_trip(roads: Roads, about: Mapping[str, object], model: str, scores: FloatArray) -> pl.DataFrame:
    columns = {name: pl.lit(value) for name, value in about.items()}
    return pl.DataFrame({"trip": roads.trips, "log_predictive": scores}).with_columns(model=pl.lit(model), **columns)
