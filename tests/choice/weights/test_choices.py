from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice import LESS, AttributeRule, Boltzmann, log_likelihood
from pipeline.choice.explored import Region, region_log_likelihood
from pipeline.choice.weights import Choices
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(6)
ALTERNATIVES, OUTSIDE = RNG.random((40, 3)) + 5, RNG.random((4, 3)) + 5
OMEGAS = RNG.normal(size=(7, 3)) * 6
MODELS = [Boltzmann(), LESS(0.15), AttributeRule()]


def choices(model, joins: bool) -> Choices:
    if joins:
        return Choices.outside(model, OUTSIDE, ALTERNATIVES)
    return Choices.of_rows(model, [3, 3, 17], ALTERNATIVES)


@pytest.mark.parametrize("joins", [True, False])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_is_the_likelihood_of_the_grid(model, joins: bool) -> None:
    """At any omega it is what `log_likelihood` gives for theta = omega and beta = 1."""
    demonstrations = OUTSIDE if joins else np.array([3, 3, 17])
    expected = log_likelihood(model, demonstrations, ALTERNATIVES, OMEGAS)[:, :, 0].T
    np.testing.assert_allclose(choices(model, joins).log_likelihood(OMEGAS), expected, rtol=1e-11)


@pytest.mark.parametrize("joins", [True, False])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_derivatives_are_those_of_central_differences(model, joins: bool) -> None:
    these, step = choices(model, joins), 1e-5
    found = these.derivatives(OMEGAS)
    np.testing.assert_allclose(found.value, these.total(OMEGAS), rtol=1e-13)
    for axis in range(3):
        moved = np.eye(3)[axis] * step
        up, down = these.derivatives(OMEGAS + moved), these.derivatives(OMEGAS - moved)
        np.testing.assert_allclose(found.gradient[:, axis], (up.value - down.value) / (2 * step), atol=2e-8)
        np.testing.assert_allclose(found.curvature[:, axis], -(up.gradient - down.gradient) / (2 * step), atol=2e-8)


@pytest.mark.parametrize("joins", [True, False])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_every_term_is_concave_along_every_line(model, joins: bool) -> None:
    these = choices(model, joins)
    curvature = these.derivatives(RNG.normal(size=(200, 3)) * 30).curvature
    assert np.linalg.eigvalsh(curvature).min() > -1e-12
    ends = RNG.normal(size=(2, 50, 3)) * 20
    values = [these.log_likelihood(points) for points in (ends[0], ends[1], ends.mean(axis=0))]
    assert np.all(values[2] >= (values[0] + values[1]) / 2 - 1e-12)


def test_subset_and_blocks_change_nothing() -> None:
    these = choices(LESS(0.15), True)
    np.testing.assert_array_equal(these.subset([2]).log_likelihood(OMEGAS)[:, 0], these.log_likelihood(OMEGAS)[:, 2])
    many = np.repeat(OMEGAS, 6000, axis=0)  # more terms than are held at once
    np.testing.assert_array_equal(these.total(many)[::6000], these.total(OMEGAS))


def test_far_points_neither_overflow_nor_vanish() -> None:
    far = choices(Boltzmann(), True).derivatives(np.array([[1e5, 0, 0], [-1e5, 2e5, 0]]))
    assert np.isfinite(far.value).all()
    assert np.isfinite(far.curvature).all()


@pytest.mark.parametrize("rows", [[], [40], [-1], [0.5], [[1]]])
def test_rows_that_are_none_are_refused(rows) -> None:
    with pytest.raises(ArgumentError, match="row numbers from 0 to 39"):
        Choices.of_rows(Boltzmann(), rows, ALTERNATIVES)


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ArgumentError, match="3 are needed"):
        Choices.outside(Boltzmann(), [[0.0, 1.0]], ALTERNATIVES)
    with pytest.raises(ArgumentError, match="rows for 1 demonstrations"):
        Choices(ALTERNATIVES, np.zeros(40), OUTSIDE[:1], np.zeros(1), np.zeros((2, 40)))


def test_choices_over_an_explored_space_are_its_densities() -> None:
    rng = np.random.default_rng(5)
    region = Region(rng.random((40, 2)), rng.normal(size=40))
    chosen, thetas, betas = rng.random((3, 2)), rng.normal(size=(5, 2)), [0.5, 4.0]
    ours = Choices.over(region, chosen)
    expected = region_log_likelihood(chosen, region.features, region.log_w, thetas, betas)  # (n, K, B)
    for b, beta in enumerate(betas):
        np.testing.assert_allclose(ours.log_likelihood(beta * thetas), expected[:, :, b].T, rtol=1e-12)
    one = ours.subset([2]).log_likelihood(thetas)
    np.testing.assert_allclose(one, ours.log_likelihood(thetas)[:, 2:], rtol=1e-12)
