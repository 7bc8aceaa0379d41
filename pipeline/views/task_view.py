"""What both the recording and the figures of a task show, from its tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import Posterior, posterior_from
from pipeline.choice.logspace import log_sum_exp
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import read_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.views.feature_axis import FeatureAxis, feature_axis
from pipeline.views.task_summary import (
    DensityCurve,
    DensityMap,
    density_curve,
    density_map,
    theta_labels,
    theta_meaning,
)
from pipeline.views.truth import Truth, known_truth
from pipeline.vocabulary import POOLED, WORKING, model_name

ALTERNATIVE = ["alternative_id", "anchor", "sampler", "set_size", "set_id"]


@dataclass(frozen=True, eq=False)
class TaskView:
    """One task and its working set of alternatives.

    Attributes:
        demonstrations: the table `demonstrations`.
        alternatives: rows of the table `alternatives` for the working set, without waypoints. If there are several
            anchors, they are those of the first.
        phi: (N, F) raw feature values of these alternatives.
        demonstration_phi: (n, F) raw feature values of each demonstration.
        features: (F,) names of the features.
        axes: (F,) how they stand on an axis.
        scale: (F,) what raw values are divided by.
        by_weight: (F,) indices of the features, by descending mean weight under the final posterior.
        log_weights: (N,) log weight of each alternative under LESS.
        independent: rows of the table `alternatives` for the other sets with the same anchor, with the `log_weight` of
            each alternative in its set.
        bandwidth: sigma of LESS on the working set, in scaled features.
        curves: density along each feature, in the order of `by_weight`.
        map: density over the first two of them.
        labels: (K,) the hypotheses in words.
        meaning: what the numbers in the labels mean.
        beliefs: for each model, the posterior before any demonstration and after each.
        resting_on: for each model, what these rest on, `explored choice space` or the sampled `set of 1,000`.
        explorations: for each explored model, (R, K) the posterior over theta of the first demonstration, by run.
        fits: the table `fits`.
        truth: what people truly want; None if that is not known.
    """

    demonstrations: pl.DataFrame
    alternatives: pl.DataFrame
    phi: FloatArray
    demonstration_phi: FloatArray
    features: tuple[str, ...]
    axes: tuple[FeatureAxis, ...]
    scale: FloatArray
    by_weight: tuple[int, ...]
    log_weights: FloatArray
    independent: pl.DataFrame
    bandwidth: float
    curves: tuple[DensityCurve, ...]
    map: DensityMap
    labels: tuple[str, ...]
    meaning: str
    beliefs: dict[str, list[Posterior]]
    resting_on: tuple[str, ...]
    explorations: dict[str, FloatArray]
    fits: pl.DataFrame
    truth: Truth | None

    def shown(self, raw: FloatArray) -> FloatArray:
        """Raw feature values (n, F) as they stand on the axes."""
        return np.stack([axis.shown(raw[:, f]) for f, axis in enumerate(self.axes)], axis=1)

    @property
    def nearest_truth(self) -> int | None:
        """The hypothesis nearest to the truth; None if that is not known."""
        return None if self.truth is None else self.truth.nearest

    @property
    def over(self) -> str:
        """What the beliefs are over, in words."""
        return over_what(tuple(self.beliefs), self.resting_on)


INPUTS = ("demonstrations", "alternatives", "features", "densities", "scales", "posteriors", "fits")
EXPLORED = "explored choice space"


def task_view(tables: TaskTables, explored: Path) -> TaskView:
    """Read and check the tables INPUTS of a task.

    Args:
        tables: these.
        explored: the table `explored_posteriors`, which need not be there.

    Raises:
        TableError: a table is missing or fails its checks.
    """
    tables.check()
    demonstrations = tables["demonstrations"].read()
    ids = tuple(demonstrations["demonstration_id"])
    sampled = _beliefs(tables["posteriors"], ids)
    runs = {model: found for model, found in explored_runs(explored, ids).items() if model in sampled}
    beliefs = _with_explored(sampled, runs)
    final = list(beliefs.values())[-1][-1]
    order = _by_weight(final)
    space = _feature_space(tables, demonstrations)
    return TaskView(
        demonstrations=demonstrations,
        alternatives=space.alternatives,
        phi=space.phi,
        demonstration_phi=space.demonstration_phi,
        features=space.names,
        axes=space.axes,
        scale=space.scale,
        by_weight=tuple(order),
        log_weights=space.log_weights,
        independent=space.independent,
        bandwidth=space.bandwidth,
        curves=tuple(space.curve(f) for f in order),
        map=space.map(order[0], order[min(1, len(order) - 1)]),
        labels=theta_labels(final.thetas, space.names),
        meaning=theta_meaning(final.thetas),
        beliefs=beliefs,
        resting_on=tuple(
            f"set of {space.alternatives.height:,}" if beliefs[model] is sampled[model] else EXPLORED
            for model in beliefs
        ),
        explorations={model: np.stack([run[1].marginal_theta for run in found]) for model, found in runs.items()},
        fits=tables["fits"].read(),
        truth=known_truth(demonstrations["true_theta"], space.names, space.scale, final.thetas),
    )


@dataclass(frozen=True, eq=False)
class _FeatureSpace:
    """The fields of a TaskView that concern features; `scale` (F,) is what each feature is divided by."""

    alternatives: pl.DataFrame
    independent: pl.DataFrame
    names: tuple[str, ...]
    axes: tuple[FeatureAxis, ...]
    scale: FloatArray
    phi: FloatArray
    demonstration_phi: FloatArray
    log_weights: FloatArray
    bandwidth: float

    def curve(self, f: int) -> DensityCurve:
        """The density along one feature."""
        axis = self.axes[f]
        return density_curve(
            axis.feature,
            axis.unit,
            axis.shown(self.phi[:, f]),
            axis.shown(self.demonstration_phi[:, f]),
            float(axis.shown(self.bandwidth * self.scale[f])),
            self.log_weights,
            over_time=axis.said,
        )

    def map(self, first: int, second: int) -> DensityMap:
        """The density over two features."""
        pair = [first, second]
        return map_on_axes(
            (self.axes[first], self.axes[second]),
            self.phi[:, pair],
            self.demonstration_phi[:, pair],
            self.bandwidth * self.scale[pair],
            self.log_weights,
        )


def _feature_space(tables: TaskTables, demonstrations: pl.DataFrame) -> _FeatureSpace:
    alternatives, independent = _with_first_anchor(tables["alternatives"].read(ALTERNATIVE))
    densities = tables["densities"].read(["alternative_id", "bandwidth", "log_density"])
    weighed = densities.select("alternative_id", "bandwidth", log_weight=-pl.col("log_density"))
    working = alternatives.select("alternative_id").join(weighed, on="alternative_id", maintain_order="left")
    scales = tables["scales"].read()
    names = scales["feature"].to_list()
    features = tables["features"].read(["id", *names])
    return _FeatureSpace(
        alternatives=alternatives,
        independent=independent.join(weighed.drop("bandwidth"), on="alternative_id", maintain_order="left"),
        names=tuple(names),
        axes=axes_of(scales, demonstrations["waypoints"].to_numpy().shape[1]),
        scale=scales["scale"].to_numpy(),
        phi=_features_of(alternatives["alternative_id"], features, names),
        demonstration_phi=_features_of(demonstrations["demonstration_id"], features, names),
        log_weights=working["log_weight"].to_numpy(),
        bandwidth=float(working["bandwidth"][0]),
    )


def map_on_axes(
    axes: tuple[FeatureAxis, FeatureAxis],
    alternatives: FloatArray,
    demonstrations: FloatArray,
    bandwidths: FloatArray,
    less_log_weights: FloatArray | None = None,
) -> DensityMap:
    """The density over two features, as they stand on their axes; other arguments raw, as in `density_map`."""
    per = np.array([axis.per for axis in axes])
    return density_map(
        (axes[0].feature, axes[1].feature),
        (axes[0].unit, axes[1].unit),
        alternatives / per,
        demonstrations / per,
        bandwidths / per,
        over_time=(axes[0].said, axes[1].said),
        less_log_weights=less_log_weights,
    )


def axes_of(scales: pl.DataFrame, waypoints: int) -> tuple[FeatureAxis, ...]:
    """How the features of the table `scales` stand on an axis, of trajectories of so many waypoints."""
    rows = scales.select("feature", "unit", "over_time").iter_rows()
    return tuple(feature_axis(feature, unit, over_time, waypoints) for feature, unit, over_time in rows)


def _beliefs(posteriors: OpenTable, demonstration_ids: tuple[str, ...]) -> dict[str, list[Posterior]]:
    rows = posteriors.read(where=pl.col("set_id") == WORKING)
    return {
        model: _sequence(rows.filter(model=model), demonstration_ids)
        for model in rows["model"].unique(maintain_order=True)
    }


def _with_explored(
    sampled: dict[str, list[Posterior]], runs: dict[str, list[list[Posterior]]]
) -> dict[str, list[Posterior]]:
    return sampled | {
        model: [mean_posterior(steps) for steps in zip(*found, strict=True)] for model, found in runs.items()
    }


def shown_beliefs(
    posteriors: OpenTable, explored: Path, demonstration_ids: tuple[str, ...]
) -> dict[str, list[Posterior]]:
    """For each model, the posterior that is shown, before any demonstration and after each.

    Args:
        posteriors: the table of that name.
        explored: the table `explored_posteriors`, which need not be there.
        demonstration_ids: in the order in which they are taken in.
    """
    sampled = _beliefs(posteriors, demonstration_ids)
    runs = {model: found for model, found in explored_runs(explored, demonstration_ids).items() if model in sampled}
    return _with_explored(sampled, runs)


def explored_runs(path: Path, demonstration_ids: tuple[str, ...]) -> dict[str, list[list[Posterior]]]:
    """For each model and exploration of the choice space, the posterior before any demonstration and after each.

    Nothing if the table is not there or has other demonstrations.
    """
    if not path.exists():
        return {}
    rows = read_table(path, "explored_posteriors").filter(pl.col("exploration") != POOLED)
    if not set(demonstration_ids) <= set(rows["demonstration_id"]):
        return {}
    return {
        str(model): [
            _sequence(part, demonstration_ids) for part in of_model.partition_by("exploration", maintain_order=True)
        ]
        for (model,), of_model in rows.group_by("model", maintain_order=True)
    }


def over_what(models: Sequence[str], resting_on: Sequence[str]) -> str:
    """What the posteriors of some models are over, in words."""
    if len(set(resting_on)) == 1:
        return f"over the {resting_on[0]}"
    return ", ".join(f"{model_name(model)} over the {one}" for model, one in zip(models, resting_on, strict=True))


def mean_posterior(posteriors: Sequence[Posterior]) -> Posterior:
    """The mean of several over the same hypotheses."""
    log_p = np.stack([one.log_probability for one in posteriors])
    mean = np.asarray(log_sum_exp(log_p, axis=0) - np.log(len(log_p)))
    return Posterior(posteriors[0].thetas, posteriors[0].betas, mean)


def read_waypoints(alternatives: OpenTable, ids: pl.Series) -> FloatArray:
    """(A, T, J) waypoints of the alternatives with these ids, in their order."""
    waypoints = alternatives.read(["alternative_id", "waypoints"], where=pl.col("alternative_id").is_in(ids.implode()))
    rows = ids.to_frame("alternative_id").join(waypoints, on="alternative_id", how="left", maintain_order="left")
    return rows["waypoints"].to_numpy().astype(np.float64)


def _with_first_anchor(alternatives: pl.DataFrame) -> tuple[pl.DataFrame, pl.DataFrame]:
    """The rows of the working set and those of the other sets; if there are several anchors, those of the first."""
    working = pl.col("set_id") == WORKING
    of_anchor = alternatives.filter(anchor=alternatives.filter(working)["anchor"][0])
    return of_anchor.filter(working), of_anchor.filter(~working)


def _features_of(ids: pl.Series, features: pl.DataFrame, names: list[str]) -> FloatArray:
    """(n, F) raw feature values, in the order of the ids."""
    return ids.to_frame("id").join(features, on="id", maintain_order="left").select(names).to_numpy()


def _by_weight(belief: Posterior) -> list[int]:
    """(F,) indices of the features, by descending mean weight under the posterior."""
    return [int(f) for f in np.argsort(-belief.marginal_theta @ np.abs(belief.thetas), kind="stable")]


def _sequence(rows: pl.DataFrame, demonstration_ids: tuple[str, ...]) -> list[Posterior]:
    """The posterior before any demonstration and after each.

    The prior is uniform, so the posterior of a single demonstration is its likelihood up to a constant, and the
    posterior of several is the product of these.
    """
    rows = rows.sort("theta_id", "beta")
    first = rows.filter(demonstration_id=demonstration_ids[0])
    betas = first["beta"].unique().sort().to_numpy()
    thetas = first.unique("theta_id", maintain_order=True)["theta"].to_numpy()
    single = np.stack(
        [
            rows.filter(demonstration_id=key)["log_posterior"].to_numpy().reshape(len(thetas), len(betas))
            for key in demonstration_ids
        ]
    )
    return [posterior_from(single[:count], thetas, betas) for count in range(len(single) + 1)]
