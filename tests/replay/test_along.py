from __future__ import annotations

import numpy as np
import pytest

from pipeline.replay import Scene, bind_features, body_positions
from pipeline.replay.along import along

SPECS = {
    "effort": {"kind": "efficiency"},
    "height": {"kind": "height", "above": "bin"},
    "far": {"kind": "distance", "object": "bin"},
    "clear": {"kind": "clearance", "over": "bench"},
    "haste": {"kind": "speed"},
    "jerk": {"kind": "jerk"},
}


@pytest.fixture
def waypoints() -> np.ndarray:
    return np.random.default_rng(4).uniform(-1, 1, (3, 7, 3))


def test_each_waypoint_has_its_part(gantry: Scene, waypoints: np.ndarray) -> None:
    features = bind_features(gantry, SPECS)
    found, whole = along(features, waypoints), features.evaluate(waypoints)
    assert found.shape == (3, 7, 6)
    steps = (np.diff(waypoints, axis=1) ** 2).sum(axis=2)
    np.testing.assert_allclose(found[:, 1:, 0], steps)
    hook, bin_ = (body_positions(gantry, waypoints, [name])[name] for name in ("hook", "bin"))
    np.testing.assert_allclose(found[:, 1:, 1], (hook - bin_)[:, 1:, 2])
    assert np.isnan(found[:, 0, :2]).all()  # the robot is there before it moves
    np.testing.assert_allclose(found[:, :, 2], np.linalg.norm(hook - bin_, axis=2))
    for column, joined in ((0, np.nansum), (1, np.nansum), (2, np.mean), (3, np.min)):
        np.testing.assert_allclose(joined(found[:, :, column], axis=1), whole[:, column])


def test_what_no_waypoint_has_by_itself_is_not_made_up(gantry: Scene, waypoints: np.ndarray) -> None:
    found = along(bind_features(gantry, SPECS), waypoints)
    assert np.isnan(found[:, :, 4:]).all()  # a speed and a third derivative


def test_a_feature_by_itself_is_as_among_others(gantry: Scene, waypoints: np.ndarray) -> None:
    features = bind_features(gantry, SPECS)
    for column, name in enumerate(features.names):
        one = features.only(column)
        assert (one.names, one.units) == ((name,), (features.units[column],))
        np.testing.assert_array_equal(one.evaluate(waypoints)[:, 0], features.evaluate(waypoints)[:, column])
