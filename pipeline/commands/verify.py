"""Whether the tables are still what they say they are: hashes recomputed, a seeded sample replayed.

Nothing is read whole but the files that are hashed: of a table only what the sample needs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from pipeline import params
from pipeline.arrays import FloatArray
from pipeline.choice import log_density, log_likelihood, posterior_from
from pipeline.choice.models import choice_model
from pipeline.errors import StageError, TableError, WorkbenchError
from pipeline.formats.parquet.checked.open_table import OpenTable, Piece
from pipeline.formats.parquet.partitions import runs
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.replay.features import bind_features
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.registry import Stage, parameters, table_makers
from pipeline.trajectories.random_streams import child_rng
from pipeline.vocabulary import ALL, STUDIES, TASK_ANCHOR
from pipeline.workspace.project import Project
from pipeline.workspace.provenance import content_hash
from pipeline.workspace.scenes import load_task_scene

TOLERANCE = 1e-9  # of a replayed value, relative to the largest of its kind: other processors round otherwise
DENSITY_TOLERANCE = 1e-6  # of a log density: large sets are summed to a stated error
QUESTION, SET = ("model", "demonstration_id", "participant"), ("set_size", "set_id")  # what a posterior is of
Question = tuple[str, str, str]
SetName = tuple[int, str]
HYPOTHESES = ("theta_id", "theta", "beta", "log_posterior", "posterior")
REPLAYED = 20_000  # alternatives in a set, at most, for it to be in the sample


@dataclass
class Verified:
    """What was looked at, and every sentence about something that is no longer as it was."""

    tables: int = 0
    files: int = 0
    trajectories: int = 0
    posteriors: int = 0
    drift: list[str] = field(default_factory=list)

    def lines(self, name: str) -> list[str]:
        """One line per drift; if there is none, one that says what was looked at."""
        if self.drift:
            return [f"drift: {sentence}" for sentence in self.drift]
        return [
            f"{name}: {self.tables} tables as they were made; {self.files} input hashes, {self.trajectories} "
            f"trajectories and {self.posteriors} posteriors computed again"
        ]


def verify(project: Project, name: str, sample: int) -> Verified:
    """Look at the tables of the task `name`, or of the studies.

    Args:
        project: whose tables.
        name: a task, or `studies`.
        sample: how many trajectories and how many posteriors are computed again.

    Raises:
        StageError: there is no table yet.
    """
    found = Verified()
    if name != STUDIES:
        project.params.task(name)
    made = {table: stage for table, stage in table_makers(name).items() if project.table(name, table).is_file()}
    if not made:
        raise StageError(f"{project.datasets / name}: there are no tables to verify; make them with `dvc repro`")
    known = _Known(project, name)
    recorded = _recorded(project)
    with TaskTables(project.tables(name, made)) as tables:
        for table, stage in made.items():
            _check_table(found, known, tables, table, stage, recorded)
        if name != STUDIES and sample:
            rng = child_rng(project.params.seed, "verify")
            if {"features", "alternatives", "demonstrations"} <= made.keys():
                _guarded(found, lambda: _replay_trajectories(found, project, name, tables, sample, rng))
            if {"posteriors", "densities", "scales", "features", "demonstrations"} <= made.keys():
                _guarded(found, lambda: _replay_posteriors(found, project, tables, sample, rng))
    return found


class _Known:
    """Hashes of what is there now, each computed once."""

    def __init__(self, project: Project, name: str) -> None:
        self.project, self.name = project, name
        self._hashes: dict[Path, str] = {}
        self.recordings: list[Path] = []
        outside: list[Path] = []
        self.model: str | None = None
        if name != STUDIES:
            task = project.params.task(name)
            scene = load_task_scene(project, task)
            self.model = model_hash(scene)
            self.recordings = sorted(project.path(task.recordings).glob("*.mcap"))
            given = project.params.sample.given
            outside = [*scene_files(scene.path), *self.recordings, *([project.path(given)] if given else [])]
        self._outside = {project.shown(path): path for path in outside}

    def hash(self, shown: str) -> str | None:
        """Of an input as provenance names it; None if it is not there."""
        path = self._outside.get(shown, self.project.root / shown)
        if path not in self._hashes and path.is_file():
            self._hashes[path] = content_hash(path)
        return self._hashes.get(path)


def _check_table(
    found: Verified, known: _Known, tables: TaskTables, table: str, stage: Stage, recorded: dict[str, str]
) -> None:
    project = known.project
    path = project.table(known.name, table)
    shown = project.shown(path)
    found.tables += 1
    try:
        about = tables[table].provenance
    except TableError as error:
        found.drift.append(str(error))
        return
    parameters_now = params.fingerprint(project.params, parameters(stage.name, known.name))
    for what, then, now in (
        ("other parameters than params.yaml has now (`dvc status` names them)", about.get("parameters"),
         parameters_now),
        (f"{about.get('program')}; this is lessbench {version('lessbench')}", about.get("program"),
         f"lessbench {version('lessbench')}"),
        (f"the seed {about.get('seed')}; params.yaml has {project.params.seed}", about.get("seed"),
         project.params.seed),
        (f"MuJoCo {about.get('mujoco')}; this is {version('mujoco')}", about.get("mujoco"), version("mujoco")),
        ("another scene model than the task has now", about.get("model"), known.model),
    ):  # fmt: skip
        if then != now and (then is not None or what.startswith("other")):
            found.drift.append(f"{shown}: was made with {what}")
    inputs: dict[str, str] = about.get("inputs", {})  # type: ignore[assignment]
    for name, digest in inputs.items():
        now = known.hash(name)
        found.files += 1
        if now is None:
            found.drift.append(f"{shown}: was made from {name}, which is not there any more")
        elif now != digest:
            found.drift.append(f"{shown}: {name} has changed since it was made")
    if table == "demonstrations":
        new = [file.name for file in known.recordings if project.shown(file) not in inputs]
        found.drift += [f"{shown}: was made without the recording {name}" for name in new]
    if shown in recorded and recorded[shown] != _md5(path):
        found.drift.append(f"{shown}: is not the file that `dvc repro` wrote")


def _guarded(found: Verified, replay: Callable[[], None]) -> None:
    """A table that can no longer be read, or does not fit the others, is drift and not the end."""
    try:
        replay()
    except WorkbenchError as error:
        found.drift.append(str(error))
    except (pl.exceptions.PolarsError, OSError) as error:
        found.drift.append(f"a table cannot be read ({' '.join(str(error).split())}); make it again with `dvc repro`")


def _replay_trajectories(
    found: Verified, project: Project, name: str, tables: TaskTables, sample: int, rng: np.random.Generator
) -> None:
    """Features of some demonstrations and alternatives, from their waypoints."""
    task = project.params.task(name)
    features = bind_features(load_task_scene(project, task), task.features)
    path = tables["features"].path
    for kind, source in (("demonstration", tables["demonstrations"]), ("alternative", tables["alternatives"])):
        rows = np.sort(rng.choice(source.rows, min(sample, source.rows), replace=False))
        trajectories = source.at(rows.tolist(), [f"{kind}_id", "waypoints"])
        ids = trajectories[f"{kind}_id"]
        stored = tables["features"].read(where=(pl.col("kind") == kind) & pl.col("id").is_in(ids.implode()))
        joined = pl.DataFrame({"id": ids}).join(stored, on="id", how="left", maintain_order="left")
        if joined["kind"].null_count():
            missing = joined.filter(pl.col("kind").is_null())["id"][0]
            found.drift.append(f"{project.shown(path)}: has no row of the {kind} {missing}")
            continue
        absent = [feature for feature in features.names if feature not in stored.columns]
        if absent:
            found.drift.append(f"{project.shown(path)}: lacks the feature {absent[0]}")
            return
        values = features.evaluate(trajectories["waypoints"].to_numpy().astype(np.float64))
        found.trajectories += len(values)
        for f, feature in enumerate(features.names):
            for row in _different(joined[feature].to_numpy(), values[:, f], TOLERANCE):
                found.drift.append(
                    f"{project.shown(path)}: {feature} of the {kind} {ids[row]} is {joined[feature][row]!r}, and "
                    f"{float(values[row, f])!r} when its waypoints are replayed"
                )


def _replay_posteriors(
    found: Verified, project: Project, tables: TaskTables, sample: int, rng: np.random.Generator
) -> None:
    """Posteriors and densities of some sets, from the features."""
    people = tables["demonstrations"].read(["demonstration_id", "participant"])
    anchors = _anchors(tables["densities"])
    if not anchors:
        return
    where = _places(tables["posteriors"], (*QUESTION, *SET))
    questions = sorted({key[: len(QUESTION)] for key in where})
    for _ in range(sample):
        which = list(anchors)[int(rng.integers(len(anchors)))]
        question = questions[int(rng.integers(len(questions)))]
        said = f"{project.shown(tables['posteriors'].path)}: the posterior of {', '.join(map(str, question + which))}"
        if question + which not in where:
            found.drift.append(f"{said} is missing")
            continue
        rows = pl.concat(tables["posteriors"].pieces(where[question + which], HYPOTHESES)).sort("theta_id", "beta")
        again = _posterior_again(found, project, tables, people, question, which, anchors[which], rows)
        found.posteriors += 1
        for column, values in (("log_posterior", again), ("posterior", np.exp(again))):
            for row in _different(rows[column].to_numpy(), values, TOLERANCE)[:1]:
                found.drift.append(
                    f"{said}: {column} of theta {rows['theta_id'][row]}, beta {rows['beta'][row]:g} is "
                    f"{rows[column][row]!r}, and {float(values[row])!r} when computed again"
                )


def _posterior_again(
    found: Verified, project: Project, tables: TaskTables, people: pl.DataFrame, question: Question, which: SetName,
    anchors: list[str], rows: pl.DataFrame,
) -> FloatArray:  # fmt: skip
    """(K B,) log posterior over the hypotheses of the stored rows, which are in order."""
    model, *asked = question
    thetas = np.array(rows.unique("theta_id", maintain_order=True)["theta"].to_list())
    betas = np.sort(rows["beta"].unique().to_numpy())
    total = np.zeros((len(thetas), len(betas)))
    for alternatives, kernel, of in _choice_sets(found, project, tables, which, anchors, _of(people, *asked)):
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
    found: Verified, project: Project, tables: TaskTables, which: SetName, anchors: list[str], chosen: list[str]
) -> Iterator[tuple[FloatArray, float, FloatArray]]:
    """Per anchor that some of the chosen demonstrations have: alternatives (N, F), bandwidth, demonstrations (n, F)."""
    features, densities, scales = tables["features"], tables["densities"], tables["scales"].read()
    names, scale = scales["feature"].to_list(), scales["scale"].to_numpy()
    size, set_id = which
    for anchor in anchors:
        mine = chosen if anchor == TASK_ANCHOR else [one for one in chosen if one == anchor]
        if not mine:
            continue
        demonstrations = features.read(where=(pl.col("kind") == "demonstration") & pl.col("id").is_in(mine))
        if demonstrations.height < len(mine):
            raise StageError(f"{project.shown(features.path)}: has no row of a demonstration")
        here = (pl.col("anchor") == anchor) & (pl.col("set_size") == size) & (pl.col("set_id") == set_id)
        phi = features.read(["id", *names], where=here)
        if phi.is_empty():
            raise StageError(f"{project.shown(features.path)}: has no rows of the set {set_id!r} of {size:,}")
        density = densities.read(where=here)
        joined = phi.join(density, left_on="id", right_on="alternative_id", how="left", maintain_order="left")
        bandwidth = float(density["bandwidth"][0])
        alternatives = joined.select(names).to_numpy() / scale
        again = log_density(alternatives, bandwidth)
        for row in _different(joined["log_density"].to_numpy(), again, DENSITY_TOLERANCE)[:1]:
            found.drift.append(
                f"{project.shown(densities.path)}: log_density of {joined['id'][row]} is "
                f"{joined['log_density'][row]!r}, and {float(again[row])!r} when computed again"
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


def _recorded(project: Project) -> dict[str, str]:
    """The MD5 of every file that `dvc repro` recorded, by path."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    path = project.root / "dvc.lock"
    if not path.is_file():
        return {}
    try:
        stages = YAML(typ="safe").load(path.read_text(encoding="utf-8"))["stages"].values()
        return {out["path"]: out["md5"] for stage in stages for out in stage["outs"]}
    except (YAMLError, TypeError, KeyError):
        raise StageError(f"{path}: cannot be read; mend it with `lessbench recover`") from None


def _md5(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
