from __future__ import annotations

import numpy as np
import pytest

from pipeline.views.feature_axis import feature_axis


@pytest.mark.parametrize(
    ("over_time", "label", "shown"),
    [
        ("sum", "table (m, mean per waypoint)", [0.25, 0.5]),
        ("mean", "table (m, mean)", [10.0, 20.0]),
        ("least", "table (m, least)", [10.0, 20.0]),
        ("greatest", "table (m, greatest)", [10.0, 20.0]),
    ],
)
def test_sums_are_shown_as_means_and_all_else_as_it_is(over_time: str, label: str, shown: list[float]) -> None:
    axis = feature_axis("table", "m", over_time, 41)
    assert axis.label == label
    np.testing.assert_allclose(axis.shown([10.0, 20.0]), shown)


def test_units_are_raised_and_one_waypoint_divides_by_nothing() -> None:
    axis = feature_axis("efficiency", "rad^2", "sum", 1)
    assert axis.label == "efficiency (rad², mean per waypoint)"
    assert axis.shown(3.0) == 3.0
