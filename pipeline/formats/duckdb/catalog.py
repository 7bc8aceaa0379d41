"""The DuckDB catalog: every table of every task in one file that any DuckDB client from 1.0 on opens.

No path, no folder and no text of a file reaches DuckDB as SQL. Tables are read and checked here, row group by row
group, and handed over in memory; the connection that takes them can reach no file but its own.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from pipeline.errors import TableError
from pipeline.formats.duckdb.database_file import new_database
from pipeline.formats.duckdb.quoting import identifier, identifiers, literal
from pipeline.formats.duckdb.views import FILES, INPUTS, PROVENANCE_TABLES, VIEWS, View
from pipeline.formats.files.atomic import cannot_write
from pipeline.formats.parquet.checked.open_table import OpenTable
from schemas import Column, TableSchema, schema

if TYPE_CHECKING:
    import duckdb

TASK = "name of the task"
STORAGE_VERSION = "v1.0.0"  # clients from DuckDB 1.0 on open it; newer versions make what older ones refuse
MEMORY_LIMIT = "1GB"  # what is more goes to a folder beside the file
BUILDING: dict[str, str | bool | int | float | list[str]] = {
    "threads": 1,  # rows keep their order and sums their last digits
    "storage_compatibility_version": STORAGE_VERSION,
    "memory_limit": MEMORY_LIMIT,
    "enable_external_access": False,
    "autoinstall_known_extensions": False,
    "autoload_known_extensions": False,
    "python_enable_replacements": False,
}
TYPES = {"string": "varchar", "bool": "boolean", "int64": "bigint", "float": "float", "double": "double"}
MADE_BY = ("program", "seed", "parameters", "mujoco", "model")  # of a file's provenance, as columns of `files`
_FURTHER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,199}")  # names of columns that no schema lists: features


@dataclass(frozen=True)
class SourceFile:
    """A Parquet file of the catalog: its path within the project, its SHA-256 and what it says of its making."""

    file: str
    table: str
    task: str | None
    sha256: str
    provenance: Mapping[str, object]


def build_catalog(
    path: Path, tables: Mapping[str, Sequence[tuple[str | None, OpenTable]]], sources: Sequence[SourceFile] = ()
) -> dict[str, int]:
    """Write the catalog anew, whole or not at all.

    Args:
        path: the database file.
        tables: per schema name, the open tables with the task each belongs to, if any. A table of a task without a
            `task` column gets one; arrays become lists, since their lengths may differ between tasks. Of a table, one
            part is in memory at a time.
        sources: what is known of these files, for the tables `files` and `inputs`.

    Returns:
        rows per table, without these two.

    Raises:
        TableError: a file breaks its schema, has a column whose name no feature can have, or says of its making what
            cannot be.
        StageError: the catalog cannot be written.
    """
    import duckdb

    with new_database(path) as partial:
        spilled = partial.with_name(f"{partial.name}.spilled")
        try:
            with duckdb.connect(partial, config=BUILDING | {"temp_directory": str(spilled)}) as con:
                return _fill(con, tables, sources)
        except duckdb.IOException as error:
            raise cannot_write(path, OSError(None, " ".join(str(error).split()))) from None
        finally:
            shutil.rmtree(spilled, ignore_errors=True)


def _fill(
    con: duckdb.DuckDBPyConnection,
    tables: Mapping[str, Sequence[tuple[str | None, OpenTable]]],
    sources: Sequence[SourceFile],
) -> dict[str, int]:
    rows = {}
    for name, files in tables.items():
        rows[name] = _add_table(con, schema(name), files)
    _add_sources(con, sources)
    for name, view in VIEWS.items():
        if set(view.tables) <= set(tables):
            _add_view(con, name, view)
        elif view.without is not None and view.tables[0] in tables:
            _add_view(con, name, replace(view, select=view.without))
    con.execute("checkpoint")
    return rows


def _add_table(
    con: duckdb.DuckDBPyConnection, contract: TableSchema, tables: Sequence[tuple[str | None, OpenTable]]
) -> int:
    columns = _columns(contract, tables)
    typed = ", ".join(f"{identifier(name)} {_type(column)}" for name, column in columns.items())
    con.execute(f"create table {identifier(contract.name)} ({typed})")
    for task, table in tables:
        own = "" if task is None or "task" in table.columns else f"{literal(task)} as task, "
        selection = f"select {own}{identifiers(table.columns)} from given"
        _insert(con, f"insert into {identifier(contract.name)} by name {selection}", table)
    con.execute(f"comment on table {identifier(contract.name)} is {literal(f'each row: {contract.row}')}")
    for name, column in columns.items():
        _comment(con, contract.name, name, _meaning(column))
    return sum(table.rows for _, table in tables)


def _insert(con: duckdb.DuckDBPyConnection, sql: str, table: OpenTable) -> None:
    """Insert from `given`: the rows of a table, of which one part is in memory at a time, checked as it is read."""
    import duckdb
    import pyarrow as pa

    refused: list[TableError] = []

    def batches() -> Iterator[pa.RecordBatch]:
        try:
            for number, _ in enumerate(table.parts):
                yield from table.part(number).to_arrow().cast(table.arrow_schema).to_batches()
        except TableError as error:
            refused.append(error)
            raise

    con.register("given", pa.RecordBatchReader.from_batches(table.arrow_schema, batches()))
    try:
        con.execute(sql)
    except duckdb.Error:
        if refused:  # DuckDB has an error of its own for what goes wrong in what it is given
            raise refused[0] from None
        raise
    finally:
        con.unregister("given")


def _columns(contract: TableSchema, tables: Sequence[tuple[str | None, OpenTable]]) -> dict[str, Column]:
    """The columns of a table of the catalog: the task, those of the schema, then further ones of any of the tables."""
    columns = {column.name: column for column in contract.columns}
    if "task" not in columns and any(task is not None for task, _ in tables):
        columns = {"task": Column("task", "string", TASK)} | columns
    listed = {name.lower() for name in columns}  # DuckDB takes names that differ in case for one
    further: dict[str, str] = {}
    for _, table in tables:
        names = [name for name in table.columns if name not in columns]
        _check_names(table, names, listed)
        for name in names:
            further.setdefault(name.lower(), name)
    return columns | {name: cast("Column", contract.further) for name in further.values()}


def _check_names(table: OpenTable, names: Sequence[str], listed: Set[str]) -> None:
    seen = set(listed)
    for name in names:
        if not _FURTHER.fullmatch(name) or name.lower() in seen:
            raise TableError(
                f"{table.path}: table {table.contract.name!r} has a column {name!r}; beside the columns of its schema "
                "only names of features are allowed, which are letters, digits and underscores and do not differ in "
                "case alone; make it again with `dvc repro`"
            )
        seen.add(name.lower())


def _type(column: Column) -> str:
    return TYPES[column.scalar] + "[]" * len(column.lengths)


def _add_sources(con: duckdb.DuckDBPyConnection, sources: Sequence[SourceFile]) -> None:
    """The tables `files` and `inputs`."""
    files, inputs = [], []
    for source in sources:
        file, about = _path(source.file), source.provenance
        files.append([file, source.table, source.task, source.sha256, *(about.get(key) for key in MADE_BY)])
        made_from = cast("Mapping[str, str]", about.get("inputs") or {})
        inputs += [[file, _path(path), sha256] for path, sha256 in made_from.items()]
    for table, rows in ((FILES, files), (INPUTS, inputs)):
        comment, columns = PROVENANCE_TABLES[table]
        types = ", ".join(f"{identifier(name)} {'bigint' if name == 'seed' else 'varchar'}" for name in columns)
        con.execute(f"create table {identifier(table)} ({types})")
        if rows:
            con.executemany(f"insert into {identifier(table)} values ({', '.join('?' * len(columns))})", rows)
        con.execute(f"comment on table {identifier(table)} is {literal(comment)}")
        for name, meaning in columns.items():
            _comment(con, table, name, meaning)


def _path(path: str) -> str:
    """A path as text: bytes of it that are none become `\\udcff` and the like."""
    return path.encode("utf-8", "backslashreplace").decode()


def _add_view(con: duckdb.DuckDBPyConnection, name: str, view: View) -> None:
    con.execute(f"create view {identifier(name)} as {view.select}")
    con.execute(f"comment on view {identifier(name)} is {literal(view.comment)}")
    columns = [column for table in view.tables for column in schema(table).columns]
    described = {column.name: _meaning(column) for column in reversed(columns)} | dict(view.columns)
    for column, *_ in con.execute(f"describe {identifier(name)}").fetchall():
        _comment(con, name, column, described.get(column, TASK))


def _comment(con: duckdb.DuckDBPyConnection, table: str, column: str, meaning: str) -> None:
    con.execute(f"comment on column {identifier(table)}.{identifier(column)} is {literal(meaning)}")


def _meaning(column: Column) -> str:
    return column.description + (f" [{column.unit}]" if column.unit else "")
