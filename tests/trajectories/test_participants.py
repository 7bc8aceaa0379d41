from dataclasses import replace

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError, StageError
from pipeline.trajectories.participants import (
    Driver,
    DriverLog,
    Hand,
    Motion,
    Participant,
    demonstrate,
    draw_participants,
    driver_messages,
)
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.samplers import Anchor, Deformation
from pipeline.trajectories.timebase import moving_part

ANCHOR = Anchor(np.array([1.9, 2.6, 3.2]), np.array([3.5, 1.6, 3.3]))
PATH = Deformation(0.2).sample(child_rng(0, "path"), ANCHOR, 1, 41)[0]
FREE = np.full(3, np.inf)
DRIVER = Driver(("j1", "j2", "j3"), (True, False, True), fingers=("f1", "f2"))
START_NS = 1_700_000_000_000_000_000


def anything(waypoints: FloatArray) -> FloatArray:
    return np.full(len(waypoints), True)


def moved(*labels: int, skill: float = 0.5, hand: Hand = Hand()) -> Motion:  # noqa: B008 (frozen)
    rng = child_rng(3, "motion", *labels)
    return demonstrate(rng, PATH, skill, hand, lower=-FREE, upper=FREE, admissible=anything)


def logged(*labels: int, driver: Driver = DRIVER, motion: Motion | None = None) -> DriverLog:
    return driver_messages(child_rng(4, "log", *labels), motion or moved(*labels), driver, START_NS)


def test_people_want_about_what_the_task_asks_for() -> None:
    theta = np.array([1.0, 2.0, 2.0])
    people = draw_participants(child_rng(1), theta, 4000, spread_rad=0.1, skill=(0.2, 0.6))
    thetas = np.array([p.theta for p in people])
    assert np.allclose((thetas**2).sum(axis=1), 1, atol=1e-12)
    assert (thetas >= 0).all()
    cosine = thetas @ theta / 3
    # the angle has two normal parts, so its mean square is 2 * 0.1^2 with a relative standard deviation of 1
    assert (np.arccos(cosine) ** 2).mean() == pytest.approx(0.02, rel=4.5 / np.sqrt(4000))
    skills = np.array([p.skill for p in people])
    assert skills.min() >= 0.2
    assert skills.max() <= 0.6
    assert skills.mean() == pytest.approx(0.4, abs=4.5 * 0.4 / np.sqrt(12 * 4000))
    assert people[0].name == "participant-0001"


def test_weights_never_become_negative() -> None:
    for theta in (np.array([1.0, 0, 0]), np.array([0.0, 1, 1]), np.array([3.0])):
        for person in draw_participants(child_rng(2), theta, 200, spread_rad=0.5):
            assert (person.theta >= 0).all()
    assert draw_participants(child_rng(2), np.array([3.0]), 1)[0].theta.tolist() == [1.0]


def test_a_further_participant_changes_no_other() -> None:
    twelve = draw_participants(child_rng(5), np.ones(3), 12)
    thirteen = draw_participants(child_rng(5), np.ones(3), 13)
    assert [(p.name, p.theta.tolist(), p.skill) for p in thirteen[:12]] == [
        (p.name, p.theta.tolist(), p.skill) for p in twelve
    ]


def test_a_steady_hand_follows_the_path_at_its_own_pace() -> None:
    motion = moved(skill=1.0)
    assert 4 <= motion.time_s[-1] <= 15
    assert np.allclose(motion.positions[[0, -1]], PATH[[0, -1]], atol=1e-12)
    # every pose lies on the path: between two waypoints a spline leaves the chord by h^2 |q''| / 8
    bend = np.abs(np.diff(PATH, 2, axis=0)).max() / 8
    segment = (PATH[1:] - PATH[:-1])[None]
    offset = motion.positions[:, None] - PATH[None, :-1]
    along = np.clip((offset * segment).sum(axis=2) / (segment**2).sum(axis=2), 0, 1)[:, :, None]
    distance = np.abs(offset - along * segment).max(axis=2).min(axis=1)
    assert distance.max() < 2 * bend
    speed = np.linalg.norm(np.diff(motion.positions, axis=0), axis=1)
    assert speed[[0, -1]].max() < 0.02 * speed.max()  # from rest to rest


