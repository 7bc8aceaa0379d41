"""What a task's tables say before any demonstration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.answers.tables import answer_markdown
from pipeline.arrays import FloatArray
from pipeline.errors import StageError
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import read_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.params import Task
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene
from pipeline.stages.inspect import PATHS
from pipeline.studies.posteriors import hypotheses
from pipeline.trajectories.random_streams import child_rng
from pipeline.views.feature_axis import FeatureAxis
from pipeline.views.rerun.records import AlternativeSet
from pipeline.views.task_view import ALTERNATIVE, axes_of, read_waypoints
from pipeline.vocabulary import TASK_ANCHOR, WORKING
from pipeline.workspace.demonstrations import Intake
from pipeline.workspace.explored_space import ExploredSpace
from pipeline.workspace.project import Project
from pipeline.workspace.trust import register_task_kinds

TABLES = ("alternatives", "features", "scales", "densities")


@dataclass(frozen=True, eq=False)
class Setting:
    """What a task's tables say before any demonstration.

    Attributes:
        name, task, scene: the task.
        intake: what its recordings are judged by.
        features: names of the features.
        axes: how they stand on an axis.
        scale: (F,) what raw values are divided by.
        raw: (N, F) raw values of the working set.
        bandwidth: of LESS on it.
        waypoints: (A, T, J) of the alternatives that are drawn.
        drawn: their paths.
        feature_set: what evaluates the features.
        thetas, betas: the hypotheses.
        space: the explored choice space.
        seed: of the project.
        answer: what `lessbench answer` says of the task's own demonstrations, in Markdown; empty if there is none yet.
        sources: the tables, which are closed.
    """

    name: str
    task: Task
    scene: Scene
    intake: Intake
    features: tuple[str, ...]
    axes: tuple[FeatureAxis, ...]
    scale: FloatArray
    raw: FloatArray
    bandwidth: float
    waypoints: FloatArray
    drawn: AlternativeSet
    feature_set: FeatureSet
    thetas: FloatArray
    betas: FloatArray
    space: ExploredSpace
    seed: int
    answer: tuple[str, ...]
    sources: tuple[OpenTable, ...]

    @property
    def pair(self) -> list[int]:
        """The two features of the map."""
        return [0, min(1, len(self.features) - 1)]


def read_setting(project: Project, name: str) -> Setting:
    """What the tables of a task say.

    Raises:
        StageError: its alternatives belong to single demonstrations.
        TableError: a table is missing or not what it should be.
    """
    task = project.params.task(name)
    if task.anchor != TASK_ANCHOR:
        raise StageError(
            f"tasks.{name}.anchor is {task.anchor!r}: each demonstration needs alternatives of its own, which new ones "
            "do not have yet; set it to task, or run `dvc repro` after each recording"
        )
    with TaskTables(project.tables(name, TABLES)) as tables:
        sources = tuple(tables.values())
        scales = tables["scales"].read()
        names = tuple(scales["feature"])
        if set(names) != set(task.features):
            raise StageError(f"{tables['scales'].path}: has features other than tasks.{name}.features; run `dvc repro`")
        working = pl.col("set_id") == WORKING
        features = tables["features"].read(["set_id", *names], where=working)
        densities = tables["densities"].read(["alternative_id", "bandwidth", "log_density"], where=working)
        alternatives = tables["alternatives"].read(ALTERNATIVE, where=working)
        both = alternatives.join(densities, on="alternative_id", how="inner", maintain_order="left")
        if not features.height == alternatives.height == both.height > 0:
            raise StageError(
                f"{tables['densities'].path}: does not have the alternatives of alternatives.parquet; run `dvc repro`"
            )
        some = _some(project, both)
        waypoints = read_waypoints(tables["alternatives"], some["alternative_id"])
    thetas = hypotheses(task, project.params.infer, names, tuple(scales["direction"]))
    betas = np.array(project.params.infer.betas)
    register_task_kinds(project, task)
    intake = Intake.of(project, name)
    scene = intake.scene
    paths = body_positions(scene, waypoints, [scene.end_effector])[scene.end_effector]
    log_weights = -some["log_density"].to_numpy()
    return Setting(
        name=name,
        task=task,
        scene=scene,
        intake=intake,
        features=names,
        axes=axes_of(scales, waypoints.shape[1]),
        scale=scales["scale"].to_numpy(),
        raw=np.ascontiguousarray(features.select(names).to_numpy()),
        bandwidth=float(both["bandwidth"][0]),
        waypoints=waypoints,
        drawn=AlternativeSet((WORKING,), tuple(some["sampler"]), paths, log_weights, shown=True),
        feature_set=bind_features(scene, {feature: task.features[feature] for feature in names}),
        thetas=thetas,
        betas=betas,
        space=ExploredSpace.of(project.table(name, "explored"), thetas, betas),
        seed=project.params.seed,
        answer=_answer(project, name),
        sources=sources,
    )


def _answer(project: Project, name: str) -> tuple[str, ...]:
    path = project.table(name, "answers")
    return tuple(answer_markdown(read_table(path, "answers"))) if path.exists() else ()


def _some(project: Project, alternatives: pl.DataFrame) -> pl.DataFrame:
    """As many as are to be drawn, the same every time."""
    if alternatives.height <= PATHS:
        return alternatives
    rng = child_rng(project.params.seed, "watch")
    return alternatives[np.sort(rng.choice(alternatives.height, PATHS, replace=False))]
