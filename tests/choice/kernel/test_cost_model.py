"""Every engine against direct sums, at and beyond the limits of each."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.choice import choose_engine, log_density
from pipeline.choice.kernel import cost_model, density
from pipeline.choice.kernel.pairwise import Neighbours
from pipeline.errors import ArgumentError

FAST = ("neighbours", "spectral")


def clustered(count: int, features: int, seed: int = 0) -> np.ndarray:
    """Eight normal clusters of different widths in a unit cube, so that dense and lonely rows mix."""
    rng = np.random.default_rng(seed)
    centres, widths = rng.random((8, features)), rng.uniform(0.03, 0.12, 8)
    of = rng.integers(0, 8, count)
    return centres[of] + widths[of, None] * rng.normal(size=(count, features))


def direct(rows: np.ndarray, sigma: float, at: np.ndarray) -> np.ndarray:
    """Log sums pair by pair, the largest term taken out."""
    exponents = [-0.5 * ((rows - x) ** 2).sum(axis=1) / sigma**2 for x in at]
    return np.array([e.max() + math.log(np.exp(e - e.max()).sum()) for e in exponents])


@pytest.mark.parametrize("features", [1, 2, 3])
def test_a_hundred_thousand_rows_against_direct_sums(features: int) -> None:
    """300 rows, the loneliest 50 among them; the bound is 1e-6 and the measured error far below."""
    rows = clustered(100_000, features)
    values = log_density(rows, 0.05, engine="spectral")
    picked = np.concatenate([np.argsort(values)[:50], np.random.default_rng(1).choice(len(rows), 250)])
    np.testing.assert_allclose(values[picked], direct(rows, 0.05, rows[picked]), rtol=0, atol=1e-9)
    assert values.min() >= 0


@pytest.mark.parametrize("engine", FAST)
@pytest.mark.parametrize("features", [1, 2, 3])
@pytest.mark.parametrize("sigma", [1e-150, 1e-6, 0.02, 1.0, 1e3, 1e150])
def test_extreme_bandwidths(engine: str, features: int, sigma: float) -> None:
    rows = clustered(2000, features)
    if engine == "spectral" and sigma < (1e-9 if features == 1 else 1e-3):
        with pytest.raises(ArgumentError, match=r"too narrow|GiB are allowed"):
            log_density(rows, sigma, engine=engine)
        engine = "auto"
    exact = log_density(rows, sigma, engine="exact")
    np.testing.assert_allclose(log_density(rows, sigma, engine=engine), exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("engine", FAST)
def test_points_in_the_box_around_it_and_far_away(engine: str) -> None:
    """Far sums underflow any double, and halfway between clusters they are small: both are summed over neighbours."""
    rows = clustered(3000, 2)
    points = np.vstack(
        [rows[:100], rows.min(axis=0) - [[0.0, 1e-12], [0.1, 0.2]], [[0.5, 2.0], [40.0, -7.0], [1e6, 0.0]]]
    )
    values = log_density(rows, 0.03, at=points, engine=engine)
    exact = direct(rows, 0.03, points)
    np.testing.assert_allclose(values, exact, rtol=1e-9, atol=1e-6)
    assert values[-1] < -1e14


def test_a_lonely_row_among_many_keeps_its_digits() -> None:
    """One row 8.2 sigma from a heap of 200,000: its sum is 1 + 200,000 exp(-33.6)."""
    rows = np.concatenate([np.zeros((200_000, 1)), [[8.2]], np.linspace(-5, 5, 50)[:, None] - 100])
    rows[:200_000, 0] -= np.linspace(0, 1, 200_000)
    value = log_density(rows, 1.0, engine="spectral")[200_000]
    assert value == pytest.approx(direct(rows, 1.0, rows[[200_000]])[0], abs=1e-6)


def test_sums_too_small_for_the_transform_are_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a bound on the relative error that only dense rows meet, the rest is summed over neighbours, and agrees."""
    rows = clustered(5000, 2)
    calls = []
    monkeypatch.setattr(density, "RELATIVE_ERROR", 1e-8)
    original = Neighbours.log_sums_at

    def counted(self, points, *args):
        calls.append(len(points))
        return original(self, points, *args)

    monkeypatch.setattr(Neighbours, "log_sums_at", counted)
    values = log_density(rows, 0.01, engine="spectral")
    assert 0 < calls[0] < len(rows)
    np.testing.assert_allclose(values, log_density(rows, 0.01, engine="exact"), rtol=0, atol=1e-8)


