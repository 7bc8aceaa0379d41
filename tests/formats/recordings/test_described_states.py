"""JSON and Protobuf channels in MCAP: which fields are understood, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import RecordingError
from pipeline.formats.mcap.limits import Limits
from pipeline.formats.recordings.folders import bag_of
from pipeline.formats.recordings.readers import inspect, read_recording
from tests.support.recorded_forms import NAMES, SECOND, START, TOPIC, motion, write_json


def rejected(path: Path, **arguments: Any) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        read_recording(bag_of(path), **arguments)
    return caught.value


def stamp(time_ns: int, seconds: str = "sec", nanoseconds: str = "nanosec") -> dict[str, int]:
    return {seconds: time_ns // SECOND, nanoseconds: time_ns % SECOND}


MESSAGES: dict[str, Any] = {
    "as ROS": lambda t, q: {"header": {"stamp": stamp(t), "frame_id": ""}, "name": list(NAMES), "position": list(q)},
    "as rosbridge of ROS 1": lambda t, q: {
        "header": {"seq": 1, "stamp": stamp(t, "secs", "nsecs")}, "name": list(NAMES), "position": list(q)
    },
    "as Foxglove": lambda t, q: {"timestamp": stamp(t, "sec", "nsec"), "names": list(NAMES), "positions": list(q)},
    "others": lambda t, q: {"stamp": stamp(t, "seconds", "nanos"), "joint_names": list(NAMES), "position": list(q)},
}  # fmt: skip


@pytest.mark.parametrize("form", MESSAGES)
def test_json_messages_are_read(tmp_path: Path, form: str) -> None:
    recording = read_recording(bag_of(write_json(tmp_path / "a.mcap", MESSAGES[form])), joints=NAMES)
    times, positions = motion()
    assert recording.clock == "header"
    np.testing.assert_array_equal(recording.time_ns, times)
    np.testing.assert_array_equal(recording.positions, positions)
    assert inspect(bag_of(tmp_path / "a.mcap")).topics[0].encoding == "json"


def test_a_number_of_seconds_and_no_time_at_all(tmp_path: Path) -> None:
    times, _ = motion()
    path = write_json(
        tmp_path / "a.mcap", lambda t, q: {"timestamp": t / 1e9, "name": list(NAMES), "position": list(q)}
    )
    assert np.abs(read_recording(bag_of(path)).time_ns - times).max() < 1000  # what a float resolves
    path = write_json(tmp_path / "b.mcap", lambda t, q: {"name": list(NAMES), "position": list(q)})
    np.testing.assert_array_equal(read_recording(bag_of(path)).time_ns, times + 1000)  # when they were logged


def test_joints_may_come_in_messages_of_their_own(tmp_path: Path) -> None:
    def one(time_ns: int, row: np.ndarray) -> dict[str, Any]:
        return {"header": {"stamp": stamp(time_ns)}, "name": list(NAMES), "position": list(row)}

    path = write_json(tmp_path / "a.mcap", one)
    swapped = write_json(
        tmp_path / "b.mcap", lambda t, q: one(t, q) | ({"name": NAMES[::-1], "position": list(q[::-1])})
    )
    np.testing.assert_array_equal(
        read_recording(bag_of(path), joints=NAMES).positions, read_recording(bag_of(swapped), joints=NAMES).positions
    )


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ({"text": "hello"}, "no-joint-states"),
        ([1, 2], "no-joint-states"),
        (b"{", "corrupt"),
        (b"[" * 100_000, "corrupt"),
        ({"name": ["a", "b"], "position": [1]}, "corrupt"),
        ({"name": ["a", "a"], "position": [1, 2]}, "corrupt"),
        ({"name": [1], "position": [1]}, "corrupt"),
        ({"name": ["a"], "position": ["1"]}, "corrupt"),
        ({"name": ["a"], "position": [True]}, "corrupt"),
        ({"name": ["a"], "position": [[1]]}, "corrupt"),
        ({"name": ["a"], "position": 1}, "corrupt"),
        ({"name": [f"j{i}" for i in range(300)], "position": [0] * 300}, "corrupt"),
        (b'{"name": ["a"], "position": [1e999]}', "not-finite"),
        (b'{"name": ["a"], "position": [' + b"9" * 400 + b"]}", "corrupt"),
    ],
)
def test_json_that_is_no_pose_is_refused(tmp_path: Path, message: Any, reason: str) -> None:
    assert rejected(write_json(tmp_path / "a.mcap", lambda t, q: message)).reason == reason


def test_other_json_channels_stop_nothing(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels = {topic: writer.register_channel(topic, "json", 0) for topic in (TOPIC, "/scene", "/broken", "/log")}
        for time, row in zip(*motion(), strict=True):
            good = {"header": {"stamp": stamp(int(time))}, "name": list(NAMES), "position": list(row)}
            for topic, data in (
                ("/scene", b'"' + b"x" * (2 << 20) + b'"' if time == START else b"{}"), ("/broken", b"{"),
                ("/log", b'{"level": 3}'), (TOPIC, json.dumps(good).encode()),
            ):  # fmt: skip
                writer.add_message(channels[topic], int(time), data, int(time))
        writer.finish()
    recording = read_recording(bag_of(path), joints=NAMES)
    np.testing.assert_array_equal(recording.positions, motion()[1])
    assert recording.topic == TOPIC


def test_messages_are_counted_and_bounded(tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.mcap", MESSAGES["as ROS"])
    assert rejected(path, limits=Limits(steps=80)).reason == "too-large"
    assert rejected(path, limits=Limits(message_bytes=10)).reason == "too-large"
    assert rejected(path, limits=Limits(joint_values=100)).reason == "too-large"


# Protobuf

protobuf = pytest.importorskip("google.protobuf", reason="the extra `ros` is not installed")


def message_class(fields: dict[str, str], package: str = "arm") -> Any:
    """A class of messages: field -> type, `repeated` before it, `Timestamp`, or `Header` with a stamp."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    kinds = {"string": 9, "double": 1, "float": 2, "int32": 5}
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{package}.proto", package=package, syntax="proto3", dependency=["google/protobuf/timestamp.proto"]
    )
    header = file.message_type.add(name="Header")
    header.field.add(name="stamp", number=1, label=1, type=11, type_name=".google.protobuf.Timestamp")
    joints = file.message_type.add(name="Joints")
    for number, (name, kind) in enumerate(fields.items(), 1):
        repeated, kind = kind.startswith("repeated "), kind.removeprefix("repeated ")
        named = {"Timestamp": ".google.protobuf.Timestamp", "Header": f".{package}.Header"}.get(kind)
        if named:
            joints.field.add(name=name, number=number, label=1, type=11, type_name=named)
        else:
            joints.field.add(name=name, number=number, label=3 if repeated else 1, type=kinds[kind])
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.Joints"))


