"""Writing joint states as the bag of a ROS 2 driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import Writer
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError
from pipeline.formats.files.atomic import written_whole
from pipeline.formats.mcap.joint_state_cdr import MAX_JOINTS, encode_joint_states

LIBRARY = "lessbench"
METADATA = "demonstration"  # the metadata record of an MCAP file that says who demonstrated
_SCHEMA_NAME = "sensor_msgs/msg/JointState"
_LAST_NS = (1 << 31) * 1_000_000_000 - 1  # the stamp's seconds are an int32
_BATCH = 4096


def write_joint_states(
    path: Path | str,
    time_ns: ArrayLike,
    names: Sequence[str],
    positions: ArrayLike,
    *,
    topic: str,
    metadata: Mapping[str, Mapping[str, str]],
    frame_id: str = "",
    log_time_ns: ArrayLike | None = None,
) -> None:
    """Write poses as `sensor_msgs/msg/JointState`, CDR in zstd chunks; the same input gives the same bytes.

    Velocities are the finite differences of the positions (second order inside, first order at the ends), efforts are
    left empty. The file appears whole or not at all.

    Args:
        path: the file to write or replace.
        time_ns: (M,) header stamps, M >= 2, not negative, strictly increasing.
        names: K different joints.
        positions: (M, K), finite, rad or m.
        topic: where the driver publishes.
        metadata: metadata records, name -> key -> text.
        frame_id: of the headers.
        log_time_ns: (M,) when the messages were logged, not negative; `time_ns` if None.

    Raises:
        ArgumentError: an argument is outside what is allowed.
    """
    stamp_ns = _times("time_ns", time_ns)
    log_ns = stamp_ns if log_time_ns is None else _times("log_time_ns", log_time_ns)
    poses = np.asarray(positions, np.float64)
    _check(stamp_ns, log_ns, names, poses)
    if not topic:
        raise ArgumentError("topic must be the name of the topic to publish on, got an empty text.")
    texts = [text for record in metadata.values() for item in record.items() for text in item]
    if not all(isinstance(text, str) for text in texts):
        raise ArgumentError(f"metadata must be records of text by text, got {metadata!r}.")
    velocities = np.gradient(poses, (stamp_ns - stamp_ns[0]) / 1e9, axis=0)
    efforts = np.empty((len(poses), 0))
    with written_whole(Path(path)) as stream:
        writer = Writer(stream, enable_data_crcs=True)
        writer.start(profile=Profile.ROS2, library=LIBRARY)
        for name, record in metadata.items():
            writer.add_metadata(name, dict(record))
        definition = (files("schemas") / "joint_state.ros2msg").read_bytes()
        schema_id = writer.register_schema(_SCHEMA_NAME, SchemaEncoding.ROS2, definition)
        channel_id = writer.register_channel(topic, MessageEncoding.CDR, schema_id)
        for start in range(0, len(poses), _BATCH):
            part = slice(start, start + _BATCH)
            arrays = (poses[part], velocities[part], efforts[part])
            rows = encode_joint_states(stamp_ns[part], names, arrays, frame_id)
            for i, row in enumerate(rows, start):
                writer.add_message(channel_id, int(log_ns[i]), row.tobytes(), int(stamp_ns[i]), i)
        writer.finish()  # type: ignore[no-untyped-call]


def _times(argument: str, value: ArrayLike) -> IntArray:
    times = np.asarray(value)
    if times.ndim != 1 or not np.issubdtype(times.dtype, np.integer) or len(times) < 2:
        raise ArgumentError(
            f"{argument} must be two or more integers (ns) in one dimension, got {times.dtype} of shape {times.shape}."
        )
    if times.min() < 0 or times.max() > _LAST_NS:
        raise ArgumentError(f"{argument} must lie in 0 to {_LAST_NS} ns, got {times.min()} to {times.max()}.")
    return times.astype(np.int64)


def _check(stamp_ns: IntArray, log_ns: IntArray, names: Sequence[str], positions: FloatArray) -> None:
    if (np.diff(stamp_ns) <= 0).any():
        raise ArgumentError("time_ns must increase from each pose to the next.")
    if log_ns.shape != stamp_ns.shape:
        raise ArgumentError(f"log_time_ns must have the shape {stamp_ns.shape} of time_ns, got {log_ns.shape}.")
    if not 0 < len(names) <= MAX_JOINTS or len(set(names)) < len(names) or any("\0" in name for name in names):
        raise ArgumentError(f"names must be 1 to {MAX_JOINTS} different joint names, got {tuple(names)!r}.")
    if positions.shape != (len(stamp_ns), len(names)):
        raise ArgumentError(f"positions must have shape {(len(stamp_ns), len(names))}, got {positions.shape}.")
    if not np.isfinite(positions).all():
        raise ArgumentError("positions must be finite.")
