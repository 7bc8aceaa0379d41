"""What the recording and the figures of a task both show, made from its tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import Posterior, posterior_from
from pipeline.formats.parquet.foreign_keys import check_references
from pipeline.formats.parquet.tables import part_rows, read_part, read_table
from pipeline.views.task_summary import (
    DensityCurve,
    DensityMap,
    density_curve,
    density_map,
    theta_labels,
    theta_meaning,
)
from pipeline.vocabulary import WORKING
from pipeline.workspace.project import Project

ALTERNATIVE = ["alternative_id", "anchor", "sampler", "set_size", "set_id"]


@dataclass(frozen=True, eq=False)
class TaskView:
    """One task on its working set.

    Attributes:
        demonstrations: the table.
        alternatives: the table's rows of the working set without their waypoints; of several anchors, the first one's.
        phi: (N, F) raw feature values of each of these.
        demonstration_phi: (n, F) raw feature values of each demonstration.
        features: names of the features.
        units: theirs.
        by_weight: feature indices, those first that the belief gives the largest weights.
        log_weights: (N,) LESS's log weight of each alternative.
        independent: the table's rows of the other sets with the same anchor, with `log_weight` in their own set.
        bandwidth: of LESS on this set, in scaled features.
        curves: density along each feature, those first that the belief gives the largest weights.
        map: density over the first two of them.
        labels: (K,) the hypotheses in words.
        meaning: what the numbers in the labels are.
        beliefs: by model, the belief before any demonstration and after each.
    """

    demonstrations: pl.DataFrame
    alternatives: pl.DataFrame
    phi: FloatArray
    demonstration_phi: FloatArray
    features: tuple[str, ...]
    units: tuple[str, ...]
    by_weight: tuple[int, ...]
    log_weights: FloatArray
    independent: pl.DataFrame
    bandwidth: float
    curves: tuple[DensityCurve, ...]
    map: DensityMap
    labels: tuple[str, ...]
    meaning: str
    beliefs: dict[str, list[Posterior]]


INPUTS = ("demonstrations", "alternatives", "features", "densities", "scales", "posteriors")


def task_view(project: Project, name: str) -> TaskView:
    """Read the tables of the task `name`.

    Raises:
        TableError: a table is missing or not what it should be.
    """
    check_references({table: project.table(name, table) for table in INPUTS})
    demonstrations = read_table(project.table(name, "demonstrations"), "demonstrations")
    alternatives, independent = _anchored_alike(
        read_columns(project.table(name, "alternatives"), "alternatives", ALTERNATIVE)
    )
    features = read_table(project.table(name, "features"), "features")
    all_densities = read_columns(
        project.table(name, "densities"), "densities", ["alternative_id", "bandwidth", "log_density"]
    )
    densities = alternatives.select("alternative_id").join(all_densities, on="alternative_id", maintain_order="left")
    weighed = all_densities.select("alternative_id", log_weight=-pl.col("log_density"))
    scales = read_table(project.table(name, "scales"), "scales")
    posteriors = read_table(project.table(name, "posteriors"), "posteriors").filter(set_id=WORKING)
    names, units = scales["feature"].to_list(), scales["unit"].to_list()
    phi = _features_of(alternatives["alternative_id"], features, names)
    demos = _features_of(demonstrations["demonstration_id"], features, names)
    sigma = densities["bandwidth"][0] * scales["scale"].to_numpy()
    log_weights = -densities["log_density"].to_numpy()
    ids = tuple(demonstrations["demonstration_id"])
    beliefs = {
        model: _sequence(posteriors.filter(model=model), ids)
        for model in posteriors["model"].unique(maintain_order=True)
    }
    final = list(beliefs.values())[-1][-1]
    order = _by_weight(final)
    pair = [order[0], order[min(1, len(order) - 1)]]
    return TaskView(
        demonstrations=demonstrations,
        alternatives=alternatives,
        phi=phi,
        demonstration_phi=demos,
        features=tuple(names),
        units=tuple(units),
        by_weight=tuple(order),
        log_weights=log_weights,
        independent=independent.join(weighed, on="alternative_id", maintain_order="left"),
        bandwidth=float(densities["bandwidth"][0]),
        curves=tuple(density_curve(names[f], units[f], phi[:, f], demos[:, f], sigma[f], log_weights) for f in order),
        map=density_map(
            (names[pair[0]], names[pair[1]]),
            (units[pair[0]], units[pair[1]]),
            phi[:, pair],
            demos[:, pair],
            sigma[pair],
        ),
        labels=theta_labels(final.thetas, names),
        meaning=theta_meaning(final.thetas),
        beliefs=beliefs,
    )


def read_columns(path: Path, name: str, columns: Sequence[str]) -> pl.DataFrame:
    """Some columns of a table that may be larger than memory as a whole."""
    return pl.concat([read_part(path, name, number, columns) for number in range(len(part_rows(path, name)))])


def read_waypoints(path: Path, ids: pl.Series) -> FloatArray:
    """(A, T, J) waypoints of some of the alternatives of a table, which is read part by part."""
    columns = ["alternative_id", "waypoints"]
    found = pl.concat(
        [
            read_part(path, "alternatives", number, columns).filter(pl.col("alternative_id").is_in(ids.implode()))
            for number in range(len(part_rows(path, "alternatives")))
        ]
    )
    rows = ids.to_frame("alternative_id").join(found, on="alternative_id", how="left", maintain_order="left")
    return rows["waypoints"].to_numpy().astype(np.float64)


def _anchored_alike(alternatives: pl.DataFrame) -> tuple[pl.DataFrame, pl.DataFrame]:
    """The working set and the others; where demonstrations have sets of their own, those of the first."""
    working = pl.col("set_id") == WORKING
    mine = alternatives.filter(anchor=alternatives.filter(working)["anchor"][0])
    return mine.filter(working), mine.filter(~working)


def _features_of(ids: pl.Series, features: pl.DataFrame, names: list[str]) -> FloatArray:
    """(n, F) raw values, in the order of the ids."""
    return ids.to_frame("id").join(features, on="id", maintain_order="left").select(names).to_numpy()


def _by_weight(belief: Posterior) -> list[int]:
    """Feature indices, those first that the belief gives the largest weights."""
    return [int(f) for f in np.argsort(-belief.marginal_theta @ np.abs(belief.thetas), kind="stable")]


def _sequence(rows: pl.DataFrame, demonstration_ids: tuple[str, ...]) -> list[Posterior]:
    """The belief before any demonstration and after each.

    The prior over the hypotheses is uniform, so the posteriors of single demonstrations are their likelihoods up to a
    constant, and multiply.
    """
    rows = rows.sort("theta_id", "beta")
    one = rows.filter(demonstration_id=demonstration_ids[0])
    betas = one["beta"].unique().sort().to_numpy()
    thetas = one.unique("theta_id", maintain_order=True)["theta"].to_numpy()
    single = np.stack(
        [
            rows.filter(demonstration_id=key)["log_posterior"].to_numpy().reshape(len(thetas), len(betas))
            for key in demonstration_ids
        ]
    )
    return [posterior_from(single[:count], thetas, betas) for count in range(len(single) + 1)]
