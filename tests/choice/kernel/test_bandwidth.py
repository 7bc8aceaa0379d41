from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import GridSearchCV
from sklearn.neighbors import KernelDensity

from pipeline.choice import BandwidthWarning, select_bandwidth
from pipeline.choice.kernel import pairwise_likelihood
from pipeline.errors import ArgumentError, BandwidthError
from tests.oracles import slow_choice


@pytest.fixture
def tied() -> np.ndarray:
    """90 rows of three features, a third of them repetitions."""
    rng = np.random.default_rng(5)
    rows = rng.gamma(2.0, size=(60, 3))
    return rng.permutation(np.vstack([rows, rows[:30]]))


def test_two_rows_closed_form() -> None:
    """The score -F log s - d^2 / 2 s^2 of each of two rows is largest at s = d / sqrt(F)."""
    chosen = select_bandwidth([[0.0, 0.0, 1.0], [3.0, 4.0, 1.0]])
    assert chosen.value == pytest.approx(5 / math.sqrt(3), rel=1e-10)
    assert chosen.log_likelihood == pytest.approx(
        2 * (-3 * math.log(chosen.value * math.sqrt(2 * math.pi)) - 25 / (2 * chosen.value**2)), rel=1e-12
    )
    assert (chosen.method, chosen.converged) == ("leave-one-out", True)


def test_leave_one_out_is_the_slow_loop_and_its_maximum(tied: np.ndarray) -> None:
    chosen = select_bandwidth(tied)
    assert chosen.log_likelihood == pytest.approx(slow_choice.leave_one_out_score(tied, chosen.value), rel=1e-12)
    elsewhere = [slow_choice.leave_one_out_score(tied, chosen.value * f) for f in (0.5, 0.9, 0.999, 1.001, 1.1, 2)]
    assert max(elsewhere) < chosen.log_likelihood


def test_ties_do_not_pull_the_bandwidth_to_zero() -> None:
    """10 x 10 integer lattice, each point five times: the nearest other row is at distance 1."""
    lattice = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0)), axis=-1).reshape(-1, 2)
    once, often = select_bandwidth(lattice), select_bandwidth(np.tile(lattice, (5, 1)))
    assert once.value > 0.4
    assert often.value == pytest.approx(once.value, rel=1e-9)


def test_k_fold_is_the_grid_search_of_scikit_learn(tied: np.ndarray) -> None:
    """GridSearchCV over KernelDensity on the same folds: each distinct row in lexicographic order, dealt to 5."""
    chosen = select_bandwidth(tied, "k-fold")
    distinct, index = np.unique(tied, axis=0, return_inverse=True)
    folds = (np.arange(len(distinct)) % 5)[index.ravel()]
    splits = [(np.flatnonzero(folds != f), np.flatnonzero(folds == f)) for f in range(5)]
    grid = chosen.value * np.array([0.8, 0.95, 0.999, 1.0, 1.001, 1.05, 1.2])
    search = GridSearchCV(KernelDensity(rtol=0, atol=0), {"bandwidth": grid}, cv=splits).fit(tied)
    assert search.best_params_["bandwidth"] == chosen.value
    # best_score_ is the mean over folds of each fold's total log likelihood.
    assert chosen.log_likelihood == pytest.approx(5 * search.best_score_, rel=1e-10)


def test_k_fold_of_fewer_rows_than_folds_is_leave_one_out() -> None:
    rows = [[0.0, 1.0], [2.0, 2.0], [2.5, 1.0]]
    assert select_bandwidth(rows, "k-fold").value == select_bandwidth(rows).value


def test_literal_lands_on_its_lower_bound_and_says_so() -> None:
    rows = np.array([[0.0, 0.0], [3.0, 4.0], [30.0, 0.0], [30.0, 0.0]])
    with pytest.warns(BandwidthWarning, match="lower bound 5,"):
        chosen = select_bandwidth(rows, "literal")
    assert (chosen.value, chosen.method, chosen.converged) == (5.0, "literal", False)
    assert chosen.log_likelihood == pytest.approx(slow_choice.literal_score(rows, 5.0), rel=1e-12)


def test_literal_with_an_inner_maximum() -> None:
    """In six dimensions kernel sums fall faster than one 1-D normaliser makes up for."""
    rows = np.random.default_rng(2).normal(size=(80, 6))
    chosen = select_bandwidth(rows, "literal")
    assert chosen.converged
    assert chosen.log_likelihood == pytest.approx(slow_choice.literal_score(rows, chosen.value), rel=1e-12)
    for factor in (0.5, 0.99, 1.01, 2.0):
        assert slow_choice.literal_score(rows, chosen.value * factor) < chosen.log_likelihood


