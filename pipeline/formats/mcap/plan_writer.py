"""Writing a planned motion for a controller: one JointTrajectory, and the same motion as joint states to look at."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import Writer

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError
from pipeline.formats.files.atomic import written_whole
from pipeline.formats.mcap.joint_state_cdr import encode_joint_states
from pipeline.formats.mcap.writer import LIBRARY

TRAJECTORY_TOPIC, STATES_TOPIC = "/plan/joint_trajectory", "/plan/joint_states"
_HEADER = b"\x00\x01\x00\x00"  # little-endian CDR


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """A motion over time.

    Attributes:
        time_ns: (M,) since its start, strictly increasing from 0.
        positions, velocities, accelerations: (M, J) rad or m, and their derivatives by s.
    """

    time_ns: IntArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    def __post_init__(self) -> None:
        shape = self.positions.shape
        if len(shape) != 2 or self.velocities.shape != shape or self.accelerations.shape != shape:
            raise ArgumentError("positions, velocities and accelerations must have one shape (M, J).")
        if self.time_ns.shape != shape[:1] or self.time_ns[0] != 0 or (np.diff(self.time_ns) <= 0).any():
            raise ArgumentError("time_ns must have one time for each pose, from 0 and strictly increasing.")


def write_plan(
    path: Path, names: Sequence[str], points: TimedMotion, states: TimedMotion, metadata: Mapping[str, str]
) -> None:
    """Write a plan as MCAP of ROS 2, whole or not at all; the same plan gives the same bytes.

    Args:
        path: the file to write or replace.
        names: J joints.
        points: of the JointTrajectory, on `TRAJECTORY_TOPIC`.
        states: the same motion as JointStates on `STATES_TOPIC`, as closely as it is to be looked at.
        metadata: what is said about the plan.
    """
    with written_whole(path) as stream:
        writer = Writer(stream, enable_data_crcs=True)
        writer.start(profile=Profile.ROS2, library=LIBRARY)
        writer.add_metadata("plan", dict(metadata))
        trajectory = _channel(writer, "trajectory_msgs/msg/JointTrajectory", "joint_trajectory", TRAJECTORY_TOPIC)
        joint_states = _channel(writer, "sensor_msgs/msg/JointState", "joint_state", STATES_TOPIC)
        writer.add_message(trajectory, 0, encode_joint_trajectory(names, points), 0, 0)
        arrays = (states.positions, states.velocities, np.empty((len(states.positions), 0)))
        rows = encode_joint_states(states.time_ns, names, arrays)
        for number, (time, row) in enumerate(zip(states.time_ns.tolist(), rows, strict=True)):
            writer.add_message(joint_states, time, row.tobytes(), time, number)
        writer.finish()  # type: ignore[no-untyped-call]


def _channel(writer: Writer, schema: str, file: str, topic: str) -> int:
    definition = (files("schemas") / f"{file}.ros2msg").read_bytes()
    return writer.register_channel(
        topic, MessageEncoding.CDR, writer.register_schema(schema, SchemaEncoding.ROS2, definition)
    )


def encode_joint_trajectory(names: Sequence[str], points: TimedMotion) -> bytes:
    """A JointTrajectory that starts when it is sent (stamp 0), as little-endian CDR."""
    body = bytearray(bytes(8))  # stamp

    def aligned(size: int) -> None:
        body.extend(bytes(-len(body) % size))

    def count(number: int) -> None:
        aligned(4)
        body.extend(struct.pack("<I", number))

    def text(value: str) -> None:
        encoded = value.encode() + b"\x00"
        count(len(encoded))
        body.extend(encoded)

    def numbers(values: FloatArray) -> None:
        count(len(values))
        if len(values):
            aligned(8)
            body.extend(np.ascontiguousarray(values, "<f8").tobytes())

    text("")  # frame_id
    count(len(names))
    for name in names:
        text(name)
    count(len(points.time_ns))
    for row, time in enumerate(points.time_ns.tolist()):
        for values in (points.positions[row], points.velocities[row], points.accelerations[row], np.empty(0)):
            numbers(values)
        aligned(4)
        body.extend(struct.pack("<iI", *divmod(time, 1_000_000_000)))
    return _HEADER + bytes(body)
