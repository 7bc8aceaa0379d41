import numpy as np
import pytest

from pipeline.choice.reweighting import base_weights
from pipeline.errors import ArgumentError


def gaussian_draws(shifts: list[float], count: int, seed: int = 0) -> np.ndarray:
    """Under a standard normal, exp(omega x) tilts to a normal around omega."""
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.normal(shift, 1.0, (count, 1)) for shift in shifts])


def test_a_tilted_normal_has_half_the_square_as_its_log_normaliser() -> None:
    shifts = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    omegas = np.array(shifts)[:, None]
    weights = base_weights(gaussian_draws(shifts, 4000), omegas, np.full(6, 4000))
    np.testing.assert_allclose(weights.log_normalisers, np.array(shifts) ** 2 / 2, atol=0.08)
    np.testing.assert_allclose(weights.log_normaliser([[2.5], [4.7]]), [2.5**2 / 2, 4.7**2 / 2], atol=0.08)
    tail = weights.features[:, 0] > 4  # P(x > 4) = 3.17e-5: no draw of the base measure itself gets there
    assert np.exp(weights.log_w[tail]).sum() == pytest.approx(3.167e-5, rel=0.1)


def test_without_tilts_every_draw_weighs_the_same_and_the_first_guess_does_not_matter() -> None:
    rows = gaussian_draws([0.0, 1.0], 500)
    np.testing.assert_allclose(base_weights(rows, [[0.0]], [1000]).log_w, -np.log(1000))
    near = base_weights(rows, [[0.0], [1.0]], [500, 500])
    far = base_weights(rows, [[0.0], [1.0]], [500, 500], start=[0.0, 30.0])
    np.testing.assert_allclose(near.log_w, far.log_w, atol=1e-6)


def test_normalisers_solve_the_equations() -> None:
    omegas = np.array([[0.0], [0.5], [1.5]])
    weights = base_weights(gaussian_draws([0.0, 0.5, 1.5], 300), omegas, [300, 300, 300])
    np.testing.assert_allclose(weights.log_normaliser(omegas), weights.log_normalisers, atol=1e-6)


def test_thinning_keeps_every_tilt() -> None:
    weights = base_weights(gaussian_draws([0.0, 1.0], 1000), [[0.0], [1.0]], [1000, 1000], most_rows=300)
    assert len(weights.features) <= 300
    assert weights.log_normalisers[1] == pytest.approx(0.5, abs=0.2)


def test_effective_size_falls_where_nothing_was_drawn() -> None:
    weights = base_weights(gaussian_draws([0.0, 1.0], 1000), [[0.0], [1.0]], [1000, 1000])
    inside, outside = weights.effective_sizes([[0.5], [8.0]])
    assert inside > 1000 > 50 > outside


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="first omega of zero"):
        base_weights([[0.0], [1.0]], [[1.0], [0.0]], [1, 1])
