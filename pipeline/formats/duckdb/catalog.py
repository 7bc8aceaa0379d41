"""The DuckDB catalog: every table of every task in one file that any DuckDB client opens, and safe questions to it."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from pipeline.errors import QueryError
from pipeline.formats.duckdb import query_process
from pipeline.formats.duckdb.views import FILES, INPUTS, PROVENANCE_TABLES, VIEWS, View
from pipeline.formats.files.atomic import cannot_write, path_written_whole
from pipeline.formats.parquet.checked.open_table import OpenTable
from schemas import Column, TableSchema, schema

if TYPE_CHECKING:
    import duckdb
    import polars as pl
    import pyarrow as pa

TIME_LIMIT_S = 60.0
MEMORY_LIMIT = "512MB"  # of the database while the catalog is made
TASK = "name of the task"
CONTENTS = """select table_name as name, 'table' as kind, comment as "what it holds" from duckdb_tables()
    union all select view_name, 'view', comment from duckdb_views() where not internal order by kind desc, name"""
EXAMPLES = {
    "What did they want?": "from best_weights where participant = 'all' and set_id = 'working'",
    "Which model predicts people better?": "from model_comparison",
    "Does the answer hang on the sampled alternatives?": "from disagreement_between_sets where participant = 'all'",
    "Whose demonstration says something else?": "from people_against_group where set_id = 'working' and differs",
    "Where does a posterior come from?": "from lineage where set_id = 'working' and model = 'less'",
    "What do the columns mean?": "select column_name, data_type, comment from duckdb_columns() "
    "where table_name = 'posteriors'",
}


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
    """
    import duckdb

    with path_written_whole(path) as partial:
        try:
            rows = _fill(partial, tables, sources)
        except (duckdb.IOException, duckdb.TransactionException) as error:  # the second: of a path with a question mark
            raise cannot_write(path, OSError(None, " ".join(str(error).split()))) from None
        finally:
            partial.with_name(f"{partial.name}.wal").unlink(missing_ok=True)
            shutil.rmtree(_scratch(partial), ignore_errors=True)
    return rows


def _scratch(path: Path) -> Path:
    """Where DuckDB puts what does not fit into its memory."""
    return path.with_name(f"{path.name}.tmp")


def _fill(
    path: Path, tables: Mapping[str, Sequence[tuple[str | None, OpenTable]]], sources: Sequence[SourceFile]
) -> dict[str, int]:
    import duckdb

    rows = {}
    config: dict[str, str | bool | int | float | list[str]] = {
        "threads": 1,  # rows keep their order and sums their last digits
        "memory_limit": MEMORY_LIMIT,
        "temp_directory": str(_scratch(path)),
        "autoinstall_known_extensions": False,
    }
    with duckdb.connect(path, config=config) as con:
        for name, files in tables.items():
            rows[name] = _add_table(con, schema(name), files)
        _add_sources(con, sources)
        for name, view in VIEWS.items():
            if set(view.tables) <= set(tables):
                _add_view(con, name, view)
        con.execute("checkpoint")
    return rows


def ask(path: Path, sql: str, time_limit_s: float = TIME_LIMIT_S) -> pl.DataFrame:
    """Answer an SQL question from the catalog, which cannot be changed by it.

    The connection is read-only, and reaches no file, network, extension or setting whatever the question says; its time
    and memory are those of a process that can be ended.

    Raises:
        QueryError: there is no catalog, the question is wrong or refused, or it took too long or too much memory.
    """
    if not path.is_file():
        raise QueryError(f"{path}: there is no catalog yet; make it with `dvc repro`")
    return _frame(query_process.answer(path, sql, time_limit_s))


def _frame(answer: pa.Table) -> pl.DataFrame:
    """The answer, its columns numbered where several have one name."""
    import polars as pl

    names: list[str] = []
    for name in answer.column_names:
        count = 2
        unique = name
        while unique in names:
            unique, count = f"{name}_{count}", count + 1
        names.append(unique)
    try:
        return cast("pl.DataFrame", pl.from_arrow(answer.rename_columns(names)))
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, NotImplementedError, ValueError) as error:
        raise QueryError(
            f"the answer holds what cannot be shown ({' '.join(str(error).split())[:200]}); cast it, for example `column::varchar`"
        ) from None


