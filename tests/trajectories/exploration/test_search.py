from typing import Any

import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.exploration.archive import Grid
from pipeline.trajectories.exploration.search import Exploration, explore, seeds_around
from tests.support.toy_space import toy_space

SPACE = toy_space(4.0)
SEEDS = seeds_around(SPACE, [SPACE.line[None]])


def explored(evaluations: int, seed: int = 0, **options: Any) -> Exploration:
    return explore(SPACE, SEEDS, np.random.default_rng(seed), evaluations, Grid(0.1), **options)


def test_equal_streams_give_equal_maps_and_others_do_not() -> None:
    one, same, other = explored(20_000), explored(20_000), explored(20_000, 1)
    np.testing.assert_array_equal(one.archive.z, same.archive.z)
    assert one.growth == same.growth
    assert not np.array_equal(one.archive.features, other.archive.features)


def test_every_elite_is_a_member_with_its_own_features() -> None:
    archive = explored(20_000).archive
    features, inside = SPACE.evaluate(archive.z)
    assert inside.all()
    np.testing.assert_allclose(features, archive.features, rtol=1e-12)


def test_it_reaches_what_can_be_reached() -> None:
    """For a given effort the sum of deviations is at most sqrt(effort above the least x sum_k s_k^2 / c_k)."""
    archive = explored(100_000).archive
    effort, deviation = archive.features.T
    sums = SPACE.basis.sum(axis=1) / 7
    bound = np.sqrt((sums**2 / SPACE.stiffness).sum() * (effort * 0.2 - SPACE.least_effort))
    assert (np.abs(deviation) <= bound + 1e-9).all()
    high = effort > 0.9 * SPACE.most_effort / 0.2
    assert deviation[high].max() > 0.93 * bound.max()
    assert deviation[high].min() < -0.93 * bound.max()


def test_going_on_counts_what_was_done_and_interest_directs_it() -> None:
    first = explored(10_000)
    cells = len(first.archive)
    second = explored(20_000, 1, start=first)
    assert second.evaluations >= 20_000
    assert len(second.archive) >= cells
    assert 0 <= second.growth_at_last_doubling < 1
    plain, keen = explored(30_000), explored(30_000, interest=lambda phi: np.where(phi[:, 1] < 0, 1.0, 1e-6))

    def share(run: Exploration) -> float:
        return float(run.archive.visits[run.archive.features[:, 1] < 0].sum() / run.archive.visits.sum())

    assert share(plain) == pytest.approx(0.5, abs=0.05)
    assert share(keen) > share(plain) + 0.1


def test_islands_merge_in_any_order() -> None:
    islands = [explored(6_000, seed) for seed in range(3)]
    one, other = islands[0].merged(*islands[1:]), islands[2].merged(islands[1], islands[0])
    np.testing.assert_array_equal(one.archive.z, other.archive.z)
    assert one.evaluations == sum(island.evaluations for island in islands)


def test_seeds_outside_the_space_are_an_error_only_if_all_are() -> None:
    far = np.full((1, SPACE.modes, SPACE.joints), 50.0)
    with pytest.raises(ArgumentError, match="none is in the choice space"):
        explore(SPACE, far, np.random.default_rng(0), 4000, Grid(0.1))
    explore(SPACE, np.concatenate([far, SEEDS]), np.random.default_rng(0), 4000, Grid(0.1))
