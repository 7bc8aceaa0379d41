"""A written plan, as other readers of ROS 2 see it."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from pipeline.errors import ArgumentError
from pipeline.formats.mcap.plan_writer import STATES_TOPIC, TRAJECTORY_TOPIC, TimedMotion, write_plan


def motion(count: int) -> TimedMotion:
    time = np.arange(count, dtype=np.int64) * 1_250_000_000
    values = np.arange(count * 3, dtype=float).reshape(count, 3)
    return TimedMotion(time, values, values + 0.5, -values)


def test_ros_reads_what_was_planned(tmp_path: Path) -> None:
    path = tmp_path / "plan.mcap"
    names = ("a", "bc", "def")
    write_plan(path, names, motion(3), motion(5), {"task": "table"})
    found: dict[str, list[object]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
    (trajectory,) = found[TRAJECTORY_TOPIC]
    assert list(trajectory.joint_names) == list(names)  # type: ignore[attr-defined]
    points = trajectory.points  # type: ignore[attr-defined]
    np.testing.assert_array_equal([point.positions for point in points], motion(3).positions)
    np.testing.assert_array_equal([point.velocities for point in points], motion(3).velocities)
    np.testing.assert_array_equal([point.accelerations for point in points], motion(3).accelerations)
    assert [(point.time_from_start.sec, point.time_from_start.nanosec) for point in points] == [
        (0, 0), (1, 250_000_000), (2, 500_000_000),
    ]  # fmt: skip
    np.testing.assert_array_equal([state.position for state in found[STATES_TOPIC]], motion(5).positions)  # type: ignore[attr-defined]
    before = path.read_bytes()
    write_plan(path, names, motion(3), motion(5), {"task": "table"})
    assert path.read_bytes() == before


def test_times_that_do_not_increase_are_refused() -> None:
    one = motion(3)
    with pytest.raises(ArgumentError, match="strictly increasing"):
        TimedMotion(one.time_ns[::-1].copy(), one.positions, one.velocities, one.accelerations)
    with pytest.raises(ArgumentError, match="one shape"):
        TimedMotion(one.time_ns, one.positions, one.velocities[:2], one.accelerations)
