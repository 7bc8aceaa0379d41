"""The DuckDB catalog: every table of every task in one file that any DuckDB client opens, and safe questions to it."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from pipeline.errors import QueryError
from schemas import TableSchema, schema

if TYPE_CHECKING:
    import duckdb
    import polars as pl
    import pyarrow as pa

TIME_LIMIT_S = 60.0
MEMORY_LIMIT = "2GB"
LOCKED: dict[str, str | int | float | list[str]] = {
    "enable_external_access": False,
    "lock_configuration": True,
    "temp_directory": "",
    "memory_limit": MEMORY_LIMIT,
    "autoinstall_known_extensions": False,
    "autoload_known_extensions": False,
}

# Name -> the table it is made from, what it says, and how.
CONTENTS = """select table_name as name, 'table' as kind, comment as "what it holds" from duckdb_tables()
    union all select view_name, 'view', comment from duckdb_views() where not internal order by kind, name"""
EXAMPLES = (
    "from best_hypothesis where participant = 'all' and set_id = 'working'",
    "from model_comparison",
    "select column_name, data_type, comment from duckdb_columns() where table_name = 'posteriors'",
)

VIEWS = {
    "best_hypothesis": (
        "posteriors",
        "the most probable theta and beta of each demonstration (`all`: together), model and set",
        """select task, demonstration_id, participant, model, set_size, set_id,
                  arg_max(theta_id, log_posterior) as theta_id, arg_max(theta, log_posterior) as theta,
                  arg_max(beta, log_posterior) as beta, max(posterior) as posterior
           from posteriors group by all""",
    ),
    "theta_marginals": (
        "posteriors",
        "the posterior over theta alone, beta summed out",
        """select task, demonstration_id, participant, model, set_size, set_id, theta_id, any_value(theta) as theta,
                  sum(posterior) as posterior
           from posteriors group by task, demonstration_id, participant, model, set_size, set_id, theta_id""",
    ),
    "model_comparison": (
        "held_out",
        "how well each model predicts a demonstration from the others, on the working set: log predictive probability in nats, "
        "its mean per demonstration, and how much better that is than under Boltzmann (null where that was not inferred)",
        """select h.task, h.set_size, h.model, count(*) as demonstrations,
                  sum(h.log_predictive) as total, avg(h.log_predictive) as mean,
                  stddev_samp(h.log_predictive) / sqrt(count(*)) as standard_error,
                  avg(h.log_predictive - b.log_predictive) as difference,
                  stddev_samp(h.log_predictive - b.log_predictive) / sqrt(count(*)) as difference_standard_error
           from held_out h left join held_out b
             on b.model = 'boltzmann' and (b.task, b.demonstration_id, b.set_size, b.set_id)
                                        = (h.task, h.demonstration_id, h.set_size, h.set_id)
           where h.set_id = 'working' group by h.task, h.set_size, h.model""",
    ),
}


def build_catalog(path: Path, tables: Mapping[str, Sequence[tuple[str | None, Path]]]) -> dict[str, int]:
    """Write the catalog anew, whole or not at all.

    Args:
        path: the database file.
        tables: per schema name, the Parquet files with the task each belongs to, if any. A table of a task without a
            `task` column gets one; arrays become lists, since their lengths may differ between tasks.

    Returns:
        rows per table.
    """
    import duckdb

    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.partial")
    partial.unlink(missing_ok=True)
    try:
        rows = {}
        # one thread: rows keep their order and sums their last digits
        with duckdb.connect(partial, config={"threads": 1, "autoinstall_known_extensions": False}) as con:
            for name, files in tables.items():
                rows[name] = _add_table(con, schema(name), files)
            for name, (table, comment, select) in VIEWS.items():
                if table not in tables:
                    continue
                con.execute(f"create view {name} as {select}")
                con.execute(f"comment on view {name} is {_literal(comment)}")
            con.execute("checkpoint")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
        partial.with_name(f"{partial.name}.wal").unlink(missing_ok=True)
    return rows


def ask(path: Path, sql: str, time_limit_s: float = TIME_LIMIT_S) -> pl.DataFrame:
    """Answer an SQL question from the catalog, which cannot be changed by it.

    The connection is read-only, and reaches no file, network, extension or setting whatever the question says.

    Raises:
        QueryError: there is no catalog, the question is wrong or refused, or it took too long.
    """
    import duckdb

    if not path.is_file():
        raise QueryError(f"{path}: there is no catalog yet; make it with `dvc repro`")
    try:
        with duckdb.connect(path, read_only=True, config=LOCKED) as con:
            timer = threading.Timer(time_limit_s, con.interrupt)
            timer.start()
            try:
                answer = con.sql(sql)
                if answer is None:
                    raise QueryError("the question has no answer; write a select, for example `from best_hypothesis`")
                return _frame(answer.to_arrow_table())
            finally:
                timer.cancel()
    except duckdb.InterruptException:
        raise QueryError(f"the question took more than {time_limit_s:g} s and was stopped; ask for less") from None
    except duckdb.Error as error:
        raise QueryError(" ".join(str(error).split("\n\n")[0].split())) from None


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
    return cast("pl.DataFrame", pl.from_arrow(answer.rename_columns(names)))


def _add_table(con: duckdb.DuckDBPyConnection, contract: TableSchema, files: Sequence[tuple[str | None, Path]]) -> int:
    names = [column.name for column in contract.columns]
    for number, (task, file) in enumerate(files):
        task_column = "" if task is None or "task" in names else f"{_literal(task)} as task, "
        selection = f"select {task_column}{_columns(con, file)} from read_parquet({_literal(str(file))})"
        con.execute(f"create temp table part_{number} as {selection}")
    union = " union all by name ".join(f"from part_{number}" for number in range(len(files)))
    con.execute(f"create table {contract.name} as {union}")
    for number in range(len(files)):
        con.execute(f"drop table part_{number}")
    con.execute(f"comment on table {contract.name} is {_literal(f'each row: {contract.row}')}")
    for column in contract.columns:
        unit = f" [{column.unit}]" if column.unit else ""
        con.execute(f'comment on column {contract.name}."{column.name}" is {_literal(column.description + unit)}')
    (rows,) = con.execute(f"select count(*) from {contract.name}").fetchone() or (0,)
    return int(rows)


def _columns(con: duckdb.DuckDBPyConnection, file: Path) -> str:
    """The selection that turns arrays, whose lengths may differ between tasks, into lists."""
    described = con.execute(f"describe select * from read_parquet({_literal(str(file))})").fetchall()
    parts = []
    for name, type_, *_ in described:
        bare = type_.split("[")[0]
        lists = bare + "[]" * type_.count("[")
        parts.append(f'"{name}"::{lists} as "{name}"' if lists != bare else f'"{name}"')
    return ", ".join(parts)


def _literal(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
