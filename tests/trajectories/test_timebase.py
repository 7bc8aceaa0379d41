"""The time base: closed forms, invariants, and one real recording that needs all of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.errors import ArgumentError, RecordingError
from pipeline.trajectories.timebase import (
    TURN,
    moving_part,
    resample,
    to_branch,
    trim_idle,
    unwrap,
)

REAL = Path(__file__).resolve().parents[2] / "../shared/real/jaco"
JACO_CONTINUOUS = np.array([True, False, True, False, True, False, True])
JACO_START = np.deg2rad([104.2, 151.6, 183.8, 101.8, 224.2, 216.9, 310.8])

angles = st.floats(-20, 20)
trajectories = st.integers(2, 30).flatmap(lambda m: arrays(np.float64, (m, 3), elements=angles))
FREE = np.array([True, False, True])


def reach(rate_hz: float, rest_s: float = 2.0, move_s: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """Rest, a straight reach of 1 rad and -0.5 rad in two joints, rest."""
    time_s = np.arange(round((2 * rest_s + move_s) * rate_hz) + 1) / rate_hz
    progress = np.clip((time_s - rest_s) / move_s, 0, 1)
    return time_s, progress[:, None] * [1.0, -0.5, 0.0]


# unwrap


def test_a_turning_joint_is_unwrapped_and_a_limited_one_is_left_alone() -> None:
    angle = np.linspace(0, 4 * np.pi, 50)
    wrapped = np.stack([np.angle(np.exp(1j * angle))] * 2, axis=1)
    result = unwrap(wrapped, np.array([True, False]))
    np.testing.assert_allclose(result[:, 0], angle, atol=1e-13)
    np.testing.assert_array_equal(result[:, 1], wrapped[:, 1])


@given(trajectories)
def test_unwrapping_keeps_the_start_and_shifts_by_whole_turns(q: np.ndarray) -> None:
    result = unwrap(q, FREE)
    np.testing.assert_array_equal(result[0], q[0])
    np.testing.assert_array_equal(result[:, 1], q[:, 1])
    turns = (result - q) / TURN
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-12)
    assert np.abs(np.diff(result[:, FREE], axis=0)).max() <= np.pi + 1e-12


@given(trajectories)
def test_unwrapping_twice_is_unwrapping_once(q: np.ndarray) -> None:
    once = unwrap(q, FREE)
    # steps of exactly half a turn may go either way after rounding
    if np.abs(np.abs(np.diff(once[:, FREE], axis=0)) - np.pi).min() > 1e-9:
        np.testing.assert_array_equal(unwrap(once, FREE), once)


@given(trajectories)
def test_unwrapping_does_not_see_the_turns_a_driver_adds(q: np.ndarray) -> None:
    smooth = np.cumsum(q / 20, axis=0)  # steps of at most 1 rad
    wrapped = smooth.copy()
    wrapped[:, FREE] = np.angle(np.exp(1j * smooth[:, FREE]))
    result = unwrap(wrapped, FREE)
    np.testing.assert_allclose(result - result[0], smooth - smooth[0], atol=1e-12)


# branch


@given(trajectories, arrays(np.float64, 3, elements=angles))
def test_the_branch_starts_within_half_a_turn_of_the_reference(q: np.ndarray, reference: np.ndarray) -> None:
    result = to_branch(q, reference, FREE)
    assert (np.abs(result[0] - reference)[FREE] <= np.pi + 1e-12).all()
    np.testing.assert_array_equal(result[:, 1], q[:, 1])
    np.testing.assert_allclose(np.diff(result, axis=0), np.diff(q, axis=0), atol=1e-13)


def test_the_branch_of_the_reference_is_kept() -> None:
    q = np.array([[0.5, 6.0, -3.0], [0.6, 6.1, -2.0]])
    np.testing.assert_array_equal(to_branch(q, [0.0, 0.0, 0.0], FREE), q)
    np.testing.assert_allclose(to_branch(q, [7.0, 0.0, -15.0], FREE), q + np.array([TURN, 0, -2 * TURN]), atol=1e-14)


# trim


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 100.0, 1000.0])
def test_trimming_finds_the_motion_at_any_rate(rate_hz: float) -> None:
    time_s, q = reach(rate_hz)
    moving = trim_idle(time_s, q, 0.01)
    # joint 1 moves 0.25 rad/s, so it is 0.04 s after the start of the motion before it has gone 0.01 rad
    assert -1 / rate_hz <= time_s[moving.start] - 2.0 <= 0.04
    assert -0.04 <= time_s[moving.stop - 1] - 6.0 <= 1 / rate_hz


def test_neighbours_closer_than_the_threshold_do_not_end_the_motion() -> None:
    time_s, q = reach(1000.0)
    assert np.abs(np.diff(q, axis=0)).max() < 0.01 / 30
    moving = trim_idle(time_s, q)
    assert time_s[moving.stop - 1] - time_s[moving.start] > 3.9


def test_noise_at_rest_is_rest() -> None:
    time_s, q = reach(100.0)
    noisy = q + np.random.default_rng(0).uniform(-0.002, 0.002, q.shape)
    moving = trim_idle(time_s, noisy)
    # the motion shows after 0.01 -+ 0.004 rad at 0.25 rad/s
    assert 0.024 - 0.01 <= time_s[moving.start] - 2.0 <= 0.056
    assert -0.056 <= time_s[moving.stop - 1] - 6.0 <= 0.01 - 0.024


def test_a_recording_without_rest_is_kept_whole() -> None:
    time_s, q = reach(10.0, rest_s=0.0)
    assert trim_idle(time_s, q) == slice(0, len(q))
    assert trim_idle([0.0, 1.0], [[0.0], [0.02]]) == slice(0, 2)


def test_a_pause_on_the_way_and_a_return_to_the_start_are_motion() -> None:
    q = np.array([0, 0, 0, 1, 1, 1, 1, 0, 0, 0], float)[:, None]
    assert trim_idle(np.arange(10), q) == slice(2, 8)


@pytest.mark.parametrize("path", [[0, 0, 0], [0, 0.009, 0], [0, 0.006, 0.012], [0, 0.004, 0.005, 0.006, 0.012, 0.009]])
def test_an_arm_that_rests_throughout_does_not_move(path: list[float]) -> None:
    with pytest.raises(RecordingError, match="does not move") as caught:
        trim_idle(np.arange(len(path)), np.array(path)[:, None])
    assert caught.value.reason == "does-not-move"


@given(arrays(np.float64, st.tuples(st.integers(2, 40), st.just(2)), elements=st.floats(-0.03, 0.03)))
def test_trimming_keeps_a_piece_that_reaches_from_rest_to_rest_or_refuses(q: np.ndarray) -> None:
    try:
        moving = trim_idle(np.arange(len(q)), q)
    except RecordingError:
        assert np.abs(q - q[0]).max() <= 0.03 + 1e-12  # two overlapping balls of rest, 0.01 around each end
        return
    assert 0 <= moving.start < moving.stop - 1 < len(q)
    assert np.abs(q[: moving.start + 1] - q[0]).max() <= 0.01
    assert np.abs(q[moving.stop - 1 :] - q[-1]).max() <= 0.01


# resample


@given(
    st.sets(st.integers(0, 10**6), min_size=2, max_size=40),
    st.integers(2, 60),
    st.tuples(angles, angles),
    st.tuples(angles, angles),
)
def test_a_linear_motion_is_resampled_exactly(times: set, count: int, start: tuple, speed: tuple) -> None:
    time_s = np.array(sorted(times)) / 1e3
    q = np.array(start) + (time_s - time_s[0])[:, None] * np.array(speed)
    grid = np.linspace(0, time_s[-1] - time_s[0], count)[:, None]
    # interpolation divides differences of values up to 2e4, which are rounded at 4e-12, and of times
    np.testing.assert_allclose(resample(time_s, q, count), np.array(start) + grid * np.array(speed), atol=1e-10)


@given(trajectories, st.integers(2, 60))
def test_both_ends_come_out_exactly_and_nothing_overshoots(q: np.ndarray, count: int) -> None:
    waypoints = resample(np.arange(len(q)) / 7, q, count)
    np.testing.assert_array_equal(waypoints[[0, -1]], q[[0, -1]])
    assert (waypoints >= q.min(axis=0) - 1e-12).all()
    assert (waypoints <= q.max(axis=0) + 1e-12).all()


def test_uneven_times_are_interpolated_in_time() -> None:
    np.testing.assert_allclose(resample([0, 1, 4], [[0.0], [1.0], [7.0]], 5)[:, 0], [0, 1, 3, 5, 7], atol=1e-14)


# all together


def test_a_demonstration_is_unwrapped_trimmed_shifted_and_resampled() -> None:
    time_s, q = reach(100.0)
    recorded = np.angle(np.exp(1j * (q + 3.0)))  # joint 1 passes through pi on its way
    part = moving_part(time_s, recorded, np.ones(3, bool))
    waypoints, start_s, duration_s = (
        part.waypoints([3.0 + 2 * TURN, 2.0, 3.0], np.ones(3, bool), 41), part.start_s, part.duration_s
    )  # fmt: skip
    assert waypoints.shape == (41, 3)
    assert start_s == pytest.approx(2.04, abs=0.0101)
    assert start_s + duration_s == pytest.approx(5.96, abs=0.0101)
    at_s = start_s + duration_s * np.arange(41) / 40
    expected = 3.0 + ((at_s - 2) / 4)[:, None] * [1.0, -0.5, 0.0] + [2 * TURN, 0.0, 0.0]
    np.testing.assert_allclose(waypoints, expected, atol=1e-12)


@pytest.mark.skipif(not REAL.is_dir(), reason="the shared real recordings are not beside the repository")
def test_the_real_recording_comes_out_on_the_branch_of_the_alternatives() -> None:
    from pipeline.formats.mcap.joint_states import read_joint_states

    joints = [f"j2s7s300_joint_{i}" for i in range(1, 8)]
    recording = read_joint_states(REAL / "recordings/kinesthetic_ID0_task0.mcap", joints=joints)
    time_s = (recording.time_ns - recording.time_ns[0]) / 1e9
    assert recording.positions[0, 2] == pytest.approx(-3.075, abs=1e-3)
    part = moving_part(time_s, recording.positions, JACO_CONTINUOUS)
    waypoints = part.waypoints(JACO_START, JACO_CONTINUOUS, 41)
    assert (part.start_s, part.duration_s) == (0.0, 20.0)
    assert waypoints[0, 2] == pytest.approx(3.208, abs=1e-3)
    np.testing.assert_allclose(waypoints[0], JACO_START, atol=np.deg2rad(5))
    # 41 samples at 0.5 s onto 41 waypoints over 20 s: only joint 3 changes
    expected = recording.positions + TURN * np.eye(7)[2]
    np.testing.assert_allclose(waypoints, expected, atol=1e-12)


# arguments

POSES, TIMES, START = np.zeros((3, 2)) + np.arange(3)[:, None], np.arange(3.0), np.zeros(2)
BOTH = np.ones(2, bool)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("q", lambda: unwrap(np.zeros(3), BOTH)),
        ("q", lambda: unwrap(np.zeros((1, 2)), BOTH)),
        ("q", lambda: to_branch(np.array([[0.0, np.nan]] * 2), START, BOTH)),
        ("continuous", lambda: unwrap(POSES, [True])),
        ("continuous", lambda: unwrap(POSES, [0, 1])),
        ("reference", lambda: to_branch(POSES, [0.0], BOTH)),
        ("reference", lambda: to_branch(POSES, [0.0, np.inf], BOTH)),
        ("time_s", lambda: resample(TIMES[:2], POSES, 4)),
        ("time_s", lambda: resample([0, 1, 1], POSES, 4)),
        ("time_s", lambda: trim_idle([0, np.nan, 1], POSES)),
        ("waypoint_count", lambda: resample(TIMES, POSES, 1)),
        ("threshold_rad", lambda: trim_idle(TIMES, POSES, -0.1)),
        ("threshold_rad", lambda: trim_idle(TIMES, POSES, np.nan)),
    ],
)
def test_arguments_outside_what_is_allowed_are_named(name: str, call: object) -> None:
    with pytest.raises(ArgumentError, match=f"^{name} must"):
        call()


def test_arguments_are_not_changed() -> None:
    q = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 0.0]])
    before = q.copy()
    unwrap(q, BOTH)
    to_branch(q, [9.0, 9.0], BOTH)
    moving_part(TIMES, q, BOTH).waypoints(START, BOTH, 5)
    np.testing.assert_array_equal(q, before)
