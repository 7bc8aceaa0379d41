"""docs/tables.md says what the schemas say."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

import schemas

DOCS = Path(__file__).resolve().parents[2] / "docs"
_spec = importlib.util.spec_from_file_location("make_tables", DOCS / "make_tables.py")
assert _spec is not None
assert _spec.loader is not None
make_tables = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(make_tables)


def test_the_page_is_up_to_date() -> None:
    written = (DOCS / "tables.md").read_text(encoding="utf-8")
    assert written == make_tables.page(), "docs/tables.md is not what the schemas say: run `python docs/make_tables.py`"


@pytest.mark.parametrize("name", schemas.names())
def test_every_column_of_every_table_is_there(name: str) -> None:
    page = (DOCS / "tables.md").read_text(encoding="utf-8")
    section = page.split(f"### {name}\n")[1].split("\n#")[0]
    for column in schemas.schema(name).columns:
        before, after = f"| `{column.name}` | `{column.type}` | {column.unit} | ", f" | {column.description} |"
        (row,) = [row for row in section.splitlines() if row.startswith(before)]
        values = row.removeprefix(before).partition(" |")[0].removesuffix("|").strip()
        assert after in f" {row}"
        for bound in (column.least, column.most):
            assert bound is None or f"{bound:g}" in values.split()


def test_pipes_do_not_break_a_row() -> None:
    column = schemas.Column("level", "double", "|x| of the row")
    assert make_tables._row(column, further=False) == "| `level` | `double` |  |  | \\|x\\| of the row |  |"


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ({"least": 0, "most": 1}, "0 to 1"), ({"least": 1}, "from 1"), ({"most": 0}, "up to 0"),
        ({"positive": True}, "above 0"), ({}, ""),
    ],
)  # fmt: skip
def test_the_range_of_a_column_is_said(bounds: dict[str, float], said: str) -> None:
    column = schemas.Column("level", "double", "of the row", **bounds)
    assert make_tables._row(column, further=False) == f"| `level` | `double` |  | {said} | of the row |  |"
