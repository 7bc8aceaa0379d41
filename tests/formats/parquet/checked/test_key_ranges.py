"""Keys in several parts: found out from ranges, over the column of the key that orders a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pipeline.errors import TableError
from pipeline.formats.parquet.checked.key_ranges import KeyRanges
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import table_writer
from schemas import schema


def posteriors(thetas: range, demonstration: str = "d", betas: tuple[float, ...] = (1.0, 3.0)) -> pl.DataFrame:
    count = len(thetas) * len(betas)
    return pl.DataFrame(
        {
            "task": "t", "demonstration_id": demonstration, "participant": "p", "model": "less", "set_size": 3,
            "set_id": "00", "theta_id": np.repeat(list(thetas), len(betas)), "theta": pl.Series(np.ones((count, 2))),
            "beta": list(betas) * len(thetas), "log_posterior": -1.0, "posterior": 0.5,
        }
    )  # fmt: skip


def test_a_posterior_may_be_cut_between_thetas(tmp_path: Path) -> None:
    parts = posteriors(range(5)), posteriors(range(5, 9)), posteriors(range(9), "e")
    with table_writer(tmp_path / "posteriors.parquet", "posteriors", {}) as writer:
        for part in parts:
            writer.write(part)
    with OpenTable(tmp_path / "posteriors.parquet", "posteriors") as table:
        assert table.parts == (10, 8, 18)
        assert table.read().equals(pl.concat(parts))


def test_a_theta_is_in_one_part_with_all_its_betas() -> None:
    ranges = KeyRanges(Path("posteriors.parquet"), schema("posteriors"))
    ranges.add(posteriors(range(5), betas=(1.0,)))
    with pytest.raises(TableError, match="has the theta_id from 4 to 8, among those of another part"):
        ranges.add(posteriors(range(4, 9), betas=(3.0,)))


def test_a_few_words_are_kept_for_each_part_and_posterior() -> None:
    ranges = KeyRanges(Path("posteriors.parquet"), schema("posteriors"))
    for part in range(50):
        for demonstration in "abc":
            ranges.add(posteriors(range(100 * part, 100 * part + 100), demonstration))
    assert {key[1]: len(found) for key, found in ranges._ranges.items()} == {"a": 50, "b": 50, "c": 50}
