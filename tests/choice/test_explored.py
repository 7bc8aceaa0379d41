import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from pipeline.choice import LESS, log_likelihood
from pipeline.choice.explored import (
    ExploredSpace,
    PooledLESS,
    Region,
    expected_choice,
    log_states,
    region_log_likelihood,
    region_log_weights,
    sampling_corrected,
)
from pipeline.errors import ArgumentError

THETAS, BETAS = np.array([[-1.0, 0.0], [-0.6, -0.8]]), np.array([0.3, 3.0])


def test_less_over_a_covered_square_is_uniform_whatever_the_sampler_preferred() -> None:
    """integral of exp(-a x - b y) over the unit square, from 20,000 points of which most crowd in one corner."""
    rng = np.random.default_rng(0)
    rows = np.concatenate([rng.random((10_000, 2)), rng.random((10_000, 2)) ** 3])
    log_w = region_log_weights(rows, 0.015)
    assert np.exp(log_w).sum() == pytest.approx(1.0, abs=0.06)  # the kernel widens the square by its rim
    ours = -region_log_likelihood(np.zeros((1, 2)), rows, log_w, THETAS, BETAS)[0]
    for k, theta in enumerate(THETAS):
        for b, beta in enumerate(BETAS):
            exact = sum(np.log((1 - np.exp(-a)) / a) for a in -beta * theta if a > 0)
            assert ours[k, b] == pytest.approx(exact, abs=0.1)


def test_a_pool_gives_a_small_set_the_density_of_the_large_one() -> None:
    pool = np.random.default_rng(1).normal(size=(4000, 2))
    few = pool[::40]
    log_w = region_log_weights(few, 0.3, pool)
    np.testing.assert_allclose(log_w - region_log_weights(pool, 0.3)[::40], np.log(40), rtol=1e-9)


def test_pooled_less_with_the_set_as_its_pool_is_less() -> None:
    rng = np.random.default_rng(2)
    rows, demonstrations = rng.normal(size=(60, 2)), rng.normal(size=(5, 2))
    ours = log_likelihood(PooledLESS(rows, 0.4), demonstrations, rows, THETAS, BETAS)
    np.testing.assert_allclose(ours, log_likelihood(LESS(0.4), demonstrations, rows, THETAS, BETAS), rtol=1e-10)


def test_density_of_states_is_the_kernel_estimate() -> None:
    rows, points = np.random.default_rng(3).normal(size=(5000, 1)), np.array([[0.0], [1.5]])
    ours = np.exp(log_states(points, rows, np.full(5000, -np.log(5000)), 0.2))
    np.testing.assert_allclose(ours, norm(scale=np.sqrt(1.04)).pdf(points[:, 0]), rtol=0.1)


def test_boltzmann_density_integrates_to_one_over_features() -> None:
    rows = np.random.default_rng(4).normal(size=(3000, 1))
    log_w = np.full(3000, -np.log(3000))

    def density(x: float) -> float:
        likelihood = region_log_likelihood([[x]], rows, log_w, [[-1.0]], [0.5])[0, 0, 0]
        return float(np.exp(likelihood + log_states([[x]], rows, log_w, 0.05)[0]))

    assert quad(density, -6, 6, limit=300)[0] == pytest.approx(1.0, abs=0.01)


def test_sampling_correction_undoes_the_sampler() -> None:
    """Draws from a normal, corrected by its density, estimate the integral under the flat measure."""
    rng = np.random.default_rng(5)
    rows = rng.normal(0, 2.0, (100_000, 1))
    log_w = sampling_corrected(np.zeros(100_000), norm(scale=2.0).logpdf(rows[:, 0])) - np.log(100_000)
    utility = -(rows[:, 0] ** 2) / 2
    assert np.exp(utility + log_w).sum() == pytest.approx(np.sqrt(2 * np.pi), rel=0.02)
    with pytest.raises(ArgumentError, match="no finite value at row 1"):
        sampling_corrected(np.zeros(2), [0.0, -np.inf])


def test_expected_choice_prefers_what_thetas_want() -> None:
    share = expected_choice([[0.0, 0.0], [1.0, 1.0]], THETAS, BETAS)
    assert share.sum() == pytest.approx(1.0)
    expected = np.mean([1 / (1 + np.exp(beta * theta.sum())) for theta in THETAS for beta in BETAS])
    assert share[0] == pytest.approx(expected)


def regions() -> tuple[Region, Region]:
    rng = np.random.default_rng(4)
    return tuple(Region(rows, region_log_weights(rows, 0.1)) for rows in (rng.random((80, 2)), rng.random((50, 2))))


def sums(region: Region, omega: np.ndarray) -> float:
    return float(np.exp(region.features @ omega + region.log_w).sum())


def test_a_sum_over_the_mean_of_regions_is_the_mean_of_their_sums() -> None:
    omega = np.array([-3.0, 5.0])
    assert sums(Region.mean(regions()), omega) == pytest.approx(np.mean([sums(one, omega) for one in regions()]))
    assert Region.mean(regions()[:1]).features is not None


def test_merged_rows_keep_their_weight_and_their_mean() -> None:
    one = regions()[0]
    merged = one.merged(0.2)
    assert len(merged.features) < 30
    assert np.exp(merged.log_w).sum() == pytest.approx(np.exp(one.log_w).sum())
    mean = [(np.exp(region.log_w) @ region.features) / np.exp(region.log_w).sum() for region in (one, merged)]
    np.testing.assert_allclose(mean[1], mean[0])
    # Hoeffding's lemma: in a cube of width h utilities differ by |omega| h sqrt(2) at most
    omega = np.array([-3.0, 5.0])
    for h in (0.02, 0.1, 0.2):
        least = np.exp(-((np.linalg.norm(omega) * h) ** 2) * 2 / 8)
        assert least <= sums(one.merged(h), omega) / sums(one, omega) <= 1 + 1e-12


def test_near_rows_are_merged_and_kernels_changed_by_a_factor() -> None:
    space = ExploredSpace({"less": regions()}, 0.1)
    np.testing.assert_allclose(space.region("less").log_w, Region.mean(regions()).merged(0.025).log_w)
    np.testing.assert_allclose(space.smoothed(2.0)[1].log_w, region_log_weights(regions()[1].features, 0.2))