def test_the_pace_varies_as_in_recorded_demonstrations() -> None:
    # Mean square over squared mean speed: median 1.16, 5 to 95 percent 1.09 to 1.29 in the 21 published recordings.
    ratios = []
    for i in range(300):
        motion = moved(i, skill=1.0)
        arc = np.r_[0, np.linalg.norm(np.diff(motion.positions, axis=0), axis=1).cumsum()]
        step = np.diff(np.interp(np.linspace(0, motion.time_s[-1], 61), motion.time_s, arc))
        ratios.append((step**2).mean() / step.mean() ** 2)
    assert np.median(ratios) == pytest.approx(1.16, abs=0.05)
    assert np.percentile(ratios, 5) > 1.05
    assert np.percentile(ratios, 95) < 1.5


def test_disturbances_have_the_stated_size() -> None:
    still = np.zeros((41, 3))
    quiet = Hand(duration_s=(8, 8), drift_rad=0, misplacement_rad=0, tremor_rad=0)

    def disturbed(hand: Hand, skill: float = 0.5) -> FloatArray:
        motions = [
            demonstrate(child_rng(6, i), still, skill, hand, lower=-FREE, upper=FREE, admissible=anything)
            for i in range(200)
        ]
        return np.array([m.positions for m in motions])

    def rms(values: FloatArray) -> float:
        return float(np.sqrt((values**2).mean()))

    # 600 independent curves; a curve's mean square has a relative standard deviation below sqrt(2)
    near = 0.5 * 4.5 * np.sqrt(2 / 600)
    drift = disturbed(replace(quiet, drift_rad=0.03))
    assert rms(drift) == pytest.approx(0.03, rel=near)
    assert np.abs(drift[:, [0, -1]]).max() < 1e-15
    assert rms(disturbed(replace(quiet, misplacement_rad=0.02))[:, 0]) == pytest.approx(0.02, rel=near)
    assert rms(disturbed(replace(quiet, drift_rad=0.03), skill=0.75)) == pytest.approx(0.015, rel=near)
    tremor = disturbed(replace(quiet, tremor_rad=0.001))
    assert rms(tremor) == pytest.approx(0.001, rel=0.02)  # fixed amplitudes, only the beats vary
    power = (np.abs(np.fft.rfft(tremor, axis=1)) ** 2).sum(axis=(0, 2))
    frequency_hz = np.fft.rfftfreq(tremor.shape[1], 0.01)
    assert power[(frequency_hz > 7.5) & (frequency_hz < 12.5)].sum() > 0.99 * power.sum()


def test_a_motion_keeps_to_limits_and_scene_or_is_given_up() -> None:
    lower, upper = PATH.min(axis=0) - 0.03, PATH.max(axis=0) + 0.03
    seen = []

    def admissible(waypoints: FloatArray) -> FloatArray:
        seen.append(waypoints)
        return waypoints[:, :, 1].max(axis=1) < PATH[:, 1].max() + 0.02

    for i in range(20):
        motion = demonstrate(child_rng(7, i), PATH, 0.5, Hand(), lower=lower, upper=upper, admissible=admissible)
        assert (motion.positions >= lower).all()
        assert (motion.positions <= upper).all()
        assert motion.positions[:, 1].max() < PATH[:, 1].max() + 0.02
    assert len(seen) > 20
    with pytest.raises(StageError, match="plan the path with more clearance"):
        demonstrate(
            child_rng(7), PATH, 0.5, Hand(), lower=lower, upper=upper, admissible=lambda w: np.full(len(w), False)
        )


def test_messages_come_at_100_hz_with_jitter_and_idle_ends() -> None:
    motion = moved()
    still = replace(DRIVER, noise_rad=0.0, wrapped_share=0.0)
    heads = []
    for i in range(30):
        log = logged(i, driver=still, motion=motion)
        gap_s = np.diff(log.time_ns) / 1e9
        assert (gap_s > 0).all()
        assert 1 / gap_s.mean() == pytest.approx(100, rel=1e-3)
        # the difference of two independent jitters
        assert gap_s.std() == pytest.approx(0.001 * np.sqrt(2), rel=4.5 / np.sqrt(gap_s.size))
        time_s = (log.time_ns - START_NS) / 1e9
        moving = np.flatnonzero((log.positions[:, :3] != log.positions[0, :3]).any(axis=1))
        heads.append(time_s[moving[0]])
        tail_s = time_s[-1] - heads[-1] - motion.time_s[-1]
        assert 0.5 - 0.02 < tail_s < 2.0 + 0.02
        assert log.names == ("j1", "j2", "j3", "f1", "f2")
        assert log.positions.shape == (len(log.time_ns), 5)
        assert (log.positions[:, 3:] == 0).all()
    assert 0.5 - 0.02 < min(heads) < 0.8
    assert 1.7 < max(heads) < 2.0 + 0.02


