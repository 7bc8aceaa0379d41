from __future__ import annotations

import dataclasses
import re
import subprocess
import sys
from functools import reduce
from operator import add

import numpy as np
import pytest

from pipeline.choice.kernel.fourier import Grid, Sketch, _sizes
from pipeline.errors import ArgumentError


@pytest.fixture
def rows() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(3000, 3)) * [1.0, 0.2, 3.0]


@pytest.fixture
def grid(rows: np.ndarray) -> Grid:
    return Grid.covering(rows.min(axis=0), rows.max(axis=0), 0.3, 1.2, len(rows))


def sums(rows: np.ndarray, sigma: float, at: np.ndarray) -> np.ndarray:
    return np.array([np.exp(-0.5 * ((rows - x) ** 2).sum(axis=1) / sigma**2).sum() for x in at])


def test_one_sketch_many_bandwidths_within_the_bound(rows: np.ndarray, grid: Grid) -> None:
    sketch = Sketch.of(rows, grid)
    for sigma in (0.3, 0.41, 0.8, 1.2):
        found, error = sketch.sums(rows[:300], sigma)
        assert error < 1e-6
        assert np.abs(found - sums(rows, sigma, rows[:300])).max() < error


def test_outside_its_bandwidths_a_sketch_knows_that_it_is_wrong(rows: np.ndarray, grid: Grid) -> None:
    """Too narrow: frequencies are missing. Too wide: the repetitions of the box reach in. The bound covers both."""
    sketch = Sketch.of(rows, grid)
    for sigma in (0.1, 0.2, 2.0, 4.0):
        found, error = sketch.sums(rows[:300], sigma)
        wrong = np.abs(found - sums(rows, sigma, rows[:300])).max()
        assert 1e-6 < wrong < error


def test_parts_add_up(rows: np.ndarray, grid: Grid) -> None:
    """To rounding whatever the parts; bit for bit for the same parts in the same order."""
    whole = Sketch.of(rows, grid)
    parts = [Sketch.of(part, grid) for part in np.array_split(rows, 7)]
    merged, again = reduce(add, parts), reduce(add, [Sketch.of(part, grid) for part in np.array_split(rows, 7)])
    assert merged.total == whole.total == 3000
    np.testing.assert_allclose(merged.coefficients, whole.coefficients, rtol=0, atol=1e-12 * 3000)
    assert merged.coefficients.tobytes() == again.coefficients.tobytes()
    np.testing.assert_allclose(merged.sums(rows, 0.5)[0], whole.sums(rows, 0.5)[0], rtol=1e-10)


def test_counts_are_repetitions(rows: np.ndarray, grid: Grid) -> None:
    counted = Sketch.of(rows[:100], grid, np.full(100, 3.0))
    repeated = Sketch.of(np.repeat(rows[:100], 3, axis=0), grid)
    assert counted.total == repeated.total == 300
    np.testing.assert_allclose(counted.coefficients, repeated.coefficients, rtol=0, atol=2 * grid.eps * 300)


def test_a_sketch_is_frozen(rows: np.ndarray, grid: Grid) -> None:
    sketch = Sketch.of(rows, grid)
    with pytest.raises(ValueError, match="read-only"):
        sketch.coefficients[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        sketch.total = 1.0  # type: ignore[misc]


def test_refusals(rows: np.ndarray, grid: Grid) -> None:
    sketch = Sketch.of(rows, grid)
    other = Grid.covering(rows.min(axis=0), rows.max(axis=0), 0.5, 1.2, len(rows))
    with pytest.raises(ArgumentError, match="different grids"):
        sketch + Sketch.of(rows, other)
    with pytest.raises(ArgumentError, match="outside the grid's box"):
        Sketch.of(rows * 2, grid)
    with pytest.raises(ArgumentError, match="outside the sketch's box"):
        sketch.sums(rows * 2, 0.5)
    with pytest.raises(ArgumentError, match="too narrow"):
        Grid.covering([0.0], [1.0], 1e-12, 1e-12, 10)


@pytest.mark.parametrize("shape", [(2001,), (76, 153), (76, 153, 149), (90, 181, 177), (121, 243, 243)])
def test_the_grid_of_a_transform_is_the_one_that_finufft_makes(shape: tuple[int, ...]) -> None:
    """Its size is what a transform is predicted to cost by; FINUFFT says it on its own standard output."""
    program = f"import finufft; finufft.Plan(1, {shape}, eps=1e-12, nthreads=1, upsampfac=1.53, debug=1)"
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    stated = re.search(r"\(nf1,nf2,nf3\)=\(([^)]*)\)", said)
    assert stated is not None
    made = tuple(map(int, stated[1].split(",")))
    assert _sizes(shape, 1.53) == made[: len(shape)][::-1]  # the fastest comes first
