"""A seeded sample of what a task's tables hold, computed again from the tables that it was made from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import log_density, log_likelihood, posterior_from
from pipeline.choice.models import choice_model
from pipeline.errors import StageError
from pipeline.formats.parquet.checked.open_table import OpenTable, Piece
from pipeline.formats.parquet.partitions import runs
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.replay.features import bind_features
from pipeline.vocabulary import ALL, TASK_ANCHOR
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene
from pipeline.workspace.trust import register_task_kinds

TOLERANCE = 1e-9  # of a replayed value, relative to the largest of its kind: other processors round otherwise
DENSITY_TOLERANCE = 1e-6  # of a log density: large sets are summed to a stated error
QUESTION, SET = ("model", "demonstration_id", "participant"), ("set_size", "set_id")  # what a posterior is of
Question = tuple[str, str, str]
SetName = tuple[int, str]
HYPOTHESES = ("theta_id", "theta", "beta", "log_posterior", "posterior")
REPLAYED = 20_000  # alternatives in a set, at most, for it to be in the sample


@dataclass(frozen=True)
class Recomputation:
    """What is computed again.

    Attributes:
        project: whose tables.
        tables: those of a task.
        drift: a sentence for every value that is another one now; more are added.
    """

    project: Project
    tables: TaskTables
    drift: list[str]

    def shown(self, table: str) -> str:
        """The file of a table, as it is named to people."""
        return self.project.shown(self.tables[table].path)


def replay_trajectories(task: Recomputation, name: str, sample: int, rng: np.random.Generator) -> int:
    """Compute the features of some demonstrations and alternatives from their waypoints; how many there were.

    Raises:
        WorkbenchError: a table cannot be read, or does not fit the others.
    """
    settings, tables, count = task.project.params.task(name), task.tables, 0
    register_task_kinds(task.project, settings)
    features = bind_features(load_task_scene(task.project, settings), settings.features)
    path = task.shown("features")
    for kind, source in (("demonstration", tables["demonstrations"]), ("alternative", tables["alternatives"])):
        rows = np.sort(rng.choice(source.rows, min(sample, source.rows), replace=False))
        trajectories = source.at(rows.tolist(), [f"{kind}_id", "waypoints"])
        ids = trajectories[f"{kind}_id"]
        stored = tables["features"].read(where=(pl.col("kind") == kind) & pl.col("id").is_in(ids.implode()))
        joined = pl.DataFrame({"id": ids}).join(stored, on="id", how="left", maintain_order="left")
        if joined["kind"].null_count():
            missing = joined.filter(pl.col("kind").is_null())["id"][0]
            task.drift.append(f"{path}: has no row of the {kind} {missing}")
            continue
        absent = [feature for feature in features.names if feature not in stored.columns]
        if absent:
            task.drift.append(f"{path}: lacks the feature {absent[0]}")
            return count
        values = features.evaluate(trajectories["waypoints"].to_numpy().astype(np.float64))
        count += len(values)
        for f, feature in enumerate(features.names):
            for row in _different(joined[feature].to_numpy(), values[:, f], TOLERANCE):
                task.drift.append(
                    f"{path}: {feature} of the {kind} {ids[row]} is {joined[feature][row]!r}, and "
                    f"{float(values[row, f])!r} when its waypoints are replayed"
                )
    return count


def infer_posteriors(task: Recomputation, sample: int, rng: np.random.Generator) -> int:
    """Compute some posteriors, and the densities of their sets, from the features; how many there were.

    Raises:
        WorkbenchError: a table cannot be read, or does not fit the others.
    """
    tables, count = task.tables, 0
    people = tables["demonstrations"].read(["demonstration_id", "participant"])
    anchors = _anchors(tables["densities"])
    if not anchors:
        return count
    where = _places(tables["posteriors"], (*QUESTION, *SET))
    questions = sorted({key[: len(QUESTION)] for key in where})
    for _ in range(sample):
        which = list(anchors)[int(rng.integers(len(anchors)))]
        question = questions[int(rng.integers(len(questions)))]
        said = f"{task.shown('posteriors')}: the posterior of {', '.join(map(str, question + which))}"
        if question + which not in where:
            task.drift.append(f"{said} is missing")
            continue
        rows = pl.concat(tables["posteriors"].pieces(where[question + which], HYPOTHESES)).sort("theta_id", "beta")
        log_posterior = _log_posterior(task, people, question, which, anchors[which], rows)
        count += 1
        for column, values in (("log_posterior", log_posterior), ("posterior", np.exp(log_posterior))):
            for row in _different(rows[column].to_numpy(), values, TOLERANCE)[:1]:
                task.drift.append(
                    f"{said}: {column} of theta {rows['theta_id'][row]}, beta {rows['beta'][row]:g} is "
                    f"{rows[column][row]!r}, and {float(values[row])!r} when computed again"
                )
    return count


def _log_posterior(
    task: Recomputation,
    people: pl.DataFrame,
    question: Question,
    which: SetName,
    anchors: list[str],
    rows: pl.DataFrame,
) -> FloatArray:
    """(K B,) log posterior over the hypotheses of the stored rows, which are in order."""
    model, *asked = question
    thetas = np.array(rows.unique("theta_id", maintain_order=True)["theta"].to_list())
    betas = np.sort(rows["beta"].unique().to_numpy())
    total = np.zeros((len(thetas), len(betas)))
    for alternatives, kernel, of in _choice_sets(task, which, anchors, _of(people, *asked)):
        total += log_likelihood(choice_model(model, kernel), of, alternatives, thetas, betas).sum(axis=0)
    return posterior_from(total, thetas, betas).log_probability.ravel()


def _places(table: OpenTable, columns: Sequence[str]) -> dict[tuple[Any, ...], list[Piece]]:
    """Where the rows are that have the same values in some columns, which follow each other."""
    places: dict[tuple[Any, ...], list[Piece]] = {}
    for number, _ in enumerate(table.parts):
        for values, piece in runs(number, table.part(number, columns), columns):
            places.setdefault(values, []).append(piece)
    return places


def _anchors(densities: OpenTable) -> dict[SetName, list[str]]:
    """By size and number, the anchors of the sets that are small enough to be computed again."""
    anchors: dict[SetName, list[str]] = {}
    for size, set_id, anchor in _places(densities, (*SET, "anchor")):
        if size <= REPLAYED:
            anchors.setdefault((size, set_id), []).append(anchor)
    return anchors


def _choice_sets(
    task: Recomputation, which: SetName, anchors: list[str], chosen: list[str]
) -> Iterator[tuple[FloatArray, float, FloatArray]]:
    """Per anchor that some of the chosen demonstrations have: alternatives (N, F), bandwidth, demonstrations (n, F)."""
    features, densities, scales = task.tables["features"], task.tables["densities"], task.tables["scales"].read()
    names, scale = scales["feature"].to_list(), scales["scale"].to_numpy()
    size, set_id = which
    for anchor in anchors:
        mine = chosen if anchor == TASK_ANCHOR else [one for one in chosen if one == anchor]
        if not mine:
            continue
        demonstrations = features.read(where=(pl.col("kind") == "demonstration") & pl.col("id").is_in(mine))
        if demonstrations.height < len(mine):
            raise StageError(f"{task.shown('features')}: has no row of a demonstration")
        here = (pl.col("anchor") == anchor) & (pl.col("set_size") == size) & (pl.col("set_id") == set_id)
        phi = features.read(["id", *names], where=here)
        if phi.is_empty():
            raise StageError(f"{task.shown('features')}: has no rows of the set {set_id!r} of {size:,}")
        density = densities.read(where=here)
        joined = phi.join(density, left_on="id", right_on="alternative_id", how="left", maintain_order="left")
        bandwidth = float(density["bandwidth"][0])
        alternatives = joined.select(names).to_numpy() / scale
        log_sums = log_density(alternatives, bandwidth)
        for row in _different(joined["log_density"].to_numpy(), log_sums, DENSITY_TOLERANCE)[:1]:
            task.drift.append(
                f"{task.shown('densities')}: log_density of {joined['id'][row]} is "
                f"{joined['log_density'][row]!r}, and {float(log_sums[row])!r} when computed again"
            )
        yield alternatives, bandwidth, demonstrations.select(names).to_numpy() / scale


def _of(people: pl.DataFrame, demonstration_id: str, participant: str) -> list[str]:
    if demonstration_id != ALL:
        return [demonstration_id]
    rows = people if participant == ALL else people.filter(participant=participant)
    return rows["demonstration_id"].to_list()


def _different(stored: FloatArray, again: FloatArray, tolerance: float) -> list[int]:
    scale = max(float(np.abs(again).max(initial=0.0)), 1.0)
    differs: list[int] = np.flatnonzero(~(np.abs(stored - again) <= tolerance * scale)).tolist()
    return differs
