from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError, StageError
from pipeline.trajectories.paths import sine_basis, straight_path
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import (
    Anchor,
    Deformation,
    Draw,
    Fate,
    Judge,
    Mixture,
    Planner,
    Sampler,
    Tally,
    ViaPoint,
    draw_admissible,
)

T = 41
ANCHOR = Anchor(np.array([0.3, 0.9, -0.4]), np.array([1.7, 0.2, 0.6]))
PLANNED = Deformation(0.4).sample(child_rng(0, "planned"), ANCHOR, 6, T)
MIXED = Mixture((Deformation(0.3), ViaPoint(0.75), Planner(PLANNED, Deformation(0.1))), (2.0, 1.0, 1.0))
SAMPLERS = (*MIXED.samplers, MIXED)
LOWER, UPPER = np.full(3, -1.2), np.full(3, 2.2)


def above_ground(waypoints: FloatArray) -> FloatArray:
    """A planar arm with links of 0.5, 0.4 and 0.2 m on a wall at x = 0: its hand stays at y > 0.5 m."""
    angles = np.cumsum(waypoints, axis=-1)
    return (np.array([0.5, 0.4, 0.2]) * np.sin(angles)).sum(axis=-1).min(axis=1) > 0.5


def judged(allowed: Callable[[FloatArray], FloatArray]) -> Judge:
    return lambda waypoints: np.where(allowed(waypoints), Fate.KEPT, Fate.THROUGH_SURFACE)


def draw(sampler: Sampler, count: int, *labels: str | int) -> Draw:
    rng = child_rng(1, sampler.name, *labels)
    return draw_admissible(sampler, rng, ANCHOR, count, T, lower=LOWER, upper=UPPER, judge=judged(above_ground))


@pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda s: s.name)
def test_paths_are_possible_and_start_and_end_exactly_at_the_anchor(sampler: Sampler) -> None:
    drawn = draw(sampler, 500)
    paths = drawn.waypoints
    assert paths.shape == (500, T, 3)
    assert (paths[:, 0] == ANCHOR.start).all()
    assert (paths[:, -1] == ANCHOR.goal).all()
    assert (paths >= LOWER).all()
    assert (paths <= UPPER).all()
    assert above_ground(paths).all()
    assert len(np.unique(paths[:, T // 2, 0])) == 500
    assert 0 < drawn.rejection_rate < 0.9
    assert sum(t.kept for t in drawn.tallies) == len(drawn.sampler) == 500


@pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda s: s.name)
def test_adding_a_set_changes_no_other(sampler: Sampler) -> None:
    alone = draw(sampler, 30, 30, 2).waypoints.tobytes()
    others = [draw(sampler, 30, 30, i).waypoints.tobytes() for i in (0, 1, 2, 3)]
    assert others[2] == alone
    assert len(set(others)) == 4


def test_deformations_covary_as_stated() -> None:
    count, width = 20_000, 0.3
    paths = Deformation(width, modes=4, decay=1.5).sample(child_rng(2), ANCHOR, count, T)
    deviation = paths - straight_path(ANCHOR, T)
    basis = sine_basis(T, 4, 1.5)
    covariance = width**2 * basis.T @ basis
    columns = [5, 13, 20, 33]
    for j in range(3):
        measured = np.cov(deviation[:, columns, j].T)
        expected = covariance[np.ix_(columns, columns)]
        variance = np.diag(expected)
        error = np.sqrt((np.outer(variance, variance) + expected**2) / count)  # of a normal sample covariance
        assert (np.abs(measured - expected) < 4.5 * error).all()
    between = (deviation[:, 20, 0] * deviation[:, 20, 1]).mean()
    assert abs(between) < 4.5 * covariance[20, 20] / np.sqrt(count)
    # mean square of 3 * 20,000 paths; one path's has a relative standard deviation below sqrt(2)
    assert (deviation[:, :-1] ** 2).mean() == pytest.approx(width**2, rel=4.5 * np.sqrt(2 / (3 * count)))


def test_log_proposal_is_the_density_of_the_normal_distribution() -> None:
    # With as many modes as inner waypoints the map from amplitudes to waypoints is a change of variables.
    n, modes, sampler = 7, 5, Deformation(0.2, modes=5, decay=1.0)
    paths = sampler.sample(child_rng(3), ANCHOR, 8, n)
    basis = sampler.width_rad * sine_basis(n, modes, 1.0)[:, 1:-1]
    inner = (paths - straight_path(ANCHOR, n))[:, 1:-1]
    in_waypoints = multivariate_normal(cov=basis.T @ basis).logpdf(np.moveaxis(inner, 2, 1)).sum(axis=1)
    sines = np.sin(np.pi * np.outer(np.arange(1, modes + 1), np.arange(1, n - 1)) / (n - 1))
    stretch = 3 * np.linalg.slogdet(sines)[1]
    assert np.allclose(sampler.log_proposal(paths, ANCHOR), in_waypoints + stretch, rtol=1e-9)


def test_log_proposal_refuses_a_path_of_another_family() -> None:
    paths = ViaPoint(0.5).sample(child_rng(4), ANCHOR, 2, T)
    with pytest.raises(ArgumentError, match="outside what a deformation of 5 modes"):
        Deformation(0.3).log_proposal(paths, ANCHOR)
    stored = Deformation(0.3).sample(child_rng(4), ANCHOR, 2, T).astype(np.float32).astype(np.float64)
    assert np.isfinite(Deformation(0.3).log_proposal(stored, ANCHOR)).all()


def test_via_points_fill_their_box_evenly() -> None:
    sampler = ViaPoint(0.5, when=(0.5, 0.5))
    middle = sampler.sample(child_rng(5), ANCHOR, 4000, T)[:, 20] - straight_path(ANCHOR, T)[20]
    assert np.abs(middle).max() <= 0.5 + 1e-12
    counts = np.histogram(middle.ravel(), bins=10, range=(-0.5, 0.5))[0]
    assert ((counts - 1200) ** 2 / 1200).sum() < 27.9  # chi-square, 9 degrees of freedom, p = 0.001


def test_planner_keeps_to_its_paths_and_carries_them_to_other_anchors() -> None:
    moved = Anchor(ANCHOR.start + 0.2, ANCHOR.goal - 0.1)
    paths = Planner(PLANNED, Deformation(1e-9)).sample(child_rng(6), moved, 60, T)
    expected = PLANNED - straight_path(ANCHOR, T) + straight_path(moved, T)
    distance = np.abs(paths[:, None] - expected).max(axis=(2, 3))
    assert (distance.min(axis=1) < 1e-7).all()
    assert set(distance.argmin(axis=1)) == set(range(6))
    with pytest.raises(ArgumentError, match="plan them again"):
        Planner(PLANNED).sample(child_rng(6), moved, 1, T + 1)


def test_a_mixture_picks_by_weight_and_says_who_drew() -> None:
    everywhere = np.full(3, np.inf)
    drawn = draw_admissible(
        MIXED,
        child_rng(7),
        ANCHOR,
        8000,
        T,
        lower=-everywhere,
        upper=everywhere,
        judge=judged(lambda w: np.full(len(w), True)),
    )
    assert [(t.sampler, t.kept == t.proposed) for t in drawn.tallies] == [
        ("deformation", True),
        ("planner", True),
        ("via-point", True),
    ]
    assert abs(drawn.tallies[0].kept - 4000) < 4.5 * np.sqrt(8000 / 4)
    assert drawn.sampler.count("via-point") == drawn.tallies[2].kept
    from_via = np.array(drawn.sampler) == "via-point"
    with pytest.raises(ArgumentError):
        Deformation().log_proposal(drawn.waypoints[from_via], ANCHOR)
    Deformation().log_proposal(drawn.waypoints[np.array(drawn.sampler) == "deformation"], ANCHOR)


def test_rejection_counts_add_up_and_leave_the_truncated_distribution() -> None:
    # One joint, one mode: the middle waypoint is N(0, 0.02) about the line; 2.5 sigma cut off above, half below.
    anchor, sampler = Anchor(np.zeros(1), np.zeros(1)), Deformation(0.1, modes=1)
    sigma = 0.1 * np.sqrt(2)
    drawn = draw_admissible(
        sampler,
        child_rng(8),
        anchor,
        4000,
        3,
        lower=np.array([-np.inf]),
        upper=np.array([2.5 * sigma]),
        judge=judged(lambda w: w[:, 1, 0] >= 0),
    )
    (tally,) = drawn.tallies
    assert tally.kept == 4000
    assert tally.proposed == 4000 + tally.outside_limits + tally.through_surface
    outside = 0.0062097  # 1 - Phi(2.5)
    error = np.sqrt(tally.proposed * outside)
    assert abs(tally.outside_limits - outside * tally.proposed) < 4.5 * error
    assert abs(tally.through_surface - tally.proposed / 2) < 4.5 * np.sqrt(tally.proposed) / 2
    # a half normal has mean sigma sqrt(2 / pi) and standard deviation 0.6 sigma; the cut takes 2 % off the mean
    cut_mean = sigma * (0.3989423 - 0.0175283) / (0.5 - outside)
    assert drawn.waypoints[:, 1, 0].mean() == pytest.approx(cut_mean, abs=4.5 * 0.6 * sigma / np.sqrt(4000))


def test_each_fate_is_counted_for_itself() -> None:
    """One joint, one mode: by the place of the middle waypoint, a third each is kept, sinks or touches something."""
    anchor, sampler = Anchor(np.zeros(1), np.zeros(1)), Deformation(0.1, modes=1)
    third = 0.1 * np.sqrt(2) * 0.430727  # a third of a normal distribution is below -third, a third above

    def judge(waypoints: FloatArray) -> IntArray:
        middle = waypoints[:, 1, 0]
        return np.where(middle < -third, Fate.THROUGH_SURFACE, np.where(middle > third, Fate.IN_COLLISION, Fate.KEPT))

    everywhere = np.full(1, np.inf)
    drawn = draw_admissible(sampler, child_rng(10), anchor, 3000, 3, lower=-everywhere, upper=everywhere, judge=judge)
    (tally,) = drawn.tallies
    assert tally.kept == 3000 == tally.proposed - tally.through_surface - tally.in_collision
    for count in (tally.through_surface, tally.in_collision):
        assert abs(count - tally.proposed / 3) < 4.5 * np.sqrt(tally.proposed * 2 / 9)
    both = tally + Tally("deformation", 10, 1, 2, 3)
    assert (both.proposed, both.outside_limits, both.kept) == (tally.proposed + 10, 1, 3004)


def test_a_hopeless_scene_is_given_up_with_a_reason() -> None:
    everywhere = np.full(3, np.inf)
    with pytest.raises(
        StageError,
        match=r"'deformation' had 0 of 2000 paths accepted \(0 left .* 2000 went through the surface, 0 touched",
    ):
        draw_admissible(
            Deformation(), child_rng(9), ANCHOR, 10, T, lower=-everywhere, upper=everywhere,
            judge=judged(lambda w: np.full(len(w), False)),
        )  # fmt: skip


def test_an_anchor_outside_the_limits_is_named() -> None:
    with pytest.raises(ArgumentError, match=r"anchor.goal has joint 1 at 1.7; its limits are -1 to 1"):
        draw_admissible(
            Deformation(), child_rng(9), ANCHOR, 1, T, lower=-np.ones(3), upper=np.ones(3), judge=judged(above_ground)
        )


@pytest.mark.parametrize(
    "make",
    [
        lambda: Deformation(0.0),
        lambda: Deformation(0.1, modes=0),
        lambda: ViaPoint(-1.0),
        lambda: ViaPoint(0.1, when=(0.0, 0.5)),
        lambda: Planner(np.zeros((0, T, 3))),
        lambda: Mixture((Deformation(),), (1.0, 1.0)),
        lambda: Mixture((Deformation(),), (0.0,)),
        lambda: draw(Deformation(), 0),
    ],
)
def test_arguments_are_checked(make) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ArgumentError):
        make()
