from __future__ import annotations

import json

import numpy as np

from pipeline.views.truth import known_truth

THETAS = np.array([[-1.0, 0.0], [0.0, -1.0], [0.0, 0.0], [-1.0, -1.0]])
SCALE = np.array([1.0, 10.0])


def stated(x: float, y: float) -> str:
    return json.dumps({"x": x, "y": y, "what the robot does not see": -3.0})


def test_the_truth_is_the_mean_direction_on_scaled_features_and_has_a_nearest_hypothesis() -> None:
    truth = known_truth([stated(-1.0, -0.1), stated(-2.0, 0.0)], ("x", "y"), SCALE, THETAS)
    assert truth is not None
    half = np.sqrt(0.5)
    np.testing.assert_allclose(truth.people, [[-half, -half], [-1.0, 0.0]])
    np.testing.assert_allclose(truth.mean, np.array([-1 - half, -half]) / np.hypot(1 + half, half))
    assert truth.nearest in (0, 3)  # half way between them, at 22.5 degrees
    np.testing.assert_allclose(np.degrees(truth.apart_rad), 22.5)


def test_it_is_not_known_unless_everybody_says_it() -> None:
    one = stated(-1.0, 0.0)
    for texts in ([], [None, None], [one, None], [one, stated(0.0, 0.0)], [one, stated(1.0, 0.0)]):
        assert known_truth(texts, ("x", "y"), SCALE, THETAS) is None
