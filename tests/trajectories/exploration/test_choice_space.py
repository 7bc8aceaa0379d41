import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.exploration.choice_space import ChoiceSpace, default_effort_multiple, default_width
from pipeline.trajectories.measures import squared_steps
from pipeline.trajectories.paths import straight_path
from tests.support.toy_space import ANCHOR, WAYPOINTS, assess, toy_space


def coefficients(space: ChoiceSpace, count: int = 50) -> np.ndarray:
    return np.random.default_rng(0).standard_normal((count, space.modes, space.joints))


def test_effort_from_coefficients_is_that_of_the_path() -> None:
    space = toy_space()
    z = coefficients(space)
    np.testing.assert_allclose(space.effort(z), squared_steps(space.decode(z)), rtol=1e-13)


def test_decoding_is_the_sum_of_line_and_waves_and_encoding_undoes_it() -> None:
    space = toy_space()
    z = coefficients(space)
    paths = space.decode(z)
    np.testing.assert_allclose(paths, space.line + np.einsum("kt,nkj->ntj", space.basis, z), atol=1e-14)
    np.testing.assert_array_equal(paths[:, 0], np.tile(ANCHOR.start, (50, 1)))
    np.testing.assert_array_equal(paths[:, -1], np.tile(ANCHOR.goal, (50, 1)))
    np.testing.assert_allclose(space.encode(paths), z, atol=1e-12)


def test_a_path_whose_ends_are_elsewhere_is_encoded_by_its_shape() -> None:
    space = toy_space()
    z = coefficients(space)
    s = np.linspace(0, 1, WAYPOINTS)[None, :, None]
    np.testing.assert_allclose(space.encode(space.decode(z) + 0.2 - 0.3 * s), z, atol=1e-12)


def test_members_keep_effort_limits_and_speed_and_others_have_no_features() -> None:
    step = np.full(2, 0.12)
    space = ChoiceSpace(ANCHOR, WAYPOINTS, np.full(2, -0.6), np.full(2, 1.1), assess, 3.0, modes=3, largest_step=step)
    z = coefficients(space, 4000)
    features, inside = space.evaluate(z)
    paths = space.decode(z)
    expected = (squared_steps(paths) <= space.most_effort) & (paths >= -0.6).all(axis=(1, 2))
    expected &= (paths <= 1.1).all(axis=(1, 2)) & (np.abs(np.diff(paths, axis=1)) <= step).all(axis=(1, 2))
    np.testing.assert_array_equal(inside, expected)
    assert 0 < inside.sum() < len(z)
    np.testing.assert_array_equal(np.isnan(features).all(axis=1), ~inside)
    np.testing.assert_allclose(features[inside], assess(paths[inside])[0])


def test_base_draws_are_members_and_as_many_as_asked() -> None:
    space = toy_space(1.5)
    z, features = space.draw_base(np.random.default_rng(1), 300)
    assert len(z) == len(features) == 300
    assert space.evaluate(z)[1].all()


def test_default_bound_is_a_quarter_more_than_the_most_wasteful_demonstration() -> None:
    line = straight_path(ANCHOR, WAYPOINTS)
    bent = line + 0.3 * np.sin(np.pi * np.linspace(0, 1, WAYPOINTS))[:, None]
    ratio = squared_steps(bent[None])[0] / squared_steps(line[None])[0]
    bound = default_effort_multiple(np.stack([line, bent]))
    assert 1.25 * ratio <= bound < 1.25 * ratio + 0.1
    assert bound == round(bound, 1)
    assert default_width(np.stack([bent, bent])) == pytest.approx(np.sqrt(((bent - line) ** 2).mean()))


def test_refusals_name_the_argument() -> None:
    with pytest.raises(ArgumentError, match="effort_multiple is 1"):
        toy_space(1.0)
    with pytest.raises(ArgumentError, match="largest_step"):
        toy_space(largest_step=np.full(2, 0.01))
    with pytest.raises(ArgumentError, match="make the width smaller"):
        toy_space(1.0001).draw_base(np.random.default_rng(0), 5, attempts=2)