def test_the_encoder_is_noisy_also_at_rest() -> None:
    log = logged(driver=replace(DRIVER, idle_head_s=(20, 20), noise_rad=0.002, wrapped_share=0.0))
    rest = log.positions[:1990, :3]
    assert np.allclose(rest.std(axis=0), 0.002, rtol=4.5 / np.sqrt(2 * 1990))
    assert np.abs(np.corrcoef(rest[1:, 0], rest[:-1, 0])[0, 1]) < 4.5 / np.sqrt(1990)


def test_some_recordings_report_continuous_joints_within_one_turn() -> None:
    always = replace(DRIVER, wrapped_share=1.0)
    branches = set()
    for i in range(20):
        plain = logged(i, driver=replace(DRIVER, wrapped_share=0.0)).positions
        wrapped = logged(i, driver=always).positions
        assert (wrapped[:, 1] == plain[:, 1]).all()  # joint 2 has limits
        turns = (wrapped - plain)[:, [0, 2]] / (2 * np.pi)
        assert np.allclose(turns, np.rint(turns), atol=1e-12)
        low = 0.0 if wrapped[:, [0, 2]].min() >= 0 else -np.pi
        assert (wrapped[:, [0, 2]] >= low).all()
        assert (wrapped[:, [0, 2]] < low + 2 * np.pi).all()
        branches.add(low)
    assert branches == {0.0, -np.pi}
    jumps = [np.abs(np.diff(logged(i).positions[:, 0])).max() > 6 for i in range(200)]
    assert 25 < sum(jumps) < 78  # a quarter runs through pi in the branch that ends there: 50 +- 4.5 * 6.1


def test_the_time_base_recovers_the_motion_from_the_messages() -> None:
    for i in range(10):
        motion = moved(i, skill=0.5)
        log = logged(i, motion=motion)
        time_s = (log.time_ns - log.time_ns[0]) / 1e9
        part = moving_part(time_s, log.positions[:, :3], np.array(DRIVER.continuous))
        waypoints = part.waypoints(PATH[0], np.array(DRIVER.continuous), 41)
        assert 0.4 < part.start_s < 3
        assert part.duration_s <= motion.time_s[-1] + 0.05
        assert part.duration_s > 0.85 * motion.time_s[-1]
        assert np.abs(waypoints[[0, -1]] - motion.positions[[0, -1]]).max() < 0.01 + 0.003
        nearest = np.abs(waypoints[:, None] - motion.positions).max(axis=2).min(axis=1)
        assert nearest.max() < 0.01  # encoder noise and the spacing of the poses


def test_same_streams_same_bytes() -> None:
    assert logged(1).positions.tobytes() == logged(1).positions.tobytes()
    assert logged(1).time_ns.tobytes() == logged(1).time_ns.tobytes()
    assert logged(1).positions.tobytes() != logged(2).positions.tobytes()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Participant("p", np.ones(1), 1.5),
        lambda: Hand(duration_s=(5, 4)),
        lambda: Hand(ramp=0.6),
        lambda: Hand(drift_rad=-0.1),
        lambda: Driver(("a",), ()),
        lambda: Driver(("a",), (True,), rate_hz=0),
        lambda: Driver(("a",), (True,), idle_head_s=(2, 1)),
        lambda: Driver(("a",), (True,), wrapped_share=2),
        lambda: draw_participants(child_rng(0), np.array([1.0, -1.0]), 2),
        lambda: draw_participants(child_rng(0), np.zeros(2), 2),
        lambda: draw_participants(child_rng(0), np.ones(2), 0),
        lambda: moved(skill=1.5),
        lambda: logged(driver=Driver(("a",), (True,))),
    ],
)
def test_arguments_are_checked(make) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ArgumentError):
        make()
