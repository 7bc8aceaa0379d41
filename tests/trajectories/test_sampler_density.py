import numpy as np
import pytest
from scipy.stats import multivariate_normal

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.trajectories.sampler_density import jittered, log_density
from pipeline.trajectories.samplers import Deformation, Mixture, Planner, Sampler, ViaPoint
from tests.support.toy_space import ANCHOR, WAYPOINTS, toy_space

SPACE = toy_space(modes=2)
PLANNED = Deformation(0.4, 2).sample(np.random.default_rng(0), ANCHOR, 3, WAYPOINTS)
PARTS: tuple[Sampler, ...] = (Deformation(0.3, 2), ViaPoint(0.75), Planner(PLANNED, Deformation(0.1, 2)))
SAMPLERS: tuple[Sampler, ...] = (*PARTS, Mixture(PARTS, (2.0, 1.0, 1.0)))
JITTER = 0.3


@pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda s: s.name)
def test_density_integrates_to_one(sampler: Sampler) -> None:
    """Importance sampling from a normal wide enough for all."""
    proposal = multivariate_normal(np.zeros(4), 9 * np.eye(4))
    points = proposal.rvs(400_000, random_state=1)
    ratio = np.exp(log_density(sampler, points.reshape(-1, 2, 2), SPACE, JITTER) - proposal.logpdf(points))
    assert ratio.mean() == pytest.approx(1.0, abs=5 * ratio.std() / np.sqrt(len(ratio)) + 0.002)


@pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda s: s.name)
def test_density_is_that_of_the_draws(sampler: Sampler) -> None:
    """Moments of jittered draws and of points weighted by the density."""
    drawn = jittered(sampler, np.random.default_rng(2), SPACE, 100_000, JITTER).reshape(-1, 4)
    proposal = multivariate_normal(np.zeros(4), 9 * np.eye(4))
    points = proposal.rvs(400_000, random_state=3)
    weights = np.exp(log_density(sampler, points.reshape(-1, 2, 2), SPACE, JITTER) - proposal.logpdf(points))
    for power in (1, 2):
        ours = (weights[:, None] * points**power).sum(axis=0) / weights.sum()
        np.testing.assert_allclose(ours, (drawn**power).mean(axis=0), atol=0.08, rtol=0.05)


def test_a_trajectory_that_no_sampler_would_draw_has_a_density() -> None:
    wild = 5 * np.random.default_rng(4).standard_normal((3, 2, 2))
    for sampler in SAMPLERS:
        assert np.isfinite(log_density(sampler, wild, SPACE)).all()


def test_little_jitter_gives_the_deformations_own_density_up_to_a_constant() -> None:
    sampler = Deformation(0.3, 2)
    z = jittered(sampler, np.random.default_rng(5), SPACE, 20, 1e-9)
    ours = log_density(sampler, z, SPACE, 1e-9) - sampler.log_proposal(SPACE.decode(z), ANCHOR)
    np.testing.assert_allclose(ours, ours[0], atol=1e-6)


def test_an_unknown_sampler_is_refused() -> None:
    class Given:
        name = "given"

        def sample(self, rng: np.random.Generator, anchor: object, count: int, n_waypoints: int) -> FloatArray:
            raise NotImplementedError

    with pytest.raises(ArgumentError, match="'given' has no known density"):
        log_density(Given(), np.zeros((1, 2, 2)), SPACE)