@pytest.mark.parametrize("engine", FAST)
def test_repetitions_count_and_the_order_of_rows_changes_no_bit(engine: str) -> None:
    rows = clustered(2000, 3)
    tied = np.vstack([rows, rows[:700], rows[:50] * [1.0, 1.0, 0.5]])
    once = log_density(tied, 0.1, engine=engine)
    order = np.random.default_rng(0).permutation(len(tied))
    np.testing.assert_array_equal(log_density(tied[order], 0.1, engine=engine), once[order])
    np.testing.assert_array_equal(log_density(tied, 0.1, engine=engine), once)
    np.testing.assert_allclose(once, log_density(tied, 0.1, engine="exact"), rtol=0, atol=1e-8)


@pytest.mark.parametrize("engine", FAST)
def test_a_constant_feature_and_a_common_offset(engine: str) -> None:
    rows = np.round(clustered(1500, 2) * 2**20) / 2**20
    flat = np.column_stack([rows, np.full(len(rows), 3.0)])
    expected = log_density(rows, 0.1, engine="exact")
    np.testing.assert_allclose(log_density(flat, 0.1, engine=engine), expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(log_density(rows + 2.0**30, 0.1, engine=engine), expected, rtol=0, atol=1e-8)


def test_the_cut_off_stays_within_its_bound_at_the_worst_set() -> None:
    """A heap, and all other rows just beyond its cut-off: what is left out is nearly the whole bound, 1e-8."""
    rng = np.random.default_rng(0)
    heap, others = 1e-7 * rng.random((256, 2)), 1e-7 * rng.random((4096, 2))
    others[:, 0] += 1.0001 * math.sqrt(2 * math.log((256 + 4096) / 1e-8))
    rows = np.vstack([heap, others])
    exact, cut = (np.exp(log_density(rows, 1.0, engine=engine)[:256]) for engine in ("exact", "neighbours"))
    assert np.max(exact - cut) < 1e-8
    assert np.sum(exact - cut > 0.9e-8) > 100  # one leaf of the tree holds rows of both


def test_four_features_by_neighbours() -> None:
    rows = clustered(6000, 4)
    np.testing.assert_allclose(
        log_density(rows, 0.02, engine="neighbours"), log_density(rows, 0.02, engine="exact"), rtol=0, atol=1e-8
    )
    with pytest.raises(ArgumentError, match="up to 3 features where there are 4"):
        log_density(rows, 0.02, engine="spectral")


@pytest.mark.parametrize(
    ("count", "features", "sigma", "engine"),
    [
        (1000, 3, 0.05, "exact"),
        (20_000, 1, 0.05, "spectral"),
        (20_000, 2, 0.05, "spectral"),
        (20_000, 3, 0.3, "spectral"),
        (20_000, 3, 0.005, "neighbours"),
        (20_000, 4, 0.02, "neighbours"),
        (20_000, 4, 3.0, "exact"),
        (100_000, 3, 0.05, "spectral"),
        (100_000, 3, 0.002, "neighbours"),
    ],
)
def test_what_auto_chooses(count: int, features: int, sigma: float, engine: str) -> None:
    rows = clustered(count, features)
    choice = choose_engine(rows, sigma)
    assert choice.engine == engine
    assert choice.memory_bytes <= cost_model.MEMORY_BYTES
    assert choose_engine(rows[::-1], sigma) == choice


def test_few_points_are_summed_over_all_rows() -> None:
    assert choose_engine(clustered(100_000, 3), 0.05, at=np.zeros((10, 3))).engine == "exact"


def test_auto_is_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = clustered(3000, 2)
    for engine in FAST:
        monkeypatch.setattr(density, "_choice", lambda *_, e=engine: cost_model.EngineChoice(e, 0.0, 0.0))
        np.testing.assert_array_equal(log_density(rows, 0.1), log_density(rows, 0.1, engine=engine))


def test_beyond_reach_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = clustered(5000, 4)
    monkeypatch.setattr(cost_model, "LONGEST_S", 1e-3)
    with pytest.raises(ArgumentError, match=r"5000 distinct rows of 4 features.*use fewer alternatives"):
        log_density(rows, 1.0)
    assert log_density(rows, 1.0, engine="exact").shape == (5000,)
