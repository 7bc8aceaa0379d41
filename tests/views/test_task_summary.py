from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice import log_density, theta_grid
from pipeline.errors import ArgumentError
from pipeline.views.task_summary import (
    density_1d,
    density_curve,
    density_map,
    feature_grid,
    replay_samples,
    theta_labels,
    theta_meaning,
)


def test_one_value_gives_the_normal_density():
    density = density_1d(np.array([2.0]), np.array([2.0, 2.5]), 0.5)
    peak = 1 / (0.5 * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(density, [peak, peak * np.exp(-0.5)], rtol=1e-14)


def test_weights_count_relative_to_each_other_and_do_not_overflow():
    values, grid = np.array([0.0, 10.0]), np.array([0.0, 10.0])
    log_weights = np.array([1000.0, 1000.0 + np.log(3.0)])
    peak = 1 / np.sqrt(2 * np.pi)
    np.testing.assert_allclose(density_1d(values, grid, 1.0, log_weights), [peak / 4, 3 * peak / 4], rtol=1e-12)


def test_both_densities_integrate_to_one_and_less_is_flatter():
    rng = np.random.default_rng(1)
    values = np.concatenate([rng.normal(0, 0.1, 900), rng.uniform(-1, 3, 100)])
    less = -log_density(values[:, None], 0.1)
    curve = density_curve("height", "m", values, np.array([0.5]), 0.1, less)
    step = curve.grid[1] - curve.grid[0]
    # two bandwidths beyond the outermost value, less than 2.3 % of that one value's mass is left out on each side
    assert np.sum(curve.raw) * step == pytest.approx(1.0, abs=1e-3)
    assert np.sum(curve.adjusted) * step == pytest.approx(1.0, abs=1e-2)
    assert curve.adjusted.max() < curve.raw.max() / 3
    assert curve.demonstrations.tolist() == [0.5]


def test_the_sum_over_blocks_is_the_sum_over_all():
    values = np.random.default_rng(2).normal(size=30_000)
    grid = np.linspace(-3, 3, 200)  # 6 million elements: more than one block
    direct = np.array([np.exp(-0.5 * ((x - values) / 0.3) ** 2).mean() for x in grid]) / (0.3 * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(density_1d(values, grid, 0.3), direct, rtol=1e-12)


def test_the_map_agrees_with_the_density_that_less_divides_by():
    rng = np.random.default_rng(3)
    features, bandwidth = rng.normal(size=(400, 2)) * [1.0, 20.0], 0.2
    scale = np.ptp(features, axis=0)
    drawn = density_map(("a", "b"), ("m", "rad"), features, features[:3], bandwidth * scale, (9, 7))
    assert drawn.density.shape == (7, 9)
    cells = np.stack(np.meshgrid(drawn.x, drawn.y), axis=-1).reshape(-1, 2)
    kernel_sum = np.exp(log_density(features / scale, bandwidth, at=cells / scale, engine="exact"))
    expected = kernel_sum / (400 * 2 * np.pi * np.prod(bandwidth * scale))
    np.testing.assert_allclose(drawn.density.ravel(), expected, rtol=1e-10)


def test_a_grid_covers_alternatives_and_demonstrations():
    grid = feature_grid(np.array([0.0, 1.0]), np.array([3.0]), 0.5, 11)
    assert (grid[0], grid[-1], grid.size) == (0.0, 4.0, 11), "no trajectory is below zero"
    grid = feature_grid(np.array([-3.0, -0.1]), np.array([-1.0]), 0.5, 11)
    assert (grid[0], grid[-1]) == (-4.0, 0.0)
    grid = feature_grid(np.array([-0.01, 1.0]), np.array([3.0]), 0.5, 11)
    assert (grid[0], grid[-1], grid.size) == (-1.01, 4.0, 11)


def test_labels_of_the_grid_are_short_and_all_different():
    thetas = theta_grid([[0, 0.5, 1]] * 3)
    labels = theta_labels(thetas, ["efficiency", "table", "laptop"])
    assert len(set(labels)) == 19
    by_label = dict(zip(labels, thetas, strict=True))
    np.testing.assert_allclose(by_label["efficiency + ½ table"], np.array([-1, -0.5, 0]) / np.sqrt(1.25))
    assert theta_meaning(thetas) == "cost weights, relative to the largest"


def test_rewards_and_costs_in_one_vector_keep_their_signs():
    thetas = np.array([[1.0, -1.0], [-0.25, 1.0], [0.0, -0.3], [0.7, 1.0], [0.0, 0.0]])
    assert theta_labels(thetas, ["x", "y"]) == ("x − y", "−¼ x + y", "−y", "0.7 x + y", "nothing")
    assert theta_meaning(thetas).startswith("reward weights")


def test_directions_that_repeat_are_told_apart():
    assert theta_labels(np.array([[-1.0, 0.0], [-2.0, 0.0]]), ["x", "y"]) == ("x 1 y 0", "x 2 y 0")


def test_replay_runs_at_recorded_speed_through_every_waypoint():
    demonstrations = np.arange(2 * 3 * 1, dtype=float).reshape(2, 3, 1) ** 2  # 0 1 4, 9 16 25
    configurations, time_s, which = replay_samples(demonstrations, np.array([2.0, 4.0]), steps=2, pause_s=0.5)
    np.testing.assert_allclose(configurations[:, 0], [0, 0.5, 1, 2.5, 4, 9, 12.5, 16, 20.5, 25])
    np.testing.assert_allclose(time_s, [0, 0.5, 1, 1.5, 2, 2.5, 3.5, 4.5, 5.5, 6.5])
    assert which.tolist() == [0] * 5 + [1] * 5


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: density_1d(np.ones(2), np.ones(2), 0.0), "bandwidth must be a positive"),
        (lambda: density_1d(np.ones(2), np.ones(2), 1.0, np.ones(3)), r"log_weights must be \(2,\)"),
        (lambda: theta_labels(np.ones((2, 3)), ["x", "y"]), r"thetas must be \(K, 2\)"),
        (lambda: replay_samples(np.ones((2, 3, 1)), np.array([1.0, 0.0])), "durations_s must be 2 positive"),
    ],
)
def test_what_cannot_be_meant_is_refused(call, match):
    with pytest.raises(ArgumentError, match=match):
        call()
