"""Planned motions: JointTrajectory messages of ROS 1 and 2, deserialised by rosbags.

rosbags makes code from definitions and runs it. The definitions that it ships are used, never those of a file; a file
that declares other fields is refused.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

import numpy as np

from pipeline.formats.mcap.channels import Decoded, Decoding
from pipeline.formats.mcap.declared_layout import declared_types, fields_of, header_is_usual
from pipeline.formats.mcap.joint_state_cdr import MAX_JOINTS
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.recordings.extras import needed

SCHEMAS = ("trajectory_msgs/msg/JointTrajectory", "trajectory_msgs/JointTrajectory")
_KIND = SCHEMAS[0]
_POINT = ("positions", "velocities", "accelerations", "effort", "time_from_start")


def planned(topic: str, encoding: str, schema_encoding: str, text: bytes) -> Decoding:
    """How the messages of a channel of JointTrajectory are read.

    A point is a pose at the message's stamp and the point's `time_from_start`; a stamp of 0 stands for when the
    message was logged, as controllers take it.

    Args:
        topic: for messages.
        encoding: of the messages, `cdr` or `ros1`.
        schema_encoding, text: of the schema.

    Raises:
        RecordingError: unsupported-encoding, or not-read if rosbags is not installed.
    """
    _require_usual(topic, encoding, schema_encoding, text)
    store = _types(encoding)
    damaged = _errors()

    def decode(payload: bytes) -> Decoded:
        try:
            message = (store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr)(payload, _KIND)
            return _poses(topic, message)
        except damaged as error:
            raise rejection("corrupt", f"A JointTrajectory message on {topic} is not what its type says.") from error

    said = f"{topic} says where the arm was to be (JointTrajectory), and not where it was"
    return Decoding(decode, planned=True, said=said)


def _require_usual(topic: str, encoding: str, schema_encoding: str, text: bytes) -> None:
    types = declared_types(topic, encoding, schema_encoding, text, root="JointTrajectory")
    if types is None:
        return
    fields = types.get("", [])
    point = fields_of("JointTrajectoryPoint", types)
    usual = [name for _, name in fields] == ["header", "joint_names", "points"] and header_is_usual(
        fields[0][0], types, encoding
    )
    if not usual or (point is not None and tuple(name for _, name in point) != _POINT):
        raise rejection(
            "unsupported-encoding",
            f"The schema of topic {topic} declares a JointTrajectory of other fields than those of ROS, header, "
            f"joint_names and points of {', '.join(_POINT)}; convert the recording to {_KIND}.",
        )


def _poses(topic: str, message: Any) -> Decoded:
    names = tuple(str(name) for name in message.joint_names)
    if len(names) > MAX_JOINTS or len(set(names)) < len(names):
        raise rejection(
            "corrupt", f"A JointTrajectory message on {topic} names a joint twice, or more than {MAX_JOINTS}."
        )
    points = [point for point in message.points if len(point.positions)]
    if any(len(point.positions) != len(names) for point in points):
        raise rejection("corrupt", f"A JointTrajectory message on {topic} has points that are not of its joints.")
    start_ns = _ns(message.header.stamp)
    after_ns = np.array([_ns(point.time_from_start) for point in points], np.int64)
    positions = np.array([point.positions for point in points], np.float64).reshape(len(points), len(names))
    stamp_ns = np.full(len(points), start_ns, np.int64) if start_ns else None
    return Decoded(stamp_ns, names if points else (), positions if points else np.empty((0, 0)), after_ns)


def _ns(time: Any) -> int:
    """Seconds and nanoseconds as nanoseconds."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def _errors() -> tuple[type[Exception], ...]:
    found: type[Exception] = needed("rosbags.serde", "A JointTrajectory is read").SerdeError
    return (ValueError, LookupError, OverflowError, TypeError, struct.error, found)


@cache
def _types(encoding: str) -> Any:
    """The types that rosbags ships."""
    typesys = needed("rosbags.typesys", "A JointTrajectory is read")
    return typesys.get_typestore(typesys.Stores.ROS1_NOETIC if encoding == "ros1" else typesys.Stores.ROS2_HUMBLE)