USUAL = {"header": "Header", "name": "repeated string", "position": "repeated double"}


def write_protobuf(path: Path, fields: dict[str, str], fill: Any) -> Path:
    from mcap_protobuf.writer import Writer

    kind = message_class(fields)
    with path.open("wb") as stream, Writer(stream) as writer:
        for time, row in zip(*motion(), strict=True):
            message = kind()
            fill(message, int(time), row)
            writer.write_message(TOPIC, message, int(time) + 1000, int(time) + 1000)
    return path


def usual(message: Any, time_ns: int, row: np.ndarray) -> None:
    message.header.stamp.seconds, message.header.stamp.nanos = divmod(time_ns, SECOND)
    message.name.extend(NAMES)
    message.position.extend(row)


def foxglove(message: Any, time_ns: int, row: np.ndarray) -> None:
    message.timestamp.seconds, message.timestamp.nanos = divmod(time_ns, SECOND)
    message.joint_names.extend(NAMES)
    message.positions.extend(row)


@pytest.mark.parametrize(
    ("fields", "fill"),
    [
        (USUAL, usual),
        ({"timestamp": "Timestamp", "joint_names": "repeated string", "positions": "repeated double"}, foxglove),
    ],
)
def test_protobuf_messages_are_read(tmp_path: Path, fields: dict[str, str], fill: Any) -> None:
    path = write_protobuf(tmp_path / "a.mcap", fields, fill)
    times, positions = motion()
    recording = read_recording(bag_of(path), joints=NAMES)
    np.testing.assert_array_equal(recording.time_ns, times)
    np.testing.assert_array_equal(recording.positions, positions)


