"""`lessbench export TASK --to arviz`: the draws of the weights as JSON that ArviZ opens (`arviz.from_json`).

ArviZ knows draws of equal weight only. The table's weighted draws are therefore resampled, the same rows for everyone,
so that they stay joint.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.answers.tables import GROUP, NEXT, PERSON, group_of
from pipeline.arrays import FloatArray
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.models import Model
from pipeline.errors import StageError
from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.answer import case_of
from pipeline.stages.registry import parameters
from pipeline.terminal import say
from pipeline.trajectories.random_streams import child_rng
from pipeline.workspace.choice_sets import Chosen, choice_tables, read_choices
from pipeline.workspace.project import Project

FOLDER = "arviz"  # in the task's folder of datasets
CHAINS, DRAWS = 4, 250


def export_arviz(project: Project, name: str, folder: Path | None = None) -> Path:
    """Write less.json and boltzmann.json into a folder, by default `datasets/<task>/arviz`.

    Raises:
        StageError: there are no weights yet.
        TableError: a table is missing or not what it should be.
    """
    project.params.task(name)
    path = project.table(name, "weights")
    if not path.exists():
        raise StageError(
            f"{project.shown(path)}: there are no weights yet; run `dvc repro`, or `lessbench conclude {name}`"
        )
    with OpenTable(path, "weights") as table:
        weights = table.read()
    with TaskTables(choice_tables(project, name)) as tables:
        tables.check()
        chosen = read_choices(tables, project, parameters("explore", name))
    target = folder or project.datasets / name / FOLDER
    sigma = case_of(chosen).sigma
    with folder_written_whole(target) as partial:
        for model in (LESS(sigma), Boltzmann()):
            rng = child_rng(project.params.seed, "arviz", model.name)
            found = inference_data(rng, model, weights.filter(model=model.name), chosen)
            (partial / f"{model.name}.json").write_text(json.dumps(found, allow_nan=False), encoding="utf-8")
    say(f"{project.shown(target)}: less.json and boltzmann.json; open one with arviz.from_json(path)")
    return target


def inference_data(
    rng: np.random.Generator, model: Model, weights: pl.DataFrame, chosen: Chosen
) -> Mapping[str, object]:
    """The groups posterior, log_likelihood and observed_data with their dimensions, as `arviz.from_dict` takes them."""
    people = chosen.people
    names = list(dict.fromkeys(people["participant"]))
    group = group_of(weights, GROUP)
    rows = _resampled(rng, group.weight, CHAINS * DRAWS)
    omega = {who: group_of(weights, PERSON, who).omega[rows] for who in names}
    spread = weights.filter(kind=GROUP).sort("draw")["spread"].to_numpy()[rows]
    case = case_of(chosen)
    together = case.considered(model)
    pointwise = np.stack(
        [
            together.subset([row]).log_likelihood(omega[who])[:, 0]
            for row, who in enumerate(people["participant"].to_list())
        ],
        axis=1,
    )
    posterior = {
        "group": group.omega[rows],
        "next": group_of(weights, NEXT).omega[rows],
        "person": np.stack([omega[who] for who in names], axis=1),
        "spread": spread,
        "beta": np.linalg.norm(group.omega[rows], axis=1),
    }
    return {
        "posterior": {key: _chains(values) for key, values in posterior.items()},
        "log_likelihood": {"features": _chains(pointwise)},
        "observed_data": {"features": case.chosen.tolist()},
        "coords": {
            "feature": list(chosen.features),
            "participant": names,
            "demonstration": people["demonstration_id"].to_list(),
        },
        "dims": {
            "group": ["feature"],
            "next": ["feature"],
            "person": ["participant", "feature"],
            "features": ["demonstration"],
        },
        "posterior_attrs": {
            "model": model.name,
            "about": "weights beta theta on scaled features (nat); a cost is negative; resampled from weighted draws",
            "effective_draws": round(group.effective, 1),
            "program": f"lessbench {version('lessbench')}",
        },
    }


def _resampled(rng: np.random.Generator, weight: FloatArray, count: int) -> np.ndarray:
    """Row numbers of equal weight, by systematic resampling, in random order."""
    places = (rng.random() + np.arange(count)) / count
    rows = np.minimum(np.searchsorted(np.cumsum(weight) / weight.sum(), places, side="right"), len(weight) - 1)
    return np.asarray(rng.permutation(rows))


def _chains(values: FloatArray) -> list[object]:
    """(S, ...) as (chain, draw, ...)."""
    found: list[object] = values.reshape(CHAINS, DRAWS, *values.shape[1:]).tolist()
    return found
