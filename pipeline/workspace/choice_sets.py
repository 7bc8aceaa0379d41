"""What each demonstration of a task was chosen from, out of its tables."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.errors import StageError
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.studies.robustness.divergence import true_direction
from pipeline.studies.robustness.problem import Demonstrations
from pipeline.vocabulary import LESS, TASK_ANCHOR, WORKING

FURTHER = SHIFTED, EXPLORED = "shifted_features", "explored"


@dataclass(frozen=True, eq=False)
class ChoiceSet:
    """The alternatives of one anchor.

    Attributes:
        ids: (N,) as in the table alternatives.
        raw: (N, F) features.
        waypoints: (N, T, J).
        bandwidth: of LESS, in scaled features.
    """

    ids: tuple[str, ...]
    raw: FloatArray
    waypoints: FloatArray
    bandwidth: float


@dataclass(frozen=True, eq=False)
class Chosen:
    """The demonstrations of a task and what they were chosen from.

    Attributes:
        features: (F,) names.
        scale: (F,) what they are divided by.
        people: the table demonstrations, in an order that follows from what was done, not from names of files.
        raw: (n, F) features of the demonstrations.
        sets: by anchor.
        others: of each further sampler the raw features by anchor; empty if none was drawn.
        explored: of each exploration under LESS, scaled features and log weights; empty if the space is not explored.
    """

    features: tuple[str, ...]
    scale: FloatArray
    people: pl.DataFrame
    raw: FloatArray
    sets: dict[str, ChoiceSet]
    others: tuple[dict[str, FloatArray], ...]
    explored: tuple[tuple[FloatArray, FloatArray], ...]

    @property
    def shared(self) -> bool:
        """Whether all were chosen from one set."""
        return TASK_ANCHOR in self.sets

    def set_of(self, row: int) -> ChoiceSet:
        """What a demonstration was chosen from."""
        return self.sets[TASK_ANCHOR if self.shared else self.people["demonstration_id"][row]]

    def of_all(self, by_anchor: dict[str, FloatArray]) -> FloatArray | tuple[FloatArray, ...]:
        """The one set of all demonstrations, or the set of each."""
        if self.shared:
            return by_anchor[TASK_ANCHOR]
        return tuple(by_anchor[key] for key in self.people["demonstration_id"])


def read_choices(tables: TaskTables, further: Collection[str] = ()) -> Chosen:
    """The working sets of a task, and what its other samplers drew.

    Args:
        tables: demonstrations, alternatives, features, scales and densities, and those of `further`.
        further: which of `FURTHER` there are.

    Raises:
        TableError: a table is missing or not what it should be.
        StageError: the tables do not fit one another.
    """
    scales = tables["scales"].read()
    names = tuple(scales["feature"])
    working = pl.col("set_id") == WORKING
    features = tables["features"].read(
        ["kind", "id", "anchor", "set_id", *names], where=working | (pl.col("kind") == "demonstration")
    )
    own = features.filter(kind="demonstration")
    people = (
        tables["demonstrations"]
        .read()
        .join(own.select("id", *names), left_on="demonstration_id", right_on="id", how="left", maintain_order="left")
    )
    people = people.sort(*names, "demonstration_id")
    rows = features.filter(kind="alternative").select("id", "anchor", *names)
    densities = tables["densities"].read(["alternative_id", "bandwidth"], where=working)
    waypoints = tables["alternatives"].read(["alternative_id", "waypoints"], where=working)
    both = rows.join(densities, left_on="id", right_on="alternative_id", maintain_order="left").join(
        waypoints, left_on="id", right_on="alternative_id", maintain_order="left"
    )
    sets = {
        str(anchor): ChoiceSet(
            tuple(part["id"]),
            np.ascontiguousarray(part.select(names).to_numpy()),
            part["waypoints"].to_numpy().astype(np.float64),
            float(part["bandwidth"][0]),
        )
        for (anchor,), part in both.group_by("anchor", maintain_order=True)
    }
    wanted = [TASK_ANCHOR] if TASK_ANCHOR in sets else people["demonstration_id"].to_list()
    missing = [key for key in wanted if key not in sets]
    if missing or both.height != rows.height:
        raise StageError(f"{tables['features'].path}: does not fit the other tables of the task; run `dvc repro`")
    raw = np.ascontiguousarray(people.select(names).to_numpy())
    others = _others(tables, names, set(wanted)) if SHIFTED in further else ()
    explored = _explored(tables) if EXPLORED in further else ()
    return Chosen(names, scales["scale"].to_numpy(), people.drop(names), raw, sets, others, explored)


def demonstrations_of(tables: TaskTables) -> tuple[Demonstrations, pl.DataFrame, tuple[str, ...]]:
    """The demonstrations of a task in scaled features, the table scales, and the names of the features.

    Args:
        tables: demonstrations, features and scales.
    """
    scales = tables["scales"].read()
    names, scale = tuple(scales["feature"]), scales["scale"].to_numpy()
    people = tables["demonstrations"].read(["demonstration_id", "participant", "true_theta"])
    own = tables["features"].read(["kind", "id", *names], where=pl.col("kind") == "demonstration")
    rows = people.join(own, left_on="demonstration_id", right_on="id", maintain_order="left")
    stated = [None if text is None else json.loads(text) for text in people["true_theta"]]
    found = Demonstrations(
        tuple(people["demonstration_id"]),
        tuple(people["participant"]),
        rows.select(names).to_numpy() / scale,
        tuple(None if weights is None else true_direction(weights, names, scale) for weights in stated),
    )
    return found, scales, names


def _explored(tables: TaskTables) -> tuple[tuple[FloatArray, FloatArray], ...]:
    columns = ["exploration", "model", "features", "log_weight"]
    rows = tables[EXPLORED].read(columns, where=pl.col("model") == LESS)
    return tuple(
        (np.ascontiguousarray(part["features"].to_numpy()), part["log_weight"].to_numpy())
        for _, part in rows.group_by("exploration", maintain_order=True)
    )


def _others(tables: TaskTables, names: tuple[str, ...], wanted: set[str]) -> tuple[dict[str, FloatArray], ...]:
    """Of every sampler the largest set of each anchor; of a sampler that lacks an anchor nothing."""
    rows = tables["shifted_features"].read(["anchor", "set_size", "set_id", *names])
    rows = rows.filter(pl.col("set_size") == pl.col("set_size").max())
    found = []
    for _, of_sampler in rows.group_by("set_id", maintain_order=True):
        by_anchor = {
            str(anchor): np.ascontiguousarray(part.select(names).to_numpy())
            for (anchor,), part in of_sampler.group_by("anchor", maintain_order=True)
        }
        if wanted <= set(by_anchor):
            found.append(by_anchor)
    return tuple(found)
