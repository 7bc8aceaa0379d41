"""Stage: every waypoint of every trajectory replayed in MuJoCo, summed up in the task's features."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.formats.parquet.foreign_keys import check_references
from pipeline.formats.parquet.partitions import Piece, cut, read_pieces
from pipeline.formats.parquet.tables import part_rows, read_table, table_writer, write_table
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.workspace.compute.executor import workers
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance
from pipeline.workspace.scenes import SceneFile, load_task_scene, loaded, scene_file

ALTERNATIVE_COLUMNS = ("anchor", "set_size", "set_id")
BLOCK = 2000  # trajectories whose waypoints are in double precision at once


@dataclass(frozen=True)
class Replayed:
    """Rows of alternatives.parquet whose features are wanted.

    Attributes:
        scene: where they are replayed.
        features: JSON of the task's features.
        path: of the table.
        piece: the rows.
    """

    scene: SceneFile
    features: str
    path: Path
    piece: Piece


def run(project: Project, name: str) -> None:
    """Write features.parquet and feature_units.parquet of the task `name`."""
    task = project.params.task(name)
    with recorded_run(project, "featurize", name) as record, workers(project) as pool:
        scene = load_task_scene(project, task)
        features = bind_features(scene, task.features)
        sources = [project.table(name, "demonstrations"), project.table(name, "alternatives")]
        check_references({"demonstrations": sources[0], "alternatives": sources[1]})
        demonstrations = read_table(sources[0], "demonstrations")
        stated = provenance(
            project, parameters("featurize", name), [*sources, *scene_files(scene.path)], model=model_hash(scene)
        )
        file, specs = scene_file(scene), json.dumps({key: dict(spec) for key, spec in task.features.items()})
        parts = part_rows(sources[1], "alternatives")
        portions = -(-pool.cores() // len(parts))  # fewer parts than cores are cut
        pieces = [
            [Piece(part, first, count) for first, count in cut(rows, -(-rows // portions))]
            for part, rows in enumerate(parts)
        ]
        jobs = [Replayed(file, specs, sources[1], piece) for part in pieces for piece in part]
        done = pool.mapped(replay_piece, jobs, f"featurize {name}")
        before = [_rows(features, demonstrations, "demonstration")]
        with table_writer(project.table(name, "features"), "features", stated) as writer:
            for part in pieces:
                writer.write(pl.concat([*before, *islice(done, len(part))], how="diagonal"))
                before = []
        kinds = [str(task.features[feature]["kind"]) for feature in features.names]
        units = pl.DataFrame({"feature": features.names, "kind": kinds, "unit": features.units})
        write_table(project.table(name, "feature_units"), "feature_units", units, stated)
        count = demonstrations.height + sum(parts)
        record.produced = f"{count:,} trajectories x {len(features.names)} features"


def replay_piece(job: Replayed) -> pl.DataFrame:
    """Rows of features.parquet."""
    columns = ["alternative_id", *ALTERNATIVE_COLUMNS, "waypoints"]
    return _rows(
        _features(job.scene, job.features), read_pieces(job.path, "alternatives", [job.piece], columns), "alternative"
    )


@lru_cache(maxsize=4)
def _features(scene: SceneFile, features: str) -> FeatureSet:
    return bind_features(loaded(scene), json.loads(features))


def _rows(features: FeatureSet, trajectories: pl.DataFrame, kind: str) -> pl.DataFrame:
    """Rows of features.parquet for trajectories of one kind."""
    sets = [column for column in ALTERNATIVE_COLUMNS if column in trajectories.columns]
    waypoints = trajectories["waypoints"].to_numpy()
    blocks = [waypoints[first : first + count] for first, count in cut(len(waypoints), BLOCK)]
    values = np.concatenate([features.evaluate(block.astype(np.float64)) for block in blocks])
    columns = [pl.Series(feature, values[:, f]) for f, feature in enumerate(features.names)]
    return trajectories.select(pl.lit(kind).alias("kind"), *sets, id=f"{kind}_id").with_columns(columns)
