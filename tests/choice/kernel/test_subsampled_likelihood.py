"""The bandwidth from some of the rows against the one from all of them."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from pipeline.choice import select_bandwidth
from pipeline.choice.kernel import row_sample, sampled_sums
from pipeline.choice.kernel.pairwise import Neighbours
from pipeline.choice.kernel.unique_rows import distinct_rows
from pipeline.errors import ArgumentError, BandwidthError


def clustered(count: int, features: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    centres, widths = rng.random((8, features)), rng.uniform(0.03, 0.12, 8)
    of = rng.integers(0, 8, count)
    return centres[of] + widths[of, None] * rng.normal(size=(count, features))


def from_all(rows: np.ndarray, near: float) -> tuple[float, float]:
    """The maximum near a bandwidth and its score, over all rows, each against all others: a quartic through five."""
    groups = distinct_rows(rows)
    nodes = np.linspace(0.12, -0.12, 5)
    log_sums = Neighbours(groups.rows, groups.counts).log_sums_of_others(groups.rows, near * np.exp(nodes), 1e-8)
    norms = rows.shape[1] * (math.log(near) + nodes + 0.5 * math.log(2 * math.pi))
    scores = (log_sums - np.log(len(rows) - groups.counts)) @ groups.counts - len(rows) * norms
    quartic = np.polynomial.Polynomial.fit(nodes, scores, 4)
    peaks = [root.real for root in quartic.deriv().roots() if abs(root.imag) < 1e-9 and abs(root.real) < 0.12]
    best = max(peaks, key=quartic)
    return near * math.exp(best), float(quartic(best))


@pytest.mark.parametrize(
    "rows",
    [clustered(12_000, 3), clustered(8000, 1, 1), clustered(8000, 4, 4), np.repeat(clustered(6000, 2), 3, axis=0)],
    ids=["12,000 rows of 3 features", "1 feature", "4 features", "ties"],
)
def test_all_rows_give_the_same_within_the_standard_errors(rows: np.ndarray) -> None:
    chosen = select_bandwidth(rows)
    sigma, score = from_all(rows, chosen.value)
    assert chosen.rows_scored is not None
    assert chosen.rows_scored < len(rows)
    assert chosen.value_error < 0.1 * chosen.value
    assert abs(chosen.value - sigma) < 2.5 * chosen.value_error
    assert abs(chosen.log_likelihood - score) < 2.5 * chosen.log_likelihood_error


def test_standard_errors_are_of_the_right_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve seeds: deviations from the value of all rows, in standard errors, have a mean square near one."""
    rows = clustered(9000, 2, 3)
    sigma, score = from_all(rows, select_bandwidth(rows).value)
    monkeypatch.setattr(row_sample, "_DRAWN", 4000)
    monkeypatch.setattr(row_sample, "_STRATUM", 500)
    deviations = []
    for seed in range(12):
        monkeypatch.setattr(row_sample, "_SEED", seed)
        chosen = select_bandwidth(rows)
        deviations.append(
            ((chosen.value - sigma) / chosen.value_error, (chosen.log_likelihood - score) / chosen.log_likelihood_error)
        )
    mean_squares = np.mean(np.square(deviations), axis=0)
    # 95 % of chi-squared with 12 degrees of freedom, divided by 12, lies between 0.37 and 1.94
    assert np.all((mean_squares > 0.37) & (mean_squares < 1.94))


def test_up_to_five_thousand_distinct_rows_all_are_scored() -> None:
    rows = clustered(1000, 2)
    few, many = select_bandwidth(rows), select_bandwidth(np.repeat(rows, 6, axis=0))
    assert few.rows_scored is many.rows_scored is None
    assert many.value == pytest.approx(few.value, rel=1e-9)


def test_just_above_nothing_jumps(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = clustered(3000, 3)
    exact = select_bandwidth(rows)
    monkeypatch.setattr("pipeline.choice.kernel.bandwidth.LIMIT", 2000)
    sampled = select_bandwidth(rows)
    assert sampled.rows_scored == 3000
    assert sampled.value_error == 0
    assert sampled.value == pytest.approx(exact.value, rel=2e-3)
    assert sampled.log_likelihood == pytest.approx(exact.log_likelihood, abs=0.05)


@pytest.mark.parametrize("features", [2, 4])
def test_no_order_and_no_scale_of_the_rows_matters(features: int) -> None:
    rows = clustered(7000, features)
    once = select_bandwidth(rows)
    assert select_bandwidth(np.random.default_rng(0).permutation(rows)) == once
    assert select_bandwidth(rows * 2.0**40).value == pytest.approx(once.value * 2.0**40, rel=1e-6)


def test_one_row_of_many_repetitions_beside_all_others() -> None:
    """Half of all rows are one and the same: it weighs as much as all others and never scores itself."""
    rows = clustered(6000, 2)
    chosen = select_bandwidth(np.vstack([rows, np.repeat(rows[:1], 6000, axis=0)]))
    sigma, _ = from_all(np.vstack([rows, np.repeat(rows[:1], 6000, axis=0)]), chosen.value)
    assert abs(chosen.value - sigma) < 3 * chosen.value_error


def test_far_outliers_are_neither_lost_nor_slow() -> None:
    """Out of every kernel's reach: their logs of -1e6 and less decide."""
    rows = np.vstack([clustered(6000, 2), [[40.0, 3.0], [41.0, -3.0], [-50.0, 20.0]]])
    chosen = select_bandwidth(rows)
    sigma, _ = from_all(rows, chosen.value)
    assert chosen.value == pytest.approx(sigma, abs=3 * chosen.value_error + 2e-3 * sigma)


def test_beyond_reach() -> None:
    rows = np.random.default_rng(0).random((30_001, 1))
    for method in ("k-fold", "literal"):
        with pytest.raises(ArgumentError, match=rf"30001 distinct rows, and method '{method}'.*use 'leave-one-out'"):
            select_bandwidth(rows, method)


def test_rows_closer_than_squares_can_tell_are_refused() -> None:
    with pytest.raises(BandwidthError, match="scale the features up"):
        select_bandwidth(np.arange(6000.0)[:, None] * 1e-170)


def test_bandwidths_scored_two_at_a_time_are_those_scored_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, asked = clustered(20_000, 2), []

    def alone(threads: int) -> ThreadPoolExecutor:
        asked.append(threads)
        return ThreadPoolExecutor(1)

    together = select_bandwidth(rows)
    monkeypatch.setattr(sampled_sums, "ThreadPoolExecutor", alone)
    assert select_bandwidth(rows) == together
    assert set(asked) == {2}
