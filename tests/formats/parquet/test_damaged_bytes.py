"""Bytes of a table that are flipped or cut off end in one sentence, or change nothing that is read."""

from __future__ import annotations

import random
from pathlib import Path

import polars as pl
import pytest

from pipeline.errors import TableError
from pipeline.formats.parquet.tables import read_table, write_table

ROWS = pl.DataFrame(
    {
        "task": ["t"] * 40, "demonstration_id": [f"d{number:02}" for number in range(40)], "participant": ["p"] * 40,
        "model": ["less"] * 40, "set_size": [10] * 40, "set_id": ["00"] * 40,
        "log_predictive": [-0.25 * number for number in range(40)],
    }
)  # fmt: skip
PROVENANCE = {"program": "lessbench 1", "seed": 3, "inputs": {"a.mcap": "0" * 64}}


@pytest.mark.parametrize("seed", range(4))
def test_one_sentence_whatever_the_bytes_are(tmp_path: Path, seed: int) -> None:
    """Most damage is done to the end of the file, where it says of itself what it holds."""
    path, rng = tmp_path / "held_out.parquet", random.Random(seed)
    write_table(path, "held_out", ROWS, PROVENANCE)
    whole = path.read_bytes()
    footer = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    said = list[str]()
    for _ in range(100):
        damaged = bytearray(whole)
        for _ in range(rng.choice([1, 1, 1, 2, 8])):
            place = rng.randrange(footer if rng.random() < 0.7 else 0, len(damaged))
            damaged[place] = rng.randrange(256)
        if rng.random() < 0.05:
            damaged = damaged[: rng.randrange(len(damaged))]
        path.write_bytes(damaged)
        try:
            rows = read_table(path, "held_out")
        except TableError as error:
            said.append(str(error))
        else:
            assert rows.height == ROWS.height
    assert len(said) > 50
    assert all(sentence.startswith(f"{path}: ") for sentence in said)


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("log_predictive", 0.001, "holds 0.001 in row 3; it is at most 0"),
        ("set_size", 0, "holds 0 in row 3; it is at least 1"),
    ],
)
def test_values_out_of_range_are_neither_written_nor_read(tmp_path: Path, column: str, value: float, said: str) -> None:
    wrong = ROWS.with_columns(pl.when(pl.int_range(40) == 2).then(value).otherwise(pl.col(column)).alias(column))
    with pytest.raises(TableError, match=said):
        write_table(tmp_path / "held_out.parquet", "held_out", wrong.cast(ROWS.schema), PROVENANCE)
    assert not (tmp_path / "held_out.parquet").exists()


def test_rounding_is_no_error(tmp_path: Path) -> None:
    write_table(tmp_path / "held_out.parquet", "held_out", ROWS.with_columns(log_predictive=1e-12), PROVENANCE)
