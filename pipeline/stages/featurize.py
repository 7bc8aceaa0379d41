"""Stage: every waypoint of every trajectory replayed in MuJoCo, summed up in the task's features."""

from __future__ import annotations

import numpy as np
import polars as pl

from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.progress import tracked
from pipeline.stages.project import Project, recorded_run
from pipeline.stages.provenance import provenance
from pipeline.stages.scenes import load_task_scene
from pipeline.stores.tables import read_table, write_table

ALTERNATIVE_COLUMNS = ("anchor", "set_size", "set_id")
BLOCK = 2000  # trajectories from one step of the progress bar to the next


def run(project: Project, name: str) -> None:
    """Write features.parquet and feature_units.parquet of the task `name`."""
    task = project.params.task(name)
    with recorded_run(project, "featurize", name) as record:
        scene = load_task_scene(project, task)
        features = bind_features(scene, task.features)
        sources = [project.table(name, "demonstrations"), project.table(name, "alternatives")]
        demonstrations = read_table(sources[0], "demonstrations")
        alternatives = read_table(sources[1], "alternatives")
        rows = pl.concat(
            [
                demonstrations.select(pl.lit("demonstration").alias("kind"), id="demonstration_id"),
                alternatives.select(pl.lit("alternative").alias("kind"), *ALTERNATIVE_COLUMNS, id="alternative_id"),
            ],
            how="diagonal",
        )
        waypoints = np.concatenate(
            [table["waypoints"].to_numpy().astype(np.float64) for table in (demonstrations, alternatives)]
        )
        values = _values(features, waypoints, name)
        table = rows.with_columns(pl.Series(feature, values[:, f]) for f, feature in enumerate(features.names))
        stated = provenance(
            project, depends_on(project, name), [*sources, *scene_files(scene.path)], model=model_hash(scene)
        )
        write_table(project.table(name, "features"), "features", table, stated)
        kinds = [str(task.features[feature]["kind"]) for feature in features.names]
        units = pl.DataFrame({"feature": features.names, "kind": kinds, "unit": features.units})
        write_table(project.table(name, "feature_units"), "feature_units", units, stated)
        record.produced = f"{table.height:,} trajectories x {len(features.names)} features"


def depends_on(project: Project, name: str) -> list[object]:
    """The parameters that the tables depend on."""
    task = project.params.task(name)
    return [task.features, task.end_effector]


def _values(features: FeatureSet, waypoints: np.ndarray, name: str) -> np.ndarray:
    blocks = [waypoints[first : first + BLOCK] for first in range(0, len(waypoints), BLOCK)]
    return np.concatenate([features.evaluate(block) for block in tracked(blocks, f"featurize {name}")])
