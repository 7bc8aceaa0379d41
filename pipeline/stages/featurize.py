"""Stage: every waypoint of every trajectory replayed in MuJoCo, summed up in the task's features."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import numpy as np
import polars as pl

from pipeline.formats.parquet.checked.conformance import GROUPS
from pipeline.formats.parquet.checked.open_table import Piece
from pipeline.formats.parquet.partitions import cut
from pipeline.formats.parquet.table_file import TableFile
from pipeline.formats.parquet.tables import table_writer, write_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.workspace.compute.executor import workers
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import SceneFile, load_task_scene, loaded, scene_file
from pipeline.workspace.trust import register_task_kinds

BLOCK = 2000  # trajectories whose waypoints are in double precision at once


@dataclass(frozen=True)
class Replayed:
    """Rows of alternatives.parquet whose features are wanted.

    Attributes:
        scene: where they are replayed.
        features: JSON of the task's features.
        table: of the alternatives.
        piece: the rows.
    """

    scene: SceneFile
    features: str
    table: TableFile
    piece: Piece


def run(project: Project, name: str) -> None:
    """Write features.parquet and feature_units.parquet of the task `name`."""
    task = project.params.task(name)
    with (
        recorded_run(project, "featurize", name) as record,
        TaskTables(project.tables(name, ("demonstrations", "alternatives"))) as tables,
        workers() as pool,
    ):
        own_kinds = register_task_kinds(project, task)
        scene = load_task_scene(project, task)
        features = bind_features(scene, task.features)
        tables.check()
        demonstrations, alternatives = tables["demonstrations"].read(), tables["alternatives"]
        stated = provenance(
            project,
            parameters("featurize", name),
            [*tables.values(), *scene_files(scene.path), *own_kinds],
            model=model_hash(scene),
        )
        file, specs = scene_file(scene), json.dumps({key: dict(spec) for key, spec in task.features.items()})
        portions = -(-pool.cores() // len(alternatives.parts))  # fewer parts than cores are cut
        pieces = [
            [Piece(part, first, count) for first, count in cut(rows, -(-rows // portions))]
            for part, rows in enumerate(alternatives.parts)
        ]
        jobs = [Replayed(file, specs, tables.for_jobs("alternatives"), piece) for part in pieces for piece in part]
        done = pool.mapped(replay_piece, jobs, f"featurize {name}")
        before = [_rows(features, demonstrations, "demonstration")]
        with table_writer(project.table(name, "features"), "features", stated) as writer:
            for part in pieces:
                writer.write(pl.concat([*before, *islice(done, len(part))], how="diagonal"))
                before = []
        kinds = [str(task.features[feature]["kind"]) for feature in features.names]
        units = pl.DataFrame(
            {
                "feature": features.names,
                "kind": kinds,
                "unit": features.units,
                "direction": features.directions,
                "over_time": features.over_time,
            }
        )
        write_table(project.table(name, "feature_units"), "feature_units", units, stated)
        count = demonstrations.height + alternatives.rows
        record.produced = f"{count:,} trajectories x {len(features.names)} features"


def replay_piece(job: Replayed) -> pl.DataFrame:
    """Rows of features.parquet."""
    (rows,) = job.table.table().pieces([job.piece], ["alternative_id", *GROUPS, "waypoints"])
    return _rows(_features(job.scene, job.features), rows, "alternative")


@lru_cache(maxsize=4)
def _features(scene: SceneFile, features: str) -> FeatureSet:
    return bind_features(loaded(scene), json.loads(features))


def _rows(features: FeatureSet, trajectories: pl.DataFrame, kind: str) -> pl.DataFrame:
    """Rows of features.parquet for trajectories of one kind."""
    sets = [column for column in GROUPS if column in trajectories.columns]
    waypoints = trajectories["waypoints"].to_numpy()
    blocks = [waypoints[first : first + count] for first, count in cut(len(waypoints), BLOCK)]
    values = np.concatenate([features.evaluate(block.astype(np.float64)) for block in blocks])
    columns = [pl.Series(feature, values[:, f]) for f, feature in enumerate(features.names)]
    return trajectories.select(pl.lit(kind).alias("kind"), *sets, id=f"{kind}_id").with_columns(columns)
