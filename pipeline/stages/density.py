"""Stage: the scale of the features, and the kernel density of each set of alternatives at its own members."""

from __future__ import annotations

import numpy as np
import polars as pl

from pipeline.choice import log_density, select_bandwidth
from pipeline.choice.scaling import feature_scale
from pipeline.stages.progress import tracked
from pipeline.stages.project import Project, recorded_run
from pipeline.stages.provenance import provenance
from pipeline.stores.tables import read_table, write_table

SET = ("anchor", "set_size", "set_id")


def run(project: Project, name: str) -> None:
    """Write scales.parquet and densities.parquet of the task `name`."""
    project.params.task(name)
    with recorded_run(project, "density", name) as record:
        sources = [project.table(name, "features"), project.table(name, "feature_units")]
        pool = read_table(sources[0], "features").filter(kind="alternative")
        units = read_table(sources[1], "feature_units")
        names = tuple(units["feature"])
        method = project.params.features.scale
        scale = feature_scale(pool.select(names).to_numpy(), method, names)
        used = pl.lit(method if isinstance(method, str) else "given")
        scales = units.select("feature", "unit", method=used, scale=pl.Series(scale))
        sets = pool.partition_by(SET, maintain_order=True)
        bandwidth = project.params.density.bandwidth
        parts = [_set_density(rows, scale, names, bandwidth) for rows in tracked(sets, f"density {name}")]
        stated = provenance(project, depends_on(project), sources)
        write_table(project.table(name, "scales"), "scales", scales, stated)
        write_table(project.table(name, "densities"), "densities", pl.concat(parts), stated)
        record.produced = f"{len(sets)} sets, {pool.height:,} log densities"


def depends_on(project: Project) -> list[object]:
    """The parameters that the tables depend on."""
    return [project.params.features.scale, project.params.density]


def _set_density(rows: pl.DataFrame, scale: np.ndarray, names: tuple[str, ...], bandwidth: str | float) -> pl.DataFrame:
    phi = rows.select(names).to_numpy() / scale
    sigma = select_bandwidth(phi, bandwidth).value if isinstance(bandwidth, str) else bandwidth
    return rows.select(
        *SET,
        alternative_id="id",
        bandwidth=pl.lit(float(sigma)),
        log_density=pl.Series(log_density(phi, sigma)),
    )
