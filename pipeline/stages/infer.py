"""Stage: the posterior over theta and beta under every model, for every set, each demonstration and all together.

The same log likelihoods score how well each model predicts a demonstration from the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl

from pipeline.choice import LESS, AttributeRule, Boltzmann, held_out_from, log_likelihood, posterior_from, theta_grid
from pipeline.choice.models import Model
from pipeline.errors import StageError
from pipeline.params import Infer, Task
from pipeline.stages.progress import tracked
from pipeline.stages.project import Project, recorded_run
from pipeline.stages.provenance import provenance
from pipeline.stores.tables import read_table, write_table

Group = tuple[str, str, list[int]]  # demonstration_id, participant, rows of the demonstrations


def run(project: Project, name: str) -> None:
    """Write posteriors.parquet and held_out.parquet of the task `name`."""
    task, settings = project.params.task(name), project.params.infer
    with recorded_run(project, "infer", name) as record:
        sources = [project.table(name, table) for table in ("demonstrations", "features", "scales", "densities")]
        people = read_table(sources[0], "demonstrations", ["demonstration_id", "participant"])
        features = _scaled(read_table(sources[1], "features"), read_table(sources[2], "scales"))
        bandwidths = read_table(sources[3], "densities").unique(["anchor", "set_size", "set_id"], maintain_order=True)
        thetas, betas = hypotheses(task, settings), np.array(settings.betas)
        demonstrations = people.join(
            features.filter(kind="demonstration"), left_on="demonstration_id", right_on="id", maintain_order="left"
        )
        groups = _groups(people)
        sets = bandwidths.partition_by("set_size", "set_id", maintain_order=True)
        posteriors, held_out = [], []
        for anchored in tracked(sets, f"infer {name}"):
            for label in settings.models:
                values = _log_likelihoods(label, anchored, demonstrations, features, thetas, betas)
                set_size, set_id = anchored.row(0, named=True)["set_size"], anchored.row(0, named=True)["set_id"]
                question = {"task": name, "model": label, "set_size": set_size, "set_id": set_id}
                columns = [pl.lit(value).alias(column) for column, value in question.items()]
                posteriors.append(_posteriors(groups, values, thetas, betas).with_columns(columns))
                held_out.append(_held_out(people, values).with_columns(columns))
        stated = provenance(project, depends_on(project, name), sources)
        write_table(project.table(name, "posteriors"), "posteriors", pl.concat(posteriors), stated)
        write_table(project.table(name, "held_out"), "held_out", pl.concat(held_out), stated)
        count = len(posteriors) * len(groups)
        record.produced = f"{count:,} posteriors over {len(thetas)} thetas x {len(betas)} betas"


def depends_on(project: Project, name: str) -> list[object]:
    """The parameters that the tables depend on."""
    return [project.params.task(name).thetas, project.params.infer]


def hypotheses(task: Task, settings: Infer) -> np.ndarray:
    """The weight vectors (K, F) on scaled features: those the task lists, or the grid of cost directions."""
    if task.thetas != "grid":
        return np.array(task.thetas, dtype=np.float64)
    return theta_grid([settings.theta_values] * len(task.features))


def choice_model(label: str, bandwidth: float) -> Model:
    """The model that params.yaml calls `label`; `bandwidth` is that of the set, in scaled features."""
    models: dict[str, Model] = {
        "boltzmann": Boltzmann(), "less": LESS(bandwidth=bandwidth), "attribute-rule": AttributeRule(),
    }  # fmt: skip
    return models[label]


def _scaled(features: pl.DataFrame, scales: pl.DataFrame) -> pl.DataFrame:
    names = scales["feature"].to_list()
    absent = [name for name in names if name not in features.columns]
    if absent:
        raise StageError(f"features.parquet lacks the feature {absent[0]!r} that scales.parquet has; run `dvc repro`")
    phi = features.select(names).to_numpy() / scales["scale"].to_numpy()
    return features.drop(names).with_columns(phi=pl.Series(phi, dtype=pl.Array(pl.Float64, len(names))))


def _groups(people: pl.DataFrame) -> list[Group]:
    """Each demonstration, each participant with several, and all together."""
    rows: dict[str, list[int]] = {}
    singles: list[Group] = []
    for row, (demonstration_id, participant) in enumerate(people.iter_rows()):
        singles.append((demonstration_id, participant, [row]))
        rows.setdefault(participant, []).append(row)
    several = [("all", participant, of) for participant, of in rows.items() if 1 < len(of) < len(singles)]
    return [*singles, *several, ("all", "all", list(range(len(singles))))]


def _log_likelihoods(
    label: str, anchored: pl.DataFrame, demonstrations: pl.DataFrame, features: pl.DataFrame,
    thetas: np.ndarray, betas: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(n, K, B): each demonstration against the alternatives that share its anchor."""
    values = np.full((demonstrations.height, len(thetas), len(betas)), np.nan)
    ids = demonstrations["demonstration_id"].to_numpy()
    phi = demonstrations["phi"].to_numpy()
    for row in anchored.iter_rows(named=True):
        mine = ids == row["anchor"] if row["anchor"] != "task" else np.ones(len(ids), dtype=bool)
        same = (pl.col("anchor") == row["anchor"]) & (pl.col("set_size") == row["set_size"])
        alternatives = features.filter(same & (pl.col("set_id") == row["set_id"]))["phi"].to_numpy()
        values[mine] = log_likelihood(choice_model(label, row["bandwidth"]), phi[mine], alternatives, thetas, betas)
    if np.isnan(values).any():
        missing = ids[np.isnan(values).any(axis=(1, 2))][0]
        raise StageError(f"demonstration {missing!r} has no alternatives with its anchor; run `dvc repro`")
    return values


def _posteriors(groups: Sequence[Group], values: np.ndarray, thetas: np.ndarray, betas: np.ndarray) -> pl.DataFrame:
    log_posterior = np.stack(
        [posterior_from(values[of].sum(axis=0), thetas, betas).log_probability for _, _, of in groups]
    )
    n, k, b = log_posterior.shape
    return pl.DataFrame(
        {
            "demonstration_id": np.repeat([group[0] for group in groups], k * b),
            "participant": np.repeat([group[1] for group in groups], k * b),
            "theta_id": np.tile(np.repeat(np.arange(k), b), n),
            "theta": np.tile(np.repeat(thetas, b, axis=0), (n, 1)),
            "beta": np.tile(betas, n * k),
            "log_posterior": log_posterior.ravel(),
            "posterior": np.exp(log_posterior).ravel(),
        }
    )


def _held_out(people: pl.DataFrame, values: np.ndarray) -> pl.DataFrame:
    """One row per demonstration; none of fewer than two, as there are no others to predict it from."""
    if people.height < 2:
        return people.clear().with_columns(log_predictive=pl.lit(None, pl.Float64))
    return people.with_columns(log_predictive=pl.Series(held_out_from(values).log_predictive))
