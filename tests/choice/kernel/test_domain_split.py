"""A box cut into slabs against direct sums; the same bits whatever runs side by side."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice import log_density
from pipeline.choice.kernel import cost_model, fourier
from pipeline.choice.kernel.domain_split import cut, sums_in_slabs
from pipeline.choice.kernel.unique_rows import distinct_rows
from pipeline.errors import ArgumentError


def clustered(count: int, features: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    centres, widths = rng.random((8, features)), rng.uniform(0.03, 0.12, 8)
    of = rng.integers(0, 8, count)
    return centres[of] + widths[of, None] * rng.normal(size=(count, features))


@pytest.mark.parametrize("features", [1, 2, 3])
@pytest.mark.parametrize("count", [1, 2, 5, 16])
def test_slabs_against_all_pairs(features: int, count: int) -> None:
    """Within the bound they state, at rows on walls too, with repetitions."""
    rows = clustered(3000, features)
    groups = distinct_rows(np.vstack([rows, rows[:500]]))
    slabs = cut(groups.rows, 3500, 0.03, count)
    walls = [slab.upper for slab in slabs[:-1]]
    on_walls = np.repeat(groups.rows[[1500]], len(walls), axis=0)
    on_walls[:, slabs[0].axis] = walls
    points = np.vstack([groups.rows, on_walls])
    found, error = sums_in_slabs(slabs, groups.rows, groups.counts, points, 0.03)
    squared = ((points[:, None] - groups.rows) ** 2).sum(axis=2)
    assert np.abs(found - np.exp(-0.5 * squared / 0.03**2) @ groups.counts).max() < error < 1e-6


def test_every_point_lies_in_one_slab() -> None:
    rows = clustered(1000, 3)
    slabs = cut(rows, 1000, 0.05, 7)
    assert np.all(sum(slab.contains(rows).astype(int) for slab in slabs) == 1)
    assert all(slab.grid.inside(rows[slab.contains_or_adjoins(rows)]).all() for slab in slabs)


def test_less_memory_means_more_slabs_and_the_same_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = clustered(20_000, 3)
    whole = log_density(rows, 0.02, engine="spectral")
    memory = cost_model.spectral(distinct_rows(rows).rows, len(rows), None, 0.02).memory_bytes
    monkeypatch.setattr(cost_model, "MEMORY_BYTES", 0.6 * memory)
    slabs, cost = cost_model.slabs_within(distinct_rows(rows).rows, len(rows), None, 0.02)
    assert len(slabs) > 1
    assert cost.memory_bytes <= 0.6 * memory
    np.testing.assert_allclose(log_density(rows, 0.02, engine="spectral"), whole, rtol=0, atol=1e-8)
    monkeypatch.setattr(cost_model, "MEMORY_BYTES", 1e5)
    with pytest.raises(ArgumentError, match="GiB for the 64 parts of its grid"):
        log_density(rows, 0.02, engine="spectral")


def test_halves_side_by_side_are_the_same_bits_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = clustered(20_000, 3)
    alone = log_density(rows, 0.2, engine="spectral")
    monkeypatch.setattr(fourier, "_MANY", 0)
    monkeypatch.setattr(fourier, "_SPREADING", 0.0)
    halves = [log_density(rows, 0.2, engine="spectral") for _ in range(3)]
    monkeypatch.setattr(fourier, "_side_by_side", lambda function, parts: [function(part) for part in parts])
    in_turn = log_density(rows, 0.2, engine="spectral")
    assert all(half.tobytes() == in_turn.tobytes() for half in halves)
    np.testing.assert_allclose(in_turn, alone, rtol=0, atol=1e-9)
