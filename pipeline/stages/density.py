"""Stage: the scale of the features, and the kernel density of each set of alternatives at its own members."""

from __future__ import annotations

import numpy as np
import polars as pl

from pipeline.choice import log_density, select_bandwidth
from pipeline.choice.scaling import feature_scale
from pipeline.replay.features import bind_features
from pipeline.stages.progress import tracked
from pipeline.stages.project import Project, recorded_run
from pipeline.stages.scenes import load_task_scene
from pipeline.stores.tables import read_table, write_table

SET = ("anchor", "set_size", "set_id")


def run(project: Project, name: str) -> None:
    """Write scales.parquet and densities.parquet of the task `name`."""
    task = project.params.task(name)
    with recorded_run(project, "density", name) as record:
        features = bind_features(load_task_scene(project, task), task.features)
        source = project.table(name, "features")
        pool = read_table(source, "features").filter(pl.col("kind") == "alternative")
        method = project.params.features.scale
        scale = feature_scale(pool.select(features.names).to_numpy(), method, features.names)
        scales = pl.DataFrame(
            {
                "feature": features.names,
                "unit": features.units,
                "method": "given" if not isinstance(method, str) else method,
                "scale": scale,
            }
        )
        sets = pool.partition_by(SET, maintain_order=True)
        bandwidth = project.params.density.bandwidth
        parts = [_set_density(rows, scale, features.names, bandwidth) for rows in tracked(sets, f"density {name}")]
        provenance = project.provenance([method, project.params.density], [source])
        write_table(project.table(name, "scales"), "scales", scales, provenance)
        write_table(project.table(name, "densities"), "densities", pl.concat(parts), provenance)
        record.produced = f"{len(sets)} sets, {pool.height:,} log densities"


def _set_density(rows: pl.DataFrame, scale: np.ndarray, names: tuple[str, ...], bandwidth: str | float) -> pl.DataFrame:
    phi = rows.select(names).to_numpy() / scale
    sigma = select_bandwidth(phi, bandwidth).value if isinstance(bandwidth, str) else bandwidth
    return rows.select(
        *SET,
        alternative_id="id",
        bandwidth=pl.lit(float(sigma)),
        log_density=pl.Series(log_density(phi, sigma)),
    )
