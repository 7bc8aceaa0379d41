"""Section 4.2 of the paper: the demonstration sets on which each model of inference does best, and their density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray, IndexArray
from pipeline.params import GridWorldSettings
from pipeline.studies.grid_world.trials import (
    SAMPLING_MODELS,
    THETAS,
    GridWorld,
    draw_demonstrations,
    posteriors,
)
from pipeline.vocabulary import BOLTZMANN, LESS

BINS = 40


@dataclass(frozen=True, eq=False)
class GridWorldExamples:
    """Tables behind the figures of section 4.2. Features are in units of their range over all paths.

    Attributes:
        paths: one row per demonstration of the two sets: `set` (`Xi_L`, `Xi_B`), `sampling_model`, `theta_id`, `seed`,
            `demonstration`, `path` (row of the choice set), `x`, `y` (cells, one array per path), `phi_1`, `phi_2`
            and `log_density` (log kernel sum of LESS).
        posteriors: `set`, `inference_model`, `theta_id`, `theta_1`, `theta_2`, `posterior`, `is_true`.
        density_1d: one row per feature and bin: `feature` (1, 2), `low`, `high`, `raw` (density of all paths) and
            `adjusted` (each path weighted by one over its kernel sum, as LESS does).
        density_2d: one row per pair of bins: `phi_1_low`, `phi_1_high`, `phi_2_low`, `phi_2_high`, `raw`, `adjusted`.
    """

    paths: pl.DataFrame
    posteriors: pl.DataFrame
    density_1d: pl.DataFrame
    density_2d: pl.DataFrame


def examples(
    world: GridWorld, settings: GridWorldSettings, random_seed: int, trials: pl.DataFrame
) -> GridWorldExamples:
    """The sets with the largest lead of LESS (Xi_L) and of Boltzmann (Xi_B) in TruePosterior; the first one if tied."""
    leads = (
        trials.filter(pl.col("sampling_model").is_in(SAMPLING_MODELS))
        .pivot("inference_model", index=["sampling_model", "theta_id", "seed"], values="true_posterior")
        .with_columns(lead=pl.col(LESS) - pl.col(BOLTZMANN))
    )
    chosen = {"Xi_L": leads.row(leads["lead"].arg_max() or 0, named=True)}
    chosen["Xi_B"] = leads.row(leads["lead"].arg_min() or 0, named=True)
    path_tables, posterior_tables = [], []
    for name, trial in chosen.items():
        drawn = draw_demonstrations(world.log_probabilities[trial["sampling_model"]], settings, random_seed)
        rows = drawn[trial["theta_id"], trial["seed"]]
        path_tables.append(_paths(world, rows).select(*_set_columns(name, trial), pl.all()))
        for model in SAMPLING_MODELS:
            posterior_tables.append(
                pl.DataFrame(
                    {
                        "theta_id": np.arange(len(THETAS)),
                        "theta_1": THETAS[:, 0],
                        "theta_2": THETAS[:, 1],
                        "posterior": posteriors(world.log_probabilities[model], rows),
                        "is_true": np.arange(len(THETAS)) == trial["theta_id"],
                    }
                ).select(pl.lit(name).alias("set"), pl.lit(model).alias("inference_model"), pl.all())
            )
    weights = {"raw": np.ones(len(world.paths)), "adjusted": np.exp(-world.log_density)}
    return GridWorldExamples(
        pl.concat(path_tables),
        pl.concat(posterior_tables),
        pl.concat([_density_1d(world.features[:, f], f + 1, weights) for f in range(2)]),
        _density_2d(world.features, weights),
    )


def _set_columns(name: str, trial: dict[str, object]) -> list[pl.Expr]:
    return [
        pl.lit(name).alias("set"),
        pl.lit(trial["sampling_model"]).alias("sampling_model"),
        *(pl.lit(trial[key], dtype=pl.Int64).alias(key) for key in ("theta_id", "seed")),
    ]


def _paths(world: GridWorld, rows: IndexArray) -> pl.DataFrame:
    steps = pl.Array(pl.Int64, world.paths.shape[1])
    return pl.DataFrame(
        {
            "demonstration": np.arange(len(rows)),
            "path": rows,
            "x": pl.Series(world.paths[rows, :, 0], dtype=steps),
            "y": pl.Series(world.paths[rows, :, 1], dtype=steps),
            "phi_1": world.features[rows, 0],
            "phi_2": world.features[rows, 1],
            "log_density": world.log_density[rows],
        }
    )


def _density_1d(values: FloatArray, feature: int, weights: dict[str, FloatArray]) -> pl.DataFrame:
    edges = np.linspace(values.min(), values.max(), BINS + 1)
    densities = {
        name: np.histogram(values, bins=edges, weights=weight, density=True)[0] for name, weight in weights.items()
    }
    columns = {"feature": np.full(BINS, feature), "low": edges[:-1], "high": edges[1:]}
    return pl.DataFrame(columns | densities)


def _density_2d(features: FloatArray, weights: dict[str, FloatArray]) -> pl.DataFrame:
    edges = [np.linspace(phi.min(), phi.max(), BINS + 1) for phi in features.T]
    densities = {
        name: np.histogramdd(features, bins=edges, weights=weight, density=True)[0].ravel()
        for name, weight in weights.items()
    }
    first, second = (index.ravel() for index in np.indices((BINS, BINS)))
    columns = {
        "phi_1_low": edges[0][first],
        "phi_1_high": edges[0][first + 1],
        "phi_2_low": edges[1][second],
        "phi_2_high": edges[1][second + 1],
    }
    return pl.DataFrame(columns | densities)
