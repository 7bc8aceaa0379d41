"""How an arm moves in a recording: what is measured, and what no arm does."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.trajectories import motion


def reach(rate_hz: float = 100, duration_s: float = 4.0, joints: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A smooth motion of about 1 rad."""
    time_s = np.arange(0, duration_s + 0.5 / rate_hz, 1 / rate_hz)
    s = time_s / duration_s
    bell = s**3 * (10 - 15 * s + 6 * s**2)
    return time_s, bell[:, None] * np.linspace(0.5, 1.0, joints)


def test_rate_and_gap() -> None:
    time_s, _ = reach()
    assert motion.rate_hz(np.delete(time_s, np.s_[100:150])) == pytest.approx(100)
    gap = motion.longest_gap(np.delete(time_s, np.s_[100:150]))
    assert (gap.at_s, gap.size) == (pytest.approx(0.99), pytest.approx(0.51))


def test_the_greatest_speed_is_that_of_the_motion_however_messages_are_stamped() -> None:
    time_s, q = reach()
    expected = 1.875 / 4.0  # of a minimum-jerk reach of 1 rad, at its middle
    found = max(motion.greatest_speeds(time_s, q), key=lambda one: one.size)
    assert (found.joint, found.size) == (2, pytest.approx(expected, rel=1e-3))
    assert found.at_s == pytest.approx(2.0, abs=0.1)
    bursts = np.floor(time_s / 0.04) * 0.04 + 1e-5 * np.arange(len(time_s))  # four messages at a time
    in_bursts = max(motion.greatest_speeds(bursts, q), key=lambda one: one.size)
    assert in_bursts.size < 2 * expected
    assert max(one.size for one in motion.greatest_speeds(time_s[:3], q[::100][:3])) > 0  # shorter than the window


@pytest.mark.parametrize("rate_hz", [100, 10])
@pytest.mark.parametrize("size", [0.31, 1.0])
@pytest.mark.parametrize("lasting", [1, 40])
def test_a_sample_that_is_elsewhere_is_an_outlying_step(rate_hz: float, size: float, lasting: int) -> None:
    time_s, q = reach(rate_hz, 6.0)
    q[20 : 20 + lasting, 1] += size
    found = max(motion.outlying_steps(time_s, q), key=lambda one: one.size)
    assert (found.joint, found.size) == (1, pytest.approx(size, abs=0.06))
    assert found.at_s in (
        pytest.approx(time_s[20]),
        pytest.approx(time_s[20 + lasting] if lasting < 30 else time_s[20]),
    )


@pytest.mark.parametrize("rate_hz", [500, 100, 10, 4])
def test_a_motion_has_no_outlying_step_whatever_its_rate(rate_hz: float) -> None:
    time_s, q = reach(rate_hz)
    rest = np.repeat(q[:1], 30, axis=0)
    q = np.concatenate([rest, q, np.repeat(q[-1:], 30, axis=0)])
    time_s = np.arange(len(q)) / rate_hz
    q += np.random.default_rng(3).normal(scale=0.0005, size=q.shape)
    assert max(one.size for one in motion.outlying_steps(time_s, q)) < motion.ODD_STEP
    assert all(one.size == 0 for one in motion.outlying_steps(time_s[:4], q[:4]))


def test_a_step_across_missing_samples_is_as_long_as_these_allow() -> None:
    time_s, q = reach()
    keep = np.r_[0:200, 240 : len(q)]
    assert max(one.size for one in motion.outlying_steps(time_s[keep], q[keep])) == 0


@pytest.mark.parametrize("rest_s", [0.5, 2.0])
def test_the_longest_rest(rest_s: float) -> None:
    time_s, q = reach()
    half = len(q) // 2
    q = np.concatenate([q[:half], np.repeat(q[half : half + 1], round(100 * rest_s), axis=0), q[half:]])
    found = motion.longest_rest(np.arange(len(q)) / 100, q, 0.01)
    assert found.size == pytest.approx(rest_s, abs=0.1)
    assert found.at_s == pytest.approx(time_s[half], abs=0.1)


def test_coming_back_and_leaving_again_is_more_than_one_motion() -> None:
    _, q = reach()
    drift = np.array([0.03, -0.02, 0.04])
    three = np.concatenate([q, q[::-1] + drift, q + drift, q[::-1] + 2 * drift, q + 2 * drift])
    found = motion.returns(np.arange(len(three)) / 100, three)
    assert found == [pytest.approx(8.0, abs=0.2), pytest.approx(16.0, abs=0.2)]
    for one in (q, np.concatenate([q, q[::-1]])):  # there, and there and back
        assert motion.returns(np.arange(len(one)) / 100, one) == []
    halfway = np.concatenate([q, q[: len(q) // 2 : -1], q[len(q) // 2 :]])  # back halfway only
    assert motion.returns(np.arange(len(halfway)) / 100, halfway) == []


def test_noise_is_to_and_fro_and_a_motion_is_not() -> None:
    _, q = reach()
    noisy = q + np.random.default_rng(5).normal(scale=[0.0, 0.03, 0.0], size=q.shape)
    sizes = [one.size for one in motion.shaking(noisy)]
    assert sizes[0] == sizes[2] == 0
    assert sizes[1] == pytest.approx(0.03 * 1.2, rel=0.3)
    assert motion.shaking(q[:2]) == []


def test_irregular_intervals_and_a_pace_that_changes() -> None:
    rng = np.random.default_rng(6)
    even = np.arange(300) * 0.01
    assert (motion.irregularity(even), motion.changing_pace(even)) == (pytest.approx(0), pytest.approx(1))
    early_or_late = even + rng.uniform(-0.0012, 0.0012, 300)
    assert motion.irregularity(early_or_late) < 0.5
    assert motion.changing_pace(early_or_late) < 1.2
    assert motion.irregularity(even + rng.uniform(-0.003, 0.003, 300)) > 0.6
    slower = np.cumsum(np.where(np.arange(300) < 150, 0.01, 0.016))
    assert motion.changing_pace(slower) == pytest.approx(1.6)
