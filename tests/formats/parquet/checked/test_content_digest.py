"""The checksum over rows: the same for the same rows however they lie in the file, another for any other."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import TableError
from pipeline.formats.parquet.checked.conformance import PROVENANCE_KEY
from pipeline.formats.parquet.checked.content_digest import content_digest
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import table_writer, write_table

ROWS = pa.table(
    {
        "text": pa.array(["a", None, "", "bc", "\u00e9"]),
        "number": pa.array([1, None, 3, -4, 5], pa.int64()),
        "value": pa.array([0.5, -0.0, np.inf, None, 1e-300]),
        "flag": pa.array([True, False, None, True, True]),
        "pose": pa.array([[[1.0, 2.0]] * 2, [[3.0, 4.0]] * 2, [[5.0, 6.0]] * 2, [[7.0, 8.0]] * 2, [[9.0, 0.0]] * 2],
                         pa.list_(pa.list_(pa.float64(), 2), 2)),
    }
)  # fmt: skip


@given(cuts=st.lists(st.integers(0, 5), max_size=4))
@settings(max_examples=30, deadline=None)
def test_row_groups_do_not_matter(cuts: list[int]) -> None:
    edges = [0, *sorted(cuts), 5]
    parts = [ROWS.slice(first, last - first) for first, last in pairwise(edges)]
    batches = [batch for part in parts for batch in part.to_batches()]
    assert content_digest(ROWS.schema, batches) == content_digest(ROWS.schema, ROWS.to_batches())


def test_any_other_value_order_name_or_type_matters() -> None:
    digests = {content_digest(ROWS.schema, ROWS.to_batches())}
    count = 1
    for name in ROWS.column_names:
        place = ROWS.schema.get_field_index(name)
        type_ = ROWS.schema.field(place).type
        for row in range(5):
            values = ROWS.column(name).to_pylist()
            values[row] = None if values[row] is not None else ROWS.column(name).to_pylist()[0]
            other = ROWS.set_column(place, name, pa.array(values, type_))
            digests.add(content_digest(other.schema, other.to_batches()))
            count += 1
    for other in (
        ROWS.take([1, 0, 2, 3, 4]),
        ROWS.slice(0, 4),
        ROWS.rename_columns(["texts", *ROWS.column_names[1:]]),
        ROWS.set_column(1, "number", ROWS["number"].cast(pa.float64())),
        ROWS.set_column(0, "text", pa.array(["ab", None, "", "c", "\u00e9"])),
    ):
        digests.add(content_digest(other.schema, other.to_batches()))
        count += 1
    assert len(digests) == count


SHARES = pl.DataFrame({"group": ["a", "b"], "count": [1, 3], "share": [0.25, 0.75]})


def test_written_with_the_table_whatever_its_parts(tmp_path: Path) -> None:
    write_table(tmp_path / "whole.parquet", "human_choice_control", SHARES, {})
    with table_writer(tmp_path / "parts.parquet", "human_choice_control", {}) as writer:
        writer.write(SHARES[:1])
        writer.write(SHARES[1:])
    kept = []
    for name in ("whole", "parts"):
        with OpenTable(tmp_path / f"{name}.parquet", "human_choice_control") as table:
            assert table.content == content_digest(table.arrow_schema, table.batches())
            kept.append(table.content)
    assert kept[0] == kept[1]


@pytest.mark.parametrize(
    "stated",
    [
        b"[]", b"3", b'{"inputs": 3}', b'{"inputs": {"a": 3}}', b'{"inputs": null}', b'{"inputs": ["a"]}',
        b'{"seed": "x"}', b'{"seed": 1e400}', b'{"seed": true}', b'{"seed": 9223372036854775808}',
        b'{"parameters": 5}', b'{"program": ["x"]}', b"{", b"\xff", b"[" * 100_000,
    ],
)  # fmt: skip
def test_what_a_file_says_of_its_making_is_checked(tmp_path: Path, stated: bytes) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, "human_choice_control", SHARES, {})
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata(table.schema.metadata | {PROVENANCE_KEY: stated}), path)
    with pytest.raises(TableError, match="what it says of its making is not what a stage writes"):
        OpenTable(path, "human_choice_control")
