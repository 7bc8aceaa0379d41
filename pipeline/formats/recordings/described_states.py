"""Joint states in messages that describe themselves: JSON, and Protobuf with its descriptors in the schema.

Understood are messages with these fields, as ROS names them:

- `name` (or `names`, `joint_names`): texts, the joints;
- `position` (or `positions`): as many numbers, rad or m;
- when it was: `header.stamp`, or `stamp` or `timestamp`, of `sec` (`secs`, `seconds`) and `nanosec` (`nsec`, `nsecs`,
  `nanos`), such as google.protobuf.Timestamp; in JSON also a number of seconds. Without one, the log time.

A message without positions holds no pose; everything else in a message is passed over.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.formats.mcap.channels import Decoded, Decoding
from pipeline.formats.mcap.joint_state_cdr import MAX_JOINTS
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.recordings.extras import needed

NAMES = ("name", "names", "joint_names")
POSITIONS = ("position", "positions")
STAMPS = ("stamp", "timestamp")
SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")
LARGEST_SCHEMA = 1 << 20  # bytes
_NO_POSE = Decoded(None, (), np.empty((1, 0)))
_LAST_S = 1 << 33


def json_states(topic: str) -> Decoding:
    """How the messages of a JSON channel are read; those without joints hold no pose."""

    def decode(payload: bytes) -> Decoded:
        try:
            message = json.loads(payload)
        except (ValueError, RecursionError) as error:
            raise rejection("corrupt", f"A message on {topic} is no JSON text.") from error
        return _decoded(topic, message) if isinstance(message, dict) else _NO_POSE

    return Decoding(decode, sure=False)


def protobuf_states(topic: str, type_name: str, descriptors: bytes) -> Decoding | None:
    """How the messages of a Protobuf channel are read; None if their type has no field of names and of positions.

    Args:
        topic: for messages.
        type_name: full name of the messages' type.
        descriptors: a FileDescriptorSet with that type and all that it uses.

    Raises:
        RecordingError: too-large, corrupt, or not-read if protobuf is not installed.
    """
    if len(descriptors) > LARGEST_SCHEMA:
        raise rejection(
            "too-large", f"The schema of topic {topic} has {len(descriptors)} bytes; at most {LARGEST_SCHEMA}."
        )
    what = f"Topic {topic} is in Protobuf, which is read"
    descriptor_pb2 = needed("google.protobuf.descriptor_pb2", what)
    pools, factory = needed("google.protobuf.descriptor_pool", what), needed("google.protobuf.message_factory", what)
    decode_error = needed("google.protobuf.message", what).DecodeError
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(descriptors)
        pool = pools.DescriptorPool()
        for file in files.file:
            pool.Add(file) if hasattr(pool, "Add") else pool.AddSerializedFile(file.SerializeToString())
        kind = pool.FindMessageTypeByName(type_name)
        fields = set(kind.fields_by_name)
        message_class = factory.GetMessageClass(kind)
    except (decode_error, KeyError, TypeError, ValueError) as error:
        raise rejection(
            "corrupt", f"The schema of topic {topic} does not describe its type {type_name!r} in Protobuf."
        ) from error
    if fields.isdisjoint(NAMES) or fields.isdisjoint(POSITIONS):
        return None

    def decode(payload: bytes) -> Decoded:
        try:
            message = message_class.FromString(payload)
        except decode_error as error:
            raise rejection("corrupt", f"A message on {topic} is no {type_name} in Protobuf.") from error
        return _decoded(topic, _Fields(message))

    return Decoding(decode)


class _Fields(Mapping[str, Any]):
    """The fields of a Protobuf message by name, those that are not set left out."""

    def __init__(self, message: Any) -> None:
        self._message = message

    def __getitem__(self, key: str) -> Any:
        field = self._message.DESCRIPTOR.fields_by_name[key]
        value = getattr(self._message, key)
        if field.message_type is None or hasattr(value, "__len__"):
            return value
        if not self._message.HasField(key):
            raise KeyError(key)
        return _Fields(value)

    def __iter__(self) -> Any:
        return iter(self._message.DESCRIPTOR.fields_by_name)

    def __len__(self) -> int:
        return len(self._message.DESCRIPTOR.fields_by_name)


def _decoded(topic: str, message: Mapping[str, Any]) -> Decoded:
    names, positions = _first(message, NAMES), _first(message, POSITIONS)
    if names is None or positions is None:
        return _NO_POSE
    try:
        found = tuple(names)
        values = np.array([float(value) if not isinstance(value, str | bytes | bool) else None for value in positions])
    except (TypeError, ValueError, OverflowError) as error:
        raise _unlike(topic) from error
    if values.dtype != np.float64 and len(values):
        raise _unlike(topic)
    if not len(values):
        return _NO_POSE
    if not all(isinstance(name, str) and name for name in found) or len(found) != len(values):
        raise _unlike(topic)
    if len(found) > MAX_JOINTS or len(set(found)) < len(found):
        raise rejection("corrupt", f"A message on {topic} names a joint twice, or more than {MAX_JOINTS}.")
    stamp_ns = _stamp_ns(message)
    return Decoded(None if stamp_ns is None else np.array([stamp_ns]), found, values[None])


def _unlike(topic: str) -> Exception:
    return rejection("corrupt", f"A message on {topic} has not as many numbers in its positions as texts in its names.")


def _stamp_ns(message: Mapping[str, Any]) -> int | None:
    """When the message says that it was, in ns."""
    header = message.get("header")
    within = [header] if isinstance(header, Mapping) else []
    stamp = next((found for one in (*within, message) if (found := _first(one, STAMPS)) is not None), None)
    if isinstance(stamp, Mapping):
        return _whole(_first(stamp, SECONDS), 1_000_000_000) + _whole(_first(stamp, NANOSECONDS), 1)
    if isinstance(stamp, int | float) and not isinstance(stamp, bool) and math.isfinite(stamp) and abs(stamp) < _LAST_S:
        return round(stamp * 1e9)
    return None


def _whole(value: Any, unit_ns: int) -> int:
    """A part of a time in ns; 0 if it is none."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        return 0
    return round(value * unit_ns) if abs(value) < (_LAST_S * 1_000_000_000) // unit_ns else 0


def _first(message: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    return next((value for key in keys if (value := message.get(key)) is not None), None)
