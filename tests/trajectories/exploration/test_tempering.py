import numpy as np
import pytest

from pipeline.choice.reweighting import base_weights
from pipeline.errors import ArgumentError
from pipeline.trajectories.exploration.tempering import Tempering, TiltedDraws, temper
from tests.support.toy_space import log_normaliser, toy_space

THETAS = np.array([[-1.0, 0.0], [0.0, -1.0], [-0.6, -0.8]])
USUAL = Tempering(100, 60)
OMEGAS = np.concatenate([beta * THETAS for beta in (0.1, 1.0, 3.0, 10.0)])


def tempered(seed: int, tempering: Tempering = USUAL, multiple: float = 1000.0) -> TiltedDraws:
    return temper(toy_space(multiple), THETAS, 10.0, np.random.default_rng(seed), tempering)


def test_pooled_normalisers_are_those_of_the_closed_form() -> None:
    """Six coefficients, effort and a linear feature: every log Z is known; those here span more than 25 nats."""
    draws = tempered(0)
    weights = base_weights(draws.features, draws.omegas, draws.counts, draws.log_normalisers)
    exact = np.array([log_normaliser(omega) for omega in OMEGAS])
    assert np.ptp(exact) > 25
    np.testing.assert_allclose(weights.log_normaliser(OMEGAS), exact, atol=0.3)
    # the product of the steps' own ratios is right as well, and much less exact
    last = [log_normaliser(omega) for omega in draws.omegas]
    np.testing.assert_allclose(draws.log_normalisers, last, atol=3.0)


def test_error_shrinks_when_populations_are_merged() -> None:
    parts = [tempered(seed, Tempering(40, 30)) for seed in range(6)]
    exact = np.array([log_normaliser(omega) for omega in OMEGAS])

    def error(draws: TiltedDraws) -> float:
        weights = base_weights(draws.features, draws.omegas, draws.counts, draws.log_normalisers)
        return float(np.abs(weights.log_normaliser(OMEGAS) - exact).mean())

    merged = parts[0].merged(*parts[1:])
    assert merged.evaluations == sum(part.evaluations for part in parts)
    assert error(merged) < np.mean([error(part) for part in parts])


def test_walkers_stay_in_the_space_and_equal_streams_agree() -> None:
    one, same = tempered(3, Tempering(20, 10), 3.0), tempered(3, Tempering(20, 10), 3.0)
    np.testing.assert_array_equal(one.features, same.features)
    assert toy_space(3.0).evaluate(one.walkers)[1].all()
    assert one.counts.sum() == len(one.features)
    assert not one.omegas[0].any()


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="walkers is 1"):
        Tempering(walkers=1)
