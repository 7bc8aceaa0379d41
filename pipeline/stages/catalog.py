"""Stage: all tables of all tasks in one DuckDB file."""

from __future__ import annotations

from pathlib import Path

from pipeline.stages.project import Project, recorded_run
from pipeline.stores.catalog import build_catalog
from schemas import names


def run(project: Project) -> None:
    """Write datasets/catalog.duckdb."""
    with recorded_run(project, "catalog", "all") as record:
        tables: dict[str, list[tuple[str, Path]]] = {}
        for name in names():
            files = [(task, project.table(task, name)) for task in project.params.tasks]
            present = [(task, file) for task, file in files if file.is_file()]
            if present:
                tables[name] = present
        rows = build_catalog(project.catalog, tables)
        record.produced = f"{len(rows)} tables, {sum(rows.values()):,} rows"
