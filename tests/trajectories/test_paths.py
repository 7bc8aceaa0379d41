import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pipeline.errors import ArgumentError
from pipeline.trajectories.paths import Anchor, natural_bump, sine_basis, straight_path, within_limits


def test_straight_path_has_even_steps_and_exact_ends() -> None:
    anchor = Anchor(np.array([0.1, -0.7]), np.array([0.3, 1.9]))
    line = straight_path(anchor, 41)
    assert np.array_equal(line[[0, -1]], [anchor.start, anchor.goal])
    assert np.allclose(np.diff(line, axis=0), (anchor.goal - anchor.start) / 40, rtol=0, atol=1e-15)


def test_sine_basis_has_unit_mean_square_and_vanishes_at_the_ends() -> None:
    basis = sine_basis(41, 5, 2.0)
    assert np.array_equal(basis[:, [0, -1]], np.zeros((5, 2)))
    assert (basis**2).sum(axis=0)[:-1].mean() == pytest.approx(1, abs=1e-12)  # trapezoid rule, exact for these waves
    assert np.allclose(np.abs(basis).max(axis=1)[[0, 2]] / basis[0].max(), [1, 1 / 9], rtol=1e-2)


def test_with_decay_one_squared_steps_are_isotropic() -> None:
    steps = np.diff(sine_basis(2001, 5, 1.0), axis=1)
    gram = steps @ steps.T
    assert np.allclose(gram / gram[0, 0], np.eye(5), atol=1e-4)  # discretisation: (pi k / 2000)^2 / 12 each


@pytest.mark.parametrize("peak", [0.2, 0.5, 0.83])
def test_natural_bump_is_the_natural_spline(peak: float) -> None:
    s = np.linspace(0, 1, 101)
    spline = CubicSpline([0, peak, 1], [0, 1, 0], bc_type="natural")
    assert np.allclose(natural_bump(s, np.array([[peak]]))[0], spline(s), rtol=0, atol=1e-13)


def test_within_limits_needs_every_waypoint_and_no_nan() -> None:
    paths = np.zeros((4, 3, 2))
    paths[1, 2, 0] = 1.1
    paths[2, 0, 1] = -1.1
    paths[3, 1, 1] = np.nan
    assert within_limits(paths, -np.ones(2), np.ones(2)).tolist() == [True, False, False, False]


def test_an_anchor_is_read_only_and_checked() -> None:
    anchor = Anchor([0.0, 1.0], [1.0, 2.0])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="read-only"):
        anchor.start[0] = 3.0
    with pytest.raises(ArgumentError, match="2 joints"):
        Anchor(np.zeros(2), np.zeros(3))
    with pytest.raises(ArgumentError, match="finite"):
        Anchor(np.zeros(2), np.array([0.0, np.nan]))


@pytest.mark.parametrize(("modes", "decay"), [(0, 1.0), (40, 1.0), (3, -1.0), (3, np.inf)])
def test_a_basis_that_cannot_be_is_refused(modes: int, decay: float) -> None:
    with pytest.raises(ArgumentError):
        sine_basis(41, modes, decay)
