"""Hands that wander as measured: the reference against the recordings, and simulated motions against the reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.trajectories.measured_hand import (
    LENGTH,
    LEVELS,
    MODES,
    SHARES,
    UNEVENNESS,
    Habit,
    draw_habit,
    measure,
    uneven_speed,
    wandering,
)
from pipeline.trajectories.participants import Hand, demonstrate
from pipeline.trajectories.random_streams import child_rng

STRAIGHT = np.linspace(0, 1, 41)[:, None] * np.array([2.0, 0, 0, 0.5, 0, 0, 0])
FREE = np.full(7, np.inf)


def test_the_reference_is_what_the_recordings_have(shared: Path) -> None:
    from benchmarks.measured_hand import reference

    real = shared / "real/jaco"
    paths = sorted([*real.glob("twelve/*/*.mcap"), *real.glob("recordings/*.mcap")])
    assert len(paths) == 81
    joints = [f"j2s7s300_joint_{i}" for i in range(1, 8)]
    length, unevenness, shares = reference(paths, "/j2s7s300_driver/out/joint_state", joints)
    np.testing.assert_allclose(LENGTH, length, rtol=1e-3)  # the constants have four digits
    np.testing.assert_allclose(UNEVENNESS, unevenness, rtol=1e-3)
    np.testing.assert_allclose(SHARES, shares, rtol=1e-3)


def test_what_is_measured_in_closed_form() -> None:
    habit, _ = measure(STRAIGHT + 1e-9 * np.sin(np.pi * np.linspace(0, 1, 41))[:, None])
    assert habit.length == pytest.approx(1)
    assert habit.unevenness == pytest.approx(1)
    s = np.linspace(0, 1, 4001)
    # a half circle is pi / 2 times as long as its diameter; mean v^2 / (mean v)^2 of v ~ s is (1/3) / (1/4)
    angle = np.pi * s**2
    habit, _ = measure(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert habit.length == pytest.approx((np.pi / 2) ** 2, rel=1e-4)
    assert habit.unevenness == pytest.approx(4 / 3, rel=1e-3)
    bent = STRAIGHT.copy()
    bent[:, 1] += 3 * np.sin(2 * np.pi * np.linspace(0, 1, 41))
    bent[:, 2] += 4 * np.sin(3 * np.pi * np.linspace(0, 1, 41))
    _, shares = measure(bent)
    np.testing.assert_allclose(shares[:4], [0, 9 / 25, 16 / 25, 0], atol=1e-12)


def test_habits_follow_the_quantiles() -> None:
    rng = np.random.default_rng(5)
    habits = [draw_habit(rng) for _ in range(4000)]
    for values, reference in (
        ([habit.length for habit in habits], LENGTH), ([habit.unevenness for habit in habits], UNEVENNESS)
    ):  # fmt: skip
        shares = np.searchsorted(np.sort(values), reference) / 4000
        np.testing.assert_allclose(shares, LEVELS, atol=4 * 0.5 / np.sqrt(4000))  # four standard errors of a share


@pytest.mark.parametrize("length", [1.5, 4.0, 20.0])
def test_a_path_becomes_as_long_as_asked_and_keeps_its_ends(length: float) -> None:
    path = wandering(np.random.default_rng(1), STRAIGHT, length)
    assert measure(path)[0].length == pytest.approx(length, rel=1e-9)
    np.testing.assert_array_equal(path[[0, -1]], STRAIGHT[[0, -1]])
    assert wandering(np.random.default_rng(1), path, length / 2) is path  # as long already


def test_speeds_become_as_uneven_as_asked() -> None:
    s = np.linspace(0, 1, 801)
    ramp = np.minimum(1, np.minimum(s, 1 - s) / 0.12)
    speed = uneven_speed(np.random.default_rng(2), ramp, 1.4)
    covered = np.cumsum(speed) / speed.sum()
    moving = speed[(covered > 0.0025) & (covered < 0.9975)]
    assert (moving**2).mean() / moving.mean() ** 2 == pytest.approx(1.4, rel=1e-6)
    assert uneven_speed(np.random.default_rng(2), ramp, 1.0) is ramp


def test_simulated_hands_are_as_wasteful_and_uneven_as_real_ones() -> None:
    """Medians of 200 hands against the reference; the shapes too."""
    found, shares = [], []
    for i in range(200):
        habit = draw_habit(child_rng(3, i))
        motion = demonstrate(
            child_rng(3, i, "hand"), STRAIGHT, 0.5, Hand(), habit, lower=-FREE, upper=FREE,
            admissible=lambda w: np.ones(len(w), dtype=bool),
        )  # fmt: skip
        away = np.abs(motion.positions - motion.positions[0]).max(axis=1) > 0.01
        before = np.abs(motion.positions - motion.positions[-1]).max(axis=1) > 0.01
        first, last = int(away.argmax()), len(before) - int(before[::-1].argmax())
        moving, times = motion.positions[first:last], motion.time_s[first:last]
        even = np.linspace(times[0], times[-1], 41)
        waypoints = np.stack([np.interp(even, times, joint) for joint in moving.T], axis=1)
        measured, share = measure(waypoints)
        found.append(measured)
        shares.append(share)
    half = LEVELS.index(0.5)
    # a median of 200 of these distributions has a standard error of about 6 and 1 percent
    assert np.median([habit.length for habit in found]) == pytest.approx(LENGTH[half], rel=0.2)
    assert np.median([habit.unevenness for habit in found]) == pytest.approx(UNEVENNESS[half], rel=0.04)
    # the mean of a ratio of normal heights is less uneven than the ratio of their variances
    np.testing.assert_allclose(np.mean(shares, axis=0)[:3], SHARES[:3], atol=0.08)
    assert len(SHARES) == MODES


def test_a_hand_without_a_habit_moves_as_before() -> None:
    hand = Hand(duration_s=(8, 8))
    one, other = (
        demonstrate(
            child_rng(1), STRAIGHT, 0.5, hand, habit, lower=-FREE, upper=FREE,
            admissible=lambda w: np.ones(len(w), dtype=bool),
        )
        for habit in (None, Habit(9.0, 1.3))
    )  # fmt: skip
    lengths = [measure(motion.positions)[0].length for motion in (one, other)]
    assert lengths[0] < 1.3
    assert lengths[1] == pytest.approx(9.0, rel=0.1)  # but for misplaced ends
