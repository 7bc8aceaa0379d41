"""Columns that are kept: those used last, up to a bound, until their table is closed or let go of."""

from __future__ import annotations

import polars as pl
import pytest

from pipeline.formats.parquet.checked import kept_columns
from pipeline.formats.parquet.checked.kept_columns import KeptColumns


def column(value: float) -> pl.Series:
    return pl.Series("x", [value] * 100)


def test_those_that_were_used_last_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_columns, "KEPT_BYTES", 2 * 800)
    kept, table = KeptColumns(), object()
    kept.keep((table, 0, "x"), column(0))
    kept.keep((table, 1, "x"), column(1))
    assert kept.get((table, 0, "x")) is not None
    kept.keep((table, 2, "x"), column(2))
    assert [kept.get((table, part, "x")) is None for part in range(3)] == [False, True, False]


def test_a_column_larger_than_the_bound_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_columns, "KEPT_BYTES", 700)
    kept, table = KeptColumns(), object()
    kept.keep((table, 0, "x"), column(0))
    assert kept.get((table, 0, "x")) is None
    assert kept._bytes == 0


def test_a_table_is_forgotten_and_the_others_stay() -> None:
    kept, one, other = KeptColumns(), object(), object()
    for table in (one, other):
        kept.keep((table, 0, "x"), column(1))
        kept.keep((table, 0, "x"), column(2))  # is there already
    kept.forget(one)
    assert kept.get((one, 0, "x")) is None
    assert kept.get((other, 0, "x")) is not None
    assert kept._bytes == 800