def _add_table(
    con: duckdb.DuckDBPyConnection, contract: TableSchema, tables: Sequence[tuple[str | None, OpenTable]]
) -> int:
    import pyarrow as pa

    names = [column.name for column in contract.columns]
    selections = []
    for number, (task, table) in enumerate(tables):
        con.register(f"part_{number}", table.arrow_schema.empty_table())
        task_column = "" if task is None or "task" in names else f"{_literal(task)} as task, "
        selections.append(f"select {task_column}{_columns(con, f'part_{number}')} from part_{number}")
    con.execute(f"create table {contract.name} as {' union all by name '.join(selections)}")
    for number, ((_, table), selection) in enumerate(zip(tables, selections, strict=True)):
        con.register(f"part_{number}", pa.RecordBatchReader.from_batches(table.arrow_schema, table.batches()))
        con.execute(f"insert into {contract.name} by name {selection}")
        con.unregister(f"part_{number}")
    con.execute(f"comment on table {contract.name} is {_literal(f'each row: {contract.row}')}")
    described = {column.name: _meaning(column) for column in contract.columns}
    for column in _column_names(con, contract.name):
        further = _meaning(contract.further) if contract.further else ""
        _comment(con, contract.name, column, described.get(column, TASK if column == "task" else further))
    return sum(table.rows for _, table in tables)


def _columns(con: duckdb.DuckDBPyConnection, relation: str) -> str:
    """The selection that turns arrays, whose lengths may differ between tasks, into lists."""
    parts = []
    for name, type_, *_ in con.execute(f"describe {relation}").fetchall():
        quoted = '"' + name.replace('"', '""') + '"'
        bare = type_.split("[")[0]
        lists = bare + "[]" * type_.count("[")
        parts.append(f"{quoted}::{lists} as {quoted}" if lists != bare else quoted)
    return ", ".join(parts)


def _add_sources(con: duckdb.DuckDBPyConnection, sources: Sequence[SourceFile]) -> None:
    """The tables `files` and `inputs`."""
    files, inputs = [], []
    for source in sources:
        stated = [source.provenance.get(key) for key in ("program", "seed", "parameters", "mujoco", "model")]
        files.append([source.file, source.table, source.task, source.sha256, *stated])
        made_from = source.provenance.get("inputs")
        if isinstance(made_from, dict):
            inputs += [[source.file, path, sha256] for path, sha256 in made_from.items()]
    for table, rows in ((FILES, files), (INPUTS, inputs)):
        comment, columns = PROVENANCE_TABLES[table]
        types = ", ".join(f"{name} {'bigint' if name == 'seed' else 'varchar'}" for name in columns)
        con.execute(f"create table {table} ({types})")
        if rows:
            con.executemany(f"insert into {table} values ({', '.join('?' * len(columns))})", rows)
        con.execute(f"comment on table {table} is {_literal(comment)}")
        for name, meaning in columns.items():
            _comment(con, table, name, meaning)


def _add_view(con: duckdb.DuckDBPyConnection, name: str, view: View) -> None:
    con.execute(f"create view {name} as {view.select}")
    con.execute(f"comment on view {name} is {_literal(view.comment)}")
    columns = [column for table in view.tables for column in schema(table).columns]
    described = {column.name: _meaning(column) for column in reversed(columns)} | dict(view.columns)
    for column in _column_names(con, name):
        _comment(con, name, column, described.get(column, TASK))


def _column_names(con: duckdb.DuckDBPyConnection, table: str) -> list[str]:
    return [row[0] for row in con.execute(f"describe {table}").fetchall()]


def _comment(con: duckdb.DuckDBPyConnection, table: str, column: str, meaning: str) -> None:
    name = column.replace('"', '""')
    con.execute(f'comment on column {table}."{name}" is {_literal(meaning)}')


def _meaning(column: Column) -> str:
    return column.description + (f" [{column.unit}]" if column.unit else "")


def _literal(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
