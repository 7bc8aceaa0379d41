from __future__ import annotations

import numpy as np
import pytest

from pipeline.views.hypothesis_rows import MOST_ROWS, rows_that_matter

LABELS = ("a", "b", "c", "d")
SURE = {"boltzmann": np.array([0.05, 0.94, 0.004, 0.006]), "less": np.array([0.6, 0.392, 0.005, 0.003])}


def test_rows_are_those_that_some_model_finds_worth_it_the_likeliest_first() -> None:
    rows = rows_that_matter(SURE)
    assert rows.names(LABELS) == ["b", "a", "the other 2 together"]
    assert rows.values(SURE["less"]) == pytest.approx([0.392, 0.6, 0.008])
    assert (rows.count, rows.shared) == (3, 2)


def test_the_truth_has_a_row_however_improbable_it_is() -> None:
    rows = rows_that_matter(SURE, truth=2)
    assert rows.names(LABELS, 2) == ["b", "a", "true: c", "the other one"]
    even = {"less": np.full(50, 0.02)}
    assert rows_that_matter(even, truth=30).order.tolist() == [*range(MOST_ROWS - 1), 30]


def test_where_all_matter_no_row_is_shared() -> None:
    rows = rows_that_matter({"less": np.array([0.4, 0.6])})
    assert rows.names(LABELS) == ["b", "a"]
    assert (rows.count, rows.shared) == (2, None)


def test_of_very_many_hypotheses_the_first_still_has_a_row() -> None:
    rows = rows_that_matter({"less": np.full(500, 0.002)})
    assert rows.order.tolist() == [0]
    assert rows.values(np.full(500, 0.002)) == pytest.approx([0.002, 0.998])
