"""What explored draws foretell, shown by the trajectories that stand for the cells."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.answers.predictions import Offer, feature_rows, likely_rows, log_mass_of_cells, motion_rows
from pipeline.choice.explored import Region
from pipeline.choice.prediction import most_probable, predicted_interval


def test_the_weight_of_draws_goes_to_the_nearest_cell() -> None:
    draws = Region(np.array([[0.1], [0.2], [0.9], [0.6]]), np.log([0.1, 0.2, 0.3, 0.4]))
    found = log_mass_of_cells(draws, np.array([[0.0], [5.0], [1.0]]))
    np.testing.assert_allclose(np.exp(found), [0.3, 0.0, 0.7])
    far = Region(draws.features, draws.log_w - 2000)
    np.testing.assert_allclose(log_mass_of_cells(far, np.array([[0.0], [1.0]])) + 2000, np.log([0.3, 0.7]))


def test_rows_of_an_offer_are_those_of_the_plain_functions() -> None:
    rng = np.random.default_rng(0)
    scaled, positions, p = rng.random((300, 2)), rng.random((300, 4, 3)), rng.dirichlet(np.ones(300))
    offer = Offer(rng.random((300, 4, 2)), 3 * scaled, scaled, positions, np.zeros(300))
    features = predicted_interval(offer.raw, p)
    np.testing.assert_array_equal(feature_rows(["a", "b"], offer, p)["high"], features.upper)
    tube = predicted_interval(positions, p)
    np.testing.assert_array_equal(motion_rows(offer, p)["median"].to_numpy(), tube.median)
    likely = most_probable(scaled, p, 5, 0.1)
    rows = likely_rows(offer, p)
    assert rows["probability"].to_list() == pytest.approx(likely.probability)
    np.testing.assert_array_equal(rows["waypoints"].to_numpy(), offer.waypoints[likely.rows])
