"""What a joining trajectory does to LESS's weights: those of the set with one more row, from the slow loops."""

import numpy as np
import pytest

from pipeline.choice import log_density
from pipeline.choice.kernel.join import join, own_log_weights
from tests.oracles import slow_choice

RNG = np.random.default_rng(7)
ROWS, POINTS, SIGMA = RNG.normal(size=(40, 2)), RNG.normal(size=(3, 2)), 0.4


def test_weights_are_those_of_the_set_with_one_more_row() -> None:
    log_w, log_sums = join(ROWS, log_density(ROWS, SIGMA), POINTS, SIGMA)
    for joined, own, point in zip(log_w, own_log_weights(log_sums), POINTS, strict=True):
        slow = slow_choice.less(SIGMA)([*map(tuple, ROWS), tuple(point)])
        np.testing.assert_allclose([*joined, own], slow, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("cut", [1, 17])
def test_parts_add_up(cut: int) -> None:
    density = log_density(ROWS, SIGMA)
    whole, whole_sums = join(ROWS, density, POINTS, SIGMA)
    parts = [join(ROWS[part], density[part], POINTS, SIGMA) for part in (slice(cut), slice(cut, None))]
    np.testing.assert_allclose(np.concatenate([log_w for log_w, _ in parts], axis=1), whole, rtol=1e-14)
    np.testing.assert_allclose(np.logaddexp(parts[0][1], parts[1][1]), whole_sums, rtol=1e-13)


def test_a_trajectory_out_of_reach_changes_nothing() -> None:
    density = log_density(ROWS, SIGMA)
    log_w, log_sums = join(ROWS, density, np.array([[1e3, 0.0]]), SIGMA)
    np.testing.assert_array_equal(log_w[0], -density)
    assert own_log_weights(log_sums).tolist() == [0.0]
