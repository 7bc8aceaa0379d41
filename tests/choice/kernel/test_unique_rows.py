"""Distinct rows in lexicographic order, whatever is tied."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice.kernel.unique_rows import distinct_rows


@pytest.mark.parametrize("levels", [[2, 3, 2], [1, 50, 1], [400, 400, 400], [10**9, 2, 2]])
def test_the_order_is_that_of_unique(levels: list[int]) -> None:
    """Few levels tie often, one level always, many hardly ever; -0.0 is 0.0 and ties with it."""
    rng = np.random.default_rng(5)
    rows = np.column_stack([rng.integers(0, level, 500) for level in levels]) - 1.0
    rows[rng.random(500) < 0.2] *= -0.0
    found = distinct_rows(rows)
    expected, index, counts = np.unique(rows + 0.0, axis=0, return_inverse=True, return_counts=True)
    np.testing.assert_array_equal(found.rows, expected)
    np.testing.assert_array_equal(found.counts, counts)
    np.testing.assert_array_equal(found.index, index)
    assert not np.signbit(found.rows[found.rows == 0]).any()
