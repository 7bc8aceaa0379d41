"""Stage: all tables of all tasks in one DuckDB file, and where they came from."""

from __future__ import annotations

from pathlib import Path

from pipeline.formats.duckdb.catalog import SourceFile, build_catalog
from pipeline.formats.parquet.foreign_keys import check_references, check_table
from pipeline.formats.parquet.tables import read_provenance
from pipeline.stages.registry import table_makers
from pipeline.vocabulary import ALL, STUDIES
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import content_hash
from schemas import names


def run(project: Project) -> None:
    """Write datasets/catalog.duckdb from every table that is there."""
    with recorded_run(project, "catalog", ALL) as record:
        tables: dict[str, list[tuple[str | None, Path]]] = {}
        made = {place: table_makers(place) for place in (*project.params.tasks, STUDIES)}
        for name in names():
            files = [(place, project.table(place, name)) for place in made if name in made[place]]
            present = [(task if task != STUDIES else None, file) for task, file in files if file.is_file()]
            if present:
                tables[name] = present
        for name, present in tables.items():
            for _, file in present:
                check_table(file, name)
        for task in project.params.tasks:
            check_references(
                {name: project.table(task, name) for name in tables if project.table(task, name).is_file()}
            )
        sources = [
            SourceFile(project.shown(file), name, task, content_hash(file), read_provenance(file))
            for name, files in tables.items()
            for task, file in files
        ]
        rows = build_catalog(project.catalog, tables, sources)
        record.produced = f"{len(rows)} tables, {sum(rows.values()):,} rows"