def test_protobuf_without_a_time_has_that_of_the_log(tmp_path: Path) -> None:
    def fill(message: Any, time_ns: int, row: np.ndarray) -> None:
        message.name.extend(NAMES)
        message.position.extend(row)

    path = write_protobuf(tmp_path / "a.mcap", USUAL, fill)
    np.testing.assert_array_equal(read_recording(bag_of(path)).time_ns, motion()[0] + 1000)


def test_protobuf_of_other_fields_or_with_a_damaged_schema_is_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = write_protobuf(tmp_path / "a.mcap", {"text": "string"}, lambda message, t, q: setattr(message, "text", "x"))
    assert rejected(path).reason == "no-joint-states"
    path = write_protobuf(
        tmp_path / "b.mcap", USUAL | {"position": "double"}, lambda message, t, q: message.name.append("a")
    )
    assert rejected(path).reason == "corrupt"
    for data, payload in ((b"\xff\xff", b""), (b"", b""), (b"x" * (2 << 20), b"")):
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            schema = writer.register_schema("arm.Joints", "protobuf", data)
            writer.add_message(writer.register_channel(TOPIC, "protobuf", schema), 1, payload, 1)
            writer.finish()
        assert rejected(path).reason in ("corrupt", "too-large")


def test_a_damaged_protobuf_message_is_refused(tmp_path: Path) -> None:
    path = write_protobuf(tmp_path / "a.mcap", USUAL, usual)
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with path.open("rb") as stream:
        ((schema, _, message), *_) = make_reader(stream).iter_messages()
    other = tmp_path / "b.mcap"
    with other.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        number = writer.register_schema(schema.name, schema.encoding, schema.data)
        channel = writer.register_channel(TOPIC, "protobuf", number)
        writer.add_message(channel, 1, message.data[:-3], 1)
        writer.finish()
    assert rejected(other).reason == "corrupt"


def test_without_protobuf_a_sentence_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_protobuf(tmp_path / "a.mcap", USUAL, usual)

    def absent(name: str) -> Any:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("pipeline.formats.recordings.extras.import_module", absent)
    error = rejected(path)
    assert (error.reason, "library protobuf" in error.detail) == ("not-read", True)
    assert "`pip install 'lessbench[ros]'`" in error.detail


def test_other_json_is_left_alone_after_a_while_and_costs_no_more(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        talk, joints = writer.register_channel("/talk", "json", 0), writer.register_channel(TOPIC, "json", 0)
        for number in range(5000):
            writer.add_message(talk, START + number, json.dumps({"text": "x" * (100 + number)}).encode(), START)
        for time, row in zip(*motion(), strict=True):
            message = MESSAGES["as ROS"](int(time), row)
            writer.add_message(joints, int(time), json.dumps(message).encode(), int(time))
        writer.finish()
    recording = read_recording(bag_of(path), joints=NAMES, limits=Limits(steps=60_000))
    np.testing.assert_array_equal(recording.positions, motion()[1])
    assert {topic.topic: topic.joints for topic in inspect(bag_of(path)).topics} == {TOPIC: NAMES, "/talk": ()}
