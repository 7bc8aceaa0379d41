"""What each demonstration of a task was chosen from, out of its tables."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice.explored import ExploredSpace, Region
from pipeline.errors import StageError
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.studies.robustness.divergence import true_direction
from pipeline.studies.robustness.problem import Demonstrations
from pipeline.vocabulary import ALL, BOLTZMANN, LESS, TASK_ANCHOR, WORKING
from pipeline.workspace.project import Project
from pipeline.workspace.provenance import is_current

NEEDED = ("demonstrations", "alternatives", "features", "scales", "densities")
SHIFTED = "shifted_features"
EXPLORED, SPACE, CONVERGENCE = "explored", "choice_space", "convergence"  # what the stage explore makes


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
class Explored:
    """What explorations of a task's choice space have found.

    Attributes:
        space: its regions.
        waypoints: (M, T, J) trajectories of the rows that LESS's explorations have, one after another.
        unsettled: how far the explorations' posteriors of all together are apart or have changed in the last round, in
            multiples of what is tolerated, the larger of both models; None if there is no such row.
    """

    space: ExploredSpace
    waypoints: FloatArray
    unsettled: float | None


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
        explored: the choice space, if it is explored.
    """

    features: tuple[str, ...]
    scale: FloatArray
    people: pl.DataFrame
    raw: FloatArray
    sets: dict[str, ChoiceSet]
    others: tuple[dict[str, FloatArray], ...]
    explored: Explored | None = None

    @property
    def shared(self) -> bool:
        """Whether all were chosen from one set."""
        return TASK_ANCHOR in self.sets

    def set_of(self, row: int) -> ChoiceSet:
        """What a demonstration was chosen from."""
        return self.sets[TASK_ANCHOR if self.shared else self.people["demonstration_id"][row]]

    def known(self, row: int) -> tuple[FloatArray, FloatArray]:
        """Trajectories (N, T, J) that a demonstration was chosen from, as far as they are known, and raw (N, F)."""
        if self.explored is None:
            own = self.set_of(row)
            return own.waypoints, own.raw
        return self.explored.waypoints, Region.mean(self.explored.space.regions[LESS]).features * self.scale

    def of_all(self, by_anchor: dict[str, FloatArray]) -> FloatArray | tuple[FloatArray, ...]:
        """The one set of all demonstrations, or the set of each."""
        if self.shared:
            return by_anchor[TASK_ANCHOR]
        return tuple(by_anchor[key] for key in self.people["demonstration_id"])


def choice_tables(project: Project, name: str, *further: str) -> dict[str, Path]:
    """The tables that say what the demonstrations of a task were chosen from, and `further` ones.

    Of those of other samplers and of the explored space the ones that there are.
    """
    there = [table for table in (SHIFTED, EXPLORED, SPACE, CONVERGENCE) if project.table(name, table).exists()]
    return project.tables(name, dict.fromkeys((*NEEDED, *further, *there)))


def read_choices(tables: TaskTables, project: Project, explored_with: Sequence[str]) -> Chosen:
    """What the demonstrations of a task were chosen from: its working sets, other samplers' and the explored space.

    Args:
        tables: those of `choice_tables`.
        project: whose tables they are.
        explored_with: dotted paths of all parameters that the explored space depends on.

    Raises:
        TableError: a table is missing or not what it should be.
        StageError: the tables do not fit one another, or the space was explored for others.
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
    others = _others(tables, names, set(wanted)) if SHIFTED in tables else ()
    explored = _explored(tables, project, explored_with)
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


def _explored(tables: TaskTables, project: Project, explored_with: Sequence[str]) -> Explored | None:
    there = [table for table in (EXPLORED, SPACE, CONVERGENCE) if table in tables]
    if not there:
        return None
    path = tables[there[0]].path
    again = f"run `lessbench explore {path.parent.parent.name}`, or `dvc repro`"
    if len(there) < 3:
        raise StageError(f"{path}: belongs to an explored choice space of which other tables are missing; {again}")
    if not is_current(project, explored_with, tables[EXPLORED]):
        raise StageError(f"{path}: the choice space was explored for other features, people or parameters; {again}")
    declared = tables[SPACE].read(["explored", "cell"]).row(0, named=True)
    if not declared["explored"]:
        return None
    rows = tables[EXPLORED].read(["exploration", "model", "features", "log_weight"])
    regions: dict[str, list[Region]] = {}
    for (_, model), part in rows.group_by("exploration", "model", maintain_order=True):
        found = Region(np.ascontiguousarray(part["features"].to_numpy()), part["log_weight"].to_numpy())
        regions.setdefault(str(model), []).append(found)
    if set(regions) != {LESS, BOLTZMANN}:
        raise StageError(f"{path}: lacks the rows of {LESS} or {BOLTZMANN}; {again}")
    paths = tables[EXPLORED].read(["waypoints"], where=pl.col("model") == LESS)["waypoints"].to_numpy()
    rounds = tables[CONVERGENCE].read().filter(demonstration_id=ALL, participant=ALL)
    last = rounds.filter(pl.col("round") == pl.col("round").max().over("model"))
    worst = last.select(pl.max_horizontal("disagreement", "change") / pl.col("tolerance")).to_series().max()
    space = ExploredSpace({model: tuple(some) for model, some in regions.items()}, float(declared["cell"]))
    return Explored(space, paths.astype(np.float64), None if worst is None else float(worst))  # type: ignore[arg-type]


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
