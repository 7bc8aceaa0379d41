"""Stage: all tables of all tasks in one DuckDB file, and where they came from."""

from __future__ import annotations

from contextlib import ExitStack

from pipeline.formats.duckdb.catalog import SourceFile, build_catalog
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.registry import table_makers
from pipeline.vocabulary import ALL, STUDIES
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import content_hash


def run(project: Project) -> None:
    """Write datasets/catalog.duckdb from every table that is there."""
    with recorded_run(project, "catalog", ALL, (project.catalog,)) as record, ExitStack() as stack:
        tables: dict[str, list[tuple[str | None, OpenTable]]] = {}
        sources = []
        for place in (*project.params.tasks, STUDIES):
            files = project.tables(place, table_makers(place))
            own = stack.enter_context(TaskTables({name: file for name, file in files.items() if file.is_file()}))
            own.check()  # all values are, as the catalog takes them
            task = None if place == STUDIES else place
            for name, table in own.items():
                tables.setdefault(name, []).append((task, table))
                shown, digest = project.shown(table.path), content_hash(table.path)
                sources.append(SourceFile(shown, name, task, digest, table.provenance))
        sources.sort(key=lambda source: source.table)
        rows = build_catalog(project.catalog, {name: tables[name] for name in sorted(tables)}, sources)
        record.produced = f"{len(rows)} tables, {sum(rows.values()):,} rows"
