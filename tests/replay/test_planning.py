"""Paths are planned for features: the registry's own, of every kind."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import ParameterError
from pipeline.replay.planning import Planning, planned_paths
from pipeline.replay.room import Room
from pipeline.replay.scene import Scene
from pipeline.trajectories.optimise import Search, optimise_paths
from pipeline.trajectories.paths import Anchor, straight_path
from pipeline.trajectories.samplers import Deformation

T = 11
ENDS = Anchor(np.array([0.0, -0.8, 0.2]), np.array([0.9, 0.9, 0.6]))
KINDS = {
    "steps": {"kind": "efficiency"},
    "over bin": {"kind": "height", "above": "bin"},
    "close": {"kind": "proximity", "object": "bin", "radius_m": 0.9},
    "way": {"kind": "path_length"},
    "lean": {"kind": "tilt", "body": "hook"},
}


def planning(scene: Scene, preferences: dict[str, dict[str, object]], **room: object) -> Planning:
    asked = {"surface": None, "collisions": False, "anchor": ENDS, "whose": "nobody"} | room
    return Planning.of(Room.of(scene, **asked), preferences, T)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_can_be_planned_for(gantry: Scene, name: str) -> None:
    """Plans for one feature alone have less of it than the straight path, or, of steps, as little."""
    plan = planning(gantry, {name: KINDS[name]})
    scales = plan.scales(np.random.default_rng(0))
    best = optimise_paths(
        [np.random.default_rng(1)], ENDS, np.ones((1, 1)), plan.scaled(scales),
        lower=gantry.lower, upper=gantry.upper, n_waypoints=T, search=Search(iterations=40),
    )  # fmt: skip
    straight = plan.scaled(scales)(straight_path(ENDS, T)[None])[0].item()
    if name == "steps":
        assert best.costs[0] == pytest.approx(straight, rel=0.02)
    else:
        assert best.costs[0] < 0.98 * straight


def test_terms_are_those_of_the_features(gantry: Scene) -> None:
    plan = planning(gantry, KINDS)
    paths = straight_path(ENDS, T) + 0.1 * np.random.default_rng(2).normal(size=(7, T, 3))
    terms, clear = plan.assess(paths)
    np.testing.assert_array_equal(terms, plan.preferences.evaluate(paths))
    assert clear.all()
    assert plan.preferences.names == tuple(KINDS)


def test_an_unknown_kind_is_refused_under_its_own_name(gantry: Scene) -> None:
    with pytest.raises(
        ParameterError, match=r"^preferences\.p\.kind is 'haste'; allowed are clearance, contact, distance"
    ):
        planning(gantry, {"p": {"kind": "haste"}})


def test_what_does_not_vary_is_not_planned_for_and_named(gantry: Scene) -> None:
    """Far from the bin nothing is close to it: that term has no effect on the plans, whatever its weight."""
    far = {
        "steps": KINDS["steps"],
        "far": {"kind": "proximity", "object": "parcel", "radius_m": 0.5},
        "over": KINDS["over bin"],
    }
    plan = planning(gantry, far)
    scales = plan.scales(np.random.default_rng(0))
    assert np.isinf(scales).tolist() == [False, True, False]
    assert plan.unvaried(scales) == ("far",)
    paths, unvaried = planned_paths(plan, 4, 7, "test")
    assert unvaried == ("far",)
    assert np.isfinite(paths).all()
    weights = np.array([[0.5, 0.1, 0.5], [0.5, 100.0, 0.5]])
    rngs = [np.random.default_rng(3), np.random.default_rng(3)]
    one, other = plan.optimised(rngs, weights, scales)
    np.testing.assert_array_equal(one, other)
    # where nothing varies at all, any admissible path will do
    only = planning(gantry, {"far": far["far"]})
    assert np.isfinite(only.optimised([np.random.default_rng(0)], np.ones((1, 1)), np.array([np.inf]))).all()


def test_of_a_wish_plans_have_much(gantry: Scene) -> None:
    """Under a weight on clearance alone, what the planner minimises falls where clearance rises."""
    plan = planning(gantry, {"clear": {"kind": "clearance", "over": "bin"}})
    paths = plan.room.draw(Deformation(), np.random.default_rng(0), 20, T).waypoints
    clearance, _ = plan.assess(paths)
    cost, _ = plan.scaled(np.array([0.5]))(paths)
    np.testing.assert_array_equal(cost, -clearance / 0.5)
