"""Demonstrations that each model of people draws in a grid world, and the posteriors that each model infers.

The choice set holds all shortest paths, so results differ by the models alone and not by a sample of alternatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import polars as pl
from scipy.special import softmax

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice import (
    LESS,
    AttributeRule,
    Boltzmann,
    Model,
    PathSize,
    log_density,
    log_likelihood,
    select_bandwidth,
    true_match,
    true_posterior,
)
from pipeline.choice.scaling import feature_scale
from pipeline.params import GridWorldSettings
from pipeline.trajectories.grid_world import Cells, link_incidence, mean_distances, mean_positions, shortest_paths
from pipeline.vocabulary import LESS_HIDDEN, LESS_HIDDEN_OWN_BANDWIDTH

SAMPLING_MODELS = (Boltzmann.name, LESS.name)
# In these models people also see similarity in mean x and mean y, which the robot does not. Their kernel has the
# bandwidth of the robot's, or one that is selected for all four features. The paper does not say which, and H5 depends
# on it, so both are reported.
HIDDEN_MODELS = (LESS_HIDDEN, LESS_HIDDEN_OWN_BANDWIDTH)
INFERENCE_MODELS = (Boltzmann.name, LESS.name, AttributeRule.name, PathSize.name)
THETAS: FloatArray = np.array([theta for theta in product((-1.0, 0.0, 1.0), repeat=2) if any(theta)])

_TRIALS = {
    "sampling_model": pl.String,
    "inference_model": pl.String,
    "theta_id": pl.Int64,
    "seed": pl.Int64,
    "true_posterior": pl.Float64,
    "true_match": pl.Boolean,
}


@dataclass(frozen=True, eq=False)
class GridWorld:
    """The choice set, and the probability of each choice under each model.

    Attributes:
        paths: (N, T, 2) cells.
        features: (N, 2) mean distances to the objects, each divided by its range over all paths.
        log_probabilities: (K, N) log p(path | theta, beta) for every model that samples or infers.
        bandwidths: sigma of `less` and of each hidden model.
        log_density: (N,) log kernel sum of `less` at each path.
    """

    paths: Cells
    features: FloatArray
    log_probabilities: Mapping[str, FloatArray]
    bandwidths: Mapping[str, float]
    log_density: FloatArray


def build_world(settings: GridWorldSettings, bandwidth: float | None = None) -> GridWorld:
    """Enumerate all paths, and compute the probability of each under every model and theta.

    Args:
        settings: the grid world.
        bandwidth: sigma of the LESS kernels in scaled features, selected by leave-one-out if not given.

    Raises:
        ArgumentError: the bandwidth is not positive.
        BandwidthError: no bandwidth could be selected.
    """
    paths = shortest_paths(settings.size)
    features = _scaled(mean_distances(paths, settings.objects), ("first", "second"))
    # mean y is size - 1 - mean x, so the two hidden features are one direction that counts twice
    all_features = np.column_stack([features, _scaled(mean_positions(paths), ("mean_x", "mean_y"))])
    sigma = select_bandwidth(features).value if bandwidth is None else bandwidth
    hidden_sigma = select_bandwidth(all_features).value if bandwidth is None else bandwidth
    bandwidths = dict(zip((LESS.name, *HIDDEN_MODELS), (sigma, sigma, hidden_sigma), strict=True))
    models: dict[str, tuple[Model, Any]] = {
        Boltzmann.name: (Boltzmann(), None),
        LESS.name: (LESS(sigma), None),
        AttributeRule.name: (AttributeRule(), None),
        PathSize.name: (PathSize(), link_incidence(paths)),
    }
    models |= {name: (LESS(bandwidths[name]), all_features) for name in HIDDEN_MODELS}
    rows = np.arange(len(paths))
    log_probabilities = {
        name: log_likelihood(model, rows, features, THETAS, [settings.beta], similarity=similarity)[:, :, 0].T
        for name, (model, similarity) in models.items()
    }
    return GridWorld(paths, features, log_probabilities, bandwidths, log_density(features, sigma))


def draw_demonstrations(log_p: FloatArray, settings: GridWorldSettings, random_seed: int) -> IndexArray:
    """(K, seeds, demonstrations) rows of the choice set, drawn independently with probabilities exp(log_p), (K, N).

    For one theta and seed, all sampling models use the same uniform numbers. A theta and a seed are one subject of the
    statistics, so its sets differ by the model alone.
    """
    cumulative = np.cumsum(np.exp(log_p), axis=1)
    cumulative /= cumulative[:, -1:]
    shape = (settings.seeds, settings.demonstrations)
    drawn = [
        np.searchsorted(row, np.random.default_rng([random_seed, k]).random(shape), side="right")
        for k, row in enumerate(cumulative)
    ]
    return np.stack(drawn)


def posteriors(log_p: FloatArray, drawn: IndexArray) -> FloatArray:
    """(..., K) probability of each theta, given sets of demonstrations (..., D) and a model's log_p (K, N).

    The prior is uniform; demonstrations are independent, so their log likelihoods add.
    """
    result: FloatArray = softmax(np.moveaxis(log_p[:, drawn].sum(axis=-1), 0, -1), axis=-1)
    return result


def run_trials(world: GridWorld, settings: GridWorldSettings, random_seed: int) -> pl.DataFrame:
    """Infer from every demonstration set under every inference model.

    Args:
        world: from `build_world` with these settings.
        settings: numbers of sets and of demonstrations per set.
        random_seed: root of every random number.

    Returns:
        `sampling_model`, `inference_model`, `theta_id`, `seed`, `true_posterior` and `true_match`: whether the true
        theta, and no other, has the largest posterior.
    """
    tables = []
    for sampling_model in (*SAMPLING_MODELS, *HIDDEN_MODELS):
        drawn = draw_demonstrations(world.log_probabilities[sampling_model], settings, random_seed)
        for inference_model in INFERENCE_MODELS:
            posterior = posteriors(world.log_probabilities[inference_model], drawn)
            rows = [
                (sampling_model, inference_model, k, seed, true_posterior(p, k), true_match(p, k) == 1.0)
                for k, sets in enumerate(posterior)
                for seed, p in enumerate(sets)
            ]
            tables.append(pl.DataFrame(rows, schema=_TRIALS, orient="row"))
    return pl.concat(tables)


def _scaled(features: FloatArray, names: tuple[str, ...]) -> FloatArray:
    return features / feature_scale(features, "range", names)