@pytest.mark.parametrize("seed", [28, 50, 53, 81])
def test_two_stationary_points_within_one_step_of_the_grid(seed: int) -> None:
    """A minimum lies beside the maximum, so that the slope has one sign at both ends of the first bracket."""
    rows = np.random.default_rng(seed).normal(size=(6, 2))
    distances = np.linalg.norm(rows[:, None] - rows, axis=-1)
    scan = np.geomspace(distances[distances > 0].min(), distances.max(), 300)
    chosen = select_bandwidth(rows, "literal")
    assert chosen.log_likelihood >= max(slow_choice.literal_score(rows, sigma) for sigma in scan)


def test_a_number_is_itself() -> None:
    chosen = select_bandwidth([[1.0]], 0.25)
    assert (chosen.value, chosen.log_likelihood, chosen.method, chosen.converged) == (0.25, None, "fixed", True)


def test_the_higher_of_two_maxima() -> None:
    """Pairs 1e-3 apart, the pairs themselves 1 apart: a maximum at the scale of each."""
    for pairs in (3, 12):
        centres = np.arange(float(pairs))[:, None]
        rows = np.vstack([centres, centres + 1e-3, centres[:1] + 0.31])
        chosen = select_bandwidth(rows)
        scan = np.geomspace(1e-4, 100, 120)
        scores = [slow_choice.leave_one_out_score(rows, sigma) for sigma in scan]
        assert chosen.log_likelihood >= max(scores)
        assert chosen.value == pytest.approx(scan[np.argmax(scores)], rel=0.12)


def test_blocks_give_the_same_bandwidth(tied: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = select_bandwidth(tied), select_bandwidth(tied, "k-fold")
    monkeypatch.setattr(pairwise_likelihood, "_KEPT_ROWS", 0)
    monkeypatch.setattr(pairwise_likelihood, "_BLOCK_PAIRS", 500)
    blocked = select_bandwidth(tied), select_bandwidth(tied, "k-fold")
    for one, other in zip(kept, blocked, strict=True):
        assert other.value == pytest.approx(one.value, rel=1e-10)
        assert other.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-12)


@given(
    rows=st.lists(st.tuples(*[st.integers(-5, 5)] * 2), min_size=2, max_size=30).filter(lambda r: len(set(r)) > 1),
    log_scale=st.floats(-8, 8),
    method=st.sampled_from(["leave-one-out", "k-fold"]),
)
def test_scales_with_the_features_and_is_a_maximum(rows: list, log_scale: float, method: str) -> None:
    rows = np.array(rows, dtype=float)
    chosen = select_bandwidth(rows, method)
    assert select_bandwidth(rows * 10**log_scale, method).value == pytest.approx(chosen.value * 10**log_scale, rel=1e-8)
    if method == "leave-one-out":
        scan = chosen.value * np.geomspace(0.2, 5, 21)
        assert max(slow_choice.leave_one_out_score(rows, sigma) for sigma in scan) <= chosen.log_likelihood + 1e-9


@pytest.mark.parametrize("method", ["leave-one-out", "k-fold", "literal"])
@pytest.mark.parametrize("rows", [[[1.0, 2.0]], [[1.0, 2.0]] * 5])
def test_one_distinct_row_is_refused(rows: list, method: str) -> None:
    with pytest.raises(BandwidthError, match="at least two distinct rows") as caught:
        select_bandwidth(rows, method)
    assert caught.value.estimate is None


def test_rows_closer_than_squares_can_tell_are_refused() -> None:
    with pytest.raises(BandwidthError, match="scale the features up"):
        select_bandwidth([[0.0], [1e-170]])


@pytest.mark.parametrize(
    ("method", "message"),
    [("silverman", "k-fold, leave-one-out, literal"), (0.0, "method is 0.0"), (True, "method is True")],
)
def test_unknown_methods_are_refused(method: str | float, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        select_bandwidth([[0.0], [1.0]], method)


def test_clusters_1e8_apart() -> None:
    """Each cluster scores itself: the same bandwidth, up to how often the rows score at all, as one cluster."""
    cluster = np.random.default_rng(1).normal(size=(30, 2))
    far = select_bandwidth(np.vstack([cluster, cluster + 1e8]))
    assert far.value == pytest.approx(select_bandwidth(cluster).value, rel=1e-6)
