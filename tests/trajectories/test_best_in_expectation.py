from __future__ import annotations

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.trajectories.best_in_expectation import Plan, bounded, plan_in_expectation, spread_rows
from pipeline.trajectories.optimise import Search
from pipeline.trajectories.paths import straight_path
from pipeline.trajectories.random_streams import child_rng
from tests.trajectories.test_optimise import ANCHOR, FREE, TARGET, J, T, anything, closed_form, costs

OMEGAS = -np.random.default_rng(0).gamma(4.0, 0.25, size=(200, 2))  # both features are costs
SHARE = np.random.default_rng(1).random(200)


def planned(omegas: FloatArray = OMEGAS, weights: FloatArray = SHARE, admissible=anything, draws: int = 3) -> Plan:
    rngs = [child_rng(0, "plan", row) for row in range(2 + draws)]
    return plan_in_expectation(
        rngs, ANCHOR, omegas, weights, lambda w: (costs(w), admissible(w)),
        lower=-FREE, upper=FREE, n_waypoints=T, restarts=2, search=Search(iterations=150),
    )  # fmt: skip


def test_it_is_the_optimum_of_the_mean_weights() -> None:
    plan = planned()
    mean = SHARE @ OMEGAS / SHARE.sum()
    best = closed_form(-mean, Search().modes)
    assert best * (1 - 1e-12) <= -plan.expected_reward <= best * 1.01
    # the expectation of the reward over the draws is the reward of the mean
    assert plan.expected_reward == pytest.approx(SHARE @ (OMEGAS @ plan.features) / SHARE.sum())
    np.testing.assert_allclose(plan.features, costs(plan.waypoints[None])[0])


def test_regret_is_what_a_draws_own_best_would_gain() -> None:
    plan = planned()
    assert plan.regret.min() >= 0
    assert plan.expected_regret == pytest.approx(SHARE @ plan.regret / SHARE.sum())
    for row, features in zip(plan.searched, plan.alternative_features, strict=True):
        omega = OMEGAS[row]
        assert plan.regret[row] == pytest.approx(features @ omega - plan.features @ omega)
        assert -features @ omega <= closed_form(-omega, Search().modes) * 1.01


def test_one_certain_draw_leaves_nothing_to_regret() -> None:
    plan = planned(OMEGAS[:1], np.ones(1), draws=2)
    assert plan.expected_regret == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(plan.change, 0, atol=1e-12)


def test_the_scale_of_the_weights_does_not_matter() -> None:
    np.testing.assert_allclose(planned(OMEGAS * 7).waypoints, planned().waypoints)


def test_ends_limits_scene_and_choice_space_hold() -> None:
    plan = planned(admissible=lambda w: w[:, T // 2, 0] < 1.4)
    np.testing.assert_array_equal(plan.waypoints[[0, -1]], [ANCHOR.start, ANCHOR.goal])
    assert plan.waypoints[T // 2, 0] < 1.4
    assert plan.inadmissible > 0
    box = bounded(lambda w: (costs(w), anything(w)), np.zeros(2), np.array([0.5, 5.0]))
    wasteful = np.array([[2.0, 0.0]])  # more squared steps are better: without the box there is no best
    found = plan_in_expectation(
        [child_rng(0, "waste")], ANCHOR, wasteful, np.ones(1), box,
        lower=-FREE, upper=FREE, n_waypoints=T, restarts=1, search=Search(iterations=60),
    )  # fmt: skip
    assert 0.4 < found.features[0] <= 0.5


def test_a_known_path_that_is_better_wins_if_it_is_allowed() -> None:
    rngs, mean = [child_rng(0, "plan")], np.array([[-0.001, -1.0]])
    known = np.stack([straight_path(ANCHOR, T)] * 2)
    known[0, T // 2], known[1, T // 2] = TARGET, TARGET  # a jump that costs next to nothing here
    known[1, 3, 0] = 99.0

    def assess(waypoints: FloatArray) -> tuple[FloatArray, FloatArray]:
        return costs(waypoints), waypoints[:, 3, 0] < 50

    found = plan_in_expectation(
        rngs, ANCHOR, mean, np.ones(1), assess,
        lower=-FREE, upper=FREE, n_waypoints=T, candidates=known, restarts=1, search=Search(iterations=2),
    )  # fmt: skip
    np.testing.assert_array_equal(found.waypoints, known[0])


def test_rows_are_spread_over_the_belief() -> None:
    line = np.linspace(-1, 1, 101)[:, None] * [1.0, 0.2]
    np.testing.assert_array_equal(spread_rows(line, np.ones(101), 4), [12, 37, 63, 88])
    only = spread_rows(line, np.eye(101)[40], 3)
    np.testing.assert_array_equal(only, [40, 40, 40])
    assert spread_rows(line, np.ones(101), 0).size == 0


@pytest.mark.parametrize(
    ("omegas", "weights", "restarts"),
    [(OMEGAS, SHARE[:3], 1), (OMEGAS, -SHARE, 1), (OMEGAS[0], SHARE, 1), (OMEGAS, SHARE, 0), (OMEGAS, SHARE, 4)],
)
def test_refusals(omegas, weights, restarts) -> None:
    with pytest.raises(ArgumentError):
        plan_in_expectation(
            [child_rng(0)] * 3, ANCHOR, omegas, weights, lambda w: (costs(w), anything(w)),
            lower=np.full(J, -np.inf), upper=FREE, n_waypoints=T, restarts=restarts,
        )  # fmt: skip
