"""Tables in parts: one file, one row group per part, whole or not at all, no key twice."""

from pathlib import Path

import duckdb
import polars as pl
import pyarrow.parquet as pq
import pytest

from pipeline.errors import TableError
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import read_table, table_writer, write_table
from tests.support.tables import part_rows, provenance_of


def part(first: int, count: int, set_id: str = "working", **features: float) -> pl.DataFrame:
    return pl.DataFrame(
        {
            "kind": "alternative",
            "id": [f"task/1000/{set_id}/{place:06d}" for place in range(first, first + count)],
            "anchor": "task",
            "set_size": 1000,
            "set_id": set_id,
            **{name: [value] * count for name, value in (features or {"f": 0.5}).items()},
        }
    )


def written(path: Path, *parts: pl.DataFrame) -> None:
    with table_writer(path, "features", {"seed": 3}) as writer:
        for rows in parts:
            writer.write(rows)


def test_parts_are_row_groups_of_one_table(tmp_path: Path) -> None:
    path = tmp_path / "features.parquet"
    parts = [part(0, 7), part(7, 5), part(0, 3, "00")]
    written(path, *parts)
    assert part_rows(path) == (7, 5, 3)
    assert read_table(path, "features").equals(pl.concat(parts))
    assert pl.read_parquet(path).equals(pl.concat(parts))
    assert duckdb.sql(f"select count(*), sum(f) from '{path}'").fetchall() == [(15, 7.5)]
    assert provenance_of(path) == {"seed": 3}
    with OpenTable(path, "features") as table:
        assert table.part(1).equals(parts[1])
        assert table.part(2, ["f", "id"]).equals(parts[2].select("f", "id"))


def test_a_table_of_one_part_is_the_table_written_at_once(tmp_path: Path) -> None:
    written(tmp_path / "parts", part(0, 20))
    write_table(tmp_path / "whole", "features", part(0, 20), {"seed": 3})
    assert (tmp_path / "parts").read_bytes() == (tmp_path / "whole").read_bytes()


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (
            part(4, 5),
            r"has the id from 'task/1000/working/000004' to 'task/1000/working/000008', among those of another",
        ),
        (part(2, 1), "among those of another part"),
        (part(5, 2, g=0.5), "lacks the column|not those of the first part"),
        (part(5, 2, f=float("nan")), "'f' holds NaN"),
        (pl.concat([part(5, 2), part(5, 2)]), "more than one row"),
    ],
)
def test_a_part_that_does_not_belong_leaves_what_was_there(tmp_path: Path, second: pl.DataFrame, message: str) -> None:
    path = tmp_path / "features.parquet"
    written(path, part(0, 3))
    before = path.read_bytes()
    with pytest.raises(TableError, match=message):
        written(path, part(0, 5), second)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_sets_may_follow_each_other_in_any_order(tmp_path: Path) -> None:
    # in the order of their names, the ids of one set lie between those of another's parts
    path = tmp_path / "features.parquet"
    written(path, pl.concat([part(0, 2, "z"), part(0, 2, "a")]), pl.concat([part(0, 2, "m"), part(2, 2, "z")]))
    assert part_rows(path) == (4, 4)


def test_a_table_needs_a_part(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="was given no rows"):
        written(tmp_path / "features.parquet")
    assert list(tmp_path.iterdir()) == []


def test_a_part_is_checked_as_far_as_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "features.parquet"
    written(path, part(0, 3))
    with OpenTable(path, "features") as table, pytest.raises(TableError, match="lacks the column 'g'; it has kind, id"):
        table.part(0, ["g"])
    table = pq.read_table(path)
    broken = table.set_column(table.schema.get_field_index("f"), "f", [[1.0, float("nan"), 2.0]])
    pq.write_table(broken.replace_schema_metadata(table.schema.metadata), path)
    with OpenTable(path, "features") as table:
        assert table.part(0, ["id"]).height == 3
        with pytest.raises(TableError, match="'f' holds NaN"):
            table.part(0, ["f"])
    with pytest.raises(TableError, match="holds table 'features' version"):
        OpenTable(path, "densities")
