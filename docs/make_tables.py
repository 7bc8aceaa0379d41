"""Write docs/tables.md from the schemas and the catalog's views: `python docs/make_tables.py`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pipeline.formats.duckdb.views import PROVENANCE_TABLES, VIEWS
from pipeline.stages.registry import table_makers
from pipeline.vocabulary import STUDIES
from schemas import Column, schema

PAGE = Path(__file__).with_name("tables.md")
INTRODUCTION = """\
# The tables

Made from `schemas/*.toml` by `python docs/make_tables.py`; change it there.

Every table is a Parquet file: `datasets/<task>/tables/<name>.parquet` for a task and
`datasets/studies/tables/<name>.parquet` for a study. The catalog, `datasets/catalog.duckdb`, has all of them under
the same names; there the tables of the tasks are joined, with a column `task`. A file that breaks its schema is
neither written nor read. Its metadata `lessbench.schema` names the table and its version, `lessbench.provenance` the
version of the program and of MuJoCo, the seed, and hashes of the scene's compiled model, the parameters and the files
it was made from.

A type `double[J][T]` is an array of T arrays of J numbers (numpy shape `(T, J)`); in the catalog it is a list. J stands
for joints, T for waypoints, F for features. A value is never NaN, is within the range of the column *values*
where it names one, and is missing only where the last column says so.
"""


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


def page() -> str:
    """The whole page."""
    parts = [INTRODUCTION, "## Tables of a task, in the order in which they are made\n"]
    parts += map(_table, table_makers("a task"))
    parts += ["## Tables of the studies\n", *map(_table, table_makers(STUDIES))]
    parts += ["## Views of the catalog\n", _views()]
    return "\n".join(parts)


def _table(name: str) -> str:
    contract = schema(name)
    columns = [*contract.columns, *([contract.further] if contract.further else [])]
    lines = [
        f"### {name}\n",
        f"Each row: {contract.row}. Key: {', '.join(f'`{column}`' for column in contract.key)}. "
        f"Version {contract.version}.\n",
        "| column | type | unit | values | meaning | missing |",
        "|---|---|---|---|---|---|",
        *(_row(column, further=column is contract.further) for column in columns),
    ]
    return "\n".join(lines) + "\n"


def _row(column: Column, further: bool) -> str:
    name = column.name if further else f"`{column.name}`"
    missing = "may be" if column.nullable else ""
    cells = [name, f"`{column.type}`", column.unit, _range(column), column.description, missing]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _range(column: Column) -> str:
    if column.positive:
        return "above 0"
    if column.least is not None and column.most is not None:
        return f"{column.least:g} to {column.most:g}"
    if column.least is not None:
        return f"from {column.least:g}"
    return "" if column.most is None else f"up to {column.most:g}"


def _views() -> str:
    parts = [
        "In the catalog alone, `files` and `inputs` say where its tables came from; views answer common questions.\n"
    ]
    for name, (comment, columns) in PROVENANCE_TABLES.items():
        parts += [f"### {name}\n", f"{comment[0].upper()}{comment[1:]}.\n", _meanings(columns)]
    for name, view in VIEWS.items():
        made_from = ", ".join(f"`{table}`" for table in view.tables or PROVENANCE_TABLES)
        parts += [
            f"### {name}\n",
            f"A view of {made_from}: {view.comment}. Its own columns:\n",
            _meanings(view.columns),
        ]
    return "\n".join(parts)


def _meanings(columns: Mapping[str, str]) -> str:
    return "\n".join(
        ["| column | meaning |", "|---|---|", *(f"| `{name}` | {text} |" for name, text in columns.items()), ""]
    )


if __name__ == "__main__":
    main()
