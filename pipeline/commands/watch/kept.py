"""The tables that are kept when watching ends."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from pipeline.commands.watch.belief import Belief
from pipeline.formats.parquet.partitions import gathered
from pipeline.formats.parquet.tables import table_writer, write_table
from pipeline.replay.scene import scene_files
from pipeline.stages.ingest import NULLABLE, REJECTED
from pipeline.stages.registry import parameters
from pipeline.studies.exploration import explored_posterior_rows
from pipeline.studies.posteriors import PART_ROWS, Group, groups_of, posterior_parts
from pipeline.vocabulary import WORKING
from pipeline.workspace.project import Project
from pipeline.workspace.provenance import provenance


def write_tables(
    partial: Path, project: Project, belief: Belief, rejected: dict[str, dict[str, str]], folder: Path
) -> None:
    """Tables as those of the stages, of the working set and of the explored choice space."""
    setting = belief.setting
    rows = [belief.rows[key] for key in sorted(belief.rows)]
    table = pl.DataFrame(rows, schema_overrides=NULLABLE).with_columns(
        waypoints=pl.Series(np.stack([row["waypoints"] for row in rows]))
    )
    people = table.select("demonstration_id", "participant")
    files = [folder / row["source"] for row in rows if (folder / row["source"]).is_file()]
    used = [*files, *scene_files(setting.scene.path)]
    stated = provenance(project, parameters("ingest", setting.name), used)
    write_table(partial / "demonstrations.parquet", "demonstrations", table, stated)
    write_table(partial / "rejected.parquet", "rejected", pl.DataFrame(list(rejected.values()), REJECTED), stated)
    stated = provenance(project, parameters("infer", setting.name), [*files, *setting.sources])
    with (
        table_writer(partial / "posteriors.parquet", "posteriors", stated) as writer,
        gathered(writer, PART_ROWS) as posteriors,
    ):
        groups = groups_of(people)
        for model in belief.models:
            about = {"task": setting.name, "model": model, "set_size": len(setting.raw), "set_id": WORKING}
            for part in posterior_parts(groups, belief.values(model), setting.thetas, setting.betas, about):
                posteriors.add(part)
    if setting.space.normalisers:
        stated = provenance(project, parameters("explore", setting.name), [*files, *setting.sources])
        write_table(partial / "explored_posteriors.parquet", "explored_posteriors", _explored(belief, groups), stated)


def _explored(belief: Belief, groups: Sequence[Group]) -> pl.DataFrame:
    """Rows of the table explored_posteriors."""
    setting, phi = belief.setting, belief.phi
    tables: list[pl.DataFrame] = []
    for model in (one for one in belief.models if one in setting.space.normalisers):
        by_group = [setting.space.posteriors(model, phi[rows]) for _, _, rows in groups]
        values = np.array([[one.log_probability for one in of_run] for of_run in zip(*by_group, strict=True)])
        about = {"task": setting.name, "model": model}
        tables += explored_posterior_rows(groups, values, setting.thetas, setting.betas, about)
    return pl.concat(tables)
