"""Motions at a fixed rate, and what is no motion."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.formats.motions.named_motions import MOST_FRAMES, MotionSet, NamedMotion


def motion(seconds: float, name: str = "a") -> NamedMotion:
    time_ns = np.rint(np.linspace(0, seconds, 5) * 1e9).astype(np.int64)
    return NamedMotion(name, "p", 0, time_ns, np.stack([np.linspace(0, 1, 5), np.linspace(2, -2, 5)], axis=1))


def motions(*several: NamedMotion) -> MotionSet:
    return MotionSet("task", ("x", "y"), (True, False), several)


@pytest.mark.parametrize(("seconds", "frames"), [(1.0, 11), (1.04, 12), (0.01, 2)])
def test_at_a_rate_poses_are_on_the_same_lines_and_both_ends_are_kept(seconds: float, frames: int) -> None:
    (found,) = motions(motion(seconds)).sampled(10).motions
    np.testing.assert_array_equal(found.time_ns, np.arange(frames) * 100_000_000)
    np.testing.assert_allclose(found.positions[:-1, 0], found.time_s[:-1] / seconds, atol=1e-9)
    np.testing.assert_allclose(found.positions[:-1, 1], 2 - 4 * found.time_s[:-1] / seconds, atol=1e-9)
    np.testing.assert_array_equal(found.positions[[0, -1]], [[0, 2], [1, -2]])


def test_a_rate_that_would_fill_the_disk_is_refused_before_anything_is_made() -> None:
    with pytest.raises(ArgumentError, match="lower the rate"):
        motions(motion(MOST_FRAMES), motion(2.0, "b")).sampled(1.0)


def test_units_follow_the_joints() -> None:
    assert motions(motion(1.0)).units == ("m", "rad")


def test_what_is_no_motion_is_refused() -> None:
    good = motion(1.0)
    with pytest.raises(ArgumentError, match="different names"):
        motions(good, good)
    with pytest.raises(ArgumentError, match="one or more"):
        motions()
    with pytest.raises(ArgumentError, match="must have 1 joints"):
        MotionSet("task", ("x",), (True,), (good,))
    with pytest.raises(ArgumentError, match="strictly increasing"):
        NamedMotion("a", "p", 0, np.array([0, 0]), np.zeros((2, 1)))
    with pytest.raises(ArgumentError, match="finite pose"):
        NamedMotion("a", "p", 0, np.array([0, 1]), np.full((2, 1), np.nan))
