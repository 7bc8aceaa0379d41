"""The text of a schema decides how its messages are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

from pipeline.errors import RecordingError
from pipeline.formats.mcap.declared_layout import MOST_CHARACTERS, declared
from pipeline.formats.mcap.joint_states import inspect_recording, read_joint_states
from tests.support.joint_bags import JOINT_STATE, ROS1_SCHEMA, SCHEMA, payload

SWAPPED = SCHEMA.replace(b"float64[] position\nfloat64[] velocity", b"float64[] velocity\nfloat64[] position")
IDL = b"""// generated
#include "std_msgs/msg/Header.idl"
module sensor_msgs { module msg {
/* a remark with struct JointState { long wrong; } in it */
@verbatim (language="comment", text="(no) struct JointState { long wrong; };")
struct JointState {
  std_msgs::msg::Header header;
  sequence<string> name;
  sequence<double> position;
  sequence< double > velocity;
  @unit("N")
  sequence<double> effort;
};
}; };
"""
NAMES = ("a", "b")


def write(
    path: Path, schema: bytes, data: list[bytes], schema_encoding: str = "ros2msg", encoding: str = "cdr"
) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        channel = writer.register_channel(
            "/arm", encoding, writer.register_schema(JOINT_STATE, schema_encoding, schema)
        )
        for number, message in enumerate(data):
            writer.add_message(channel, 10**9 * (number + 1), message, 10**9 * (number + 1))
        writer.finish()
    return path


def test_velocity_before_position_is_read_as_the_text_says(tmp_path: Path) -> None:
    # the helper writes its first array first, whatever it is called
    data = [payload(NAMES, [10.0 + i, 20.0 + i], 10**9 * (i + 1), velocity=[float(i), 2.0 * i]) for i in range(4)]
    path = write(tmp_path / "swapped.mcap", SWAPPED, data)

    found = read_joint_states(path)

    np.testing.assert_array_equal(found.positions, [[i, 2 * i] for i in range(4)])
    assert "the schema of /arm puts velocity, position, effort in this order" in found.remarks
    decoder = DecoderFactory().decoder_for("cdr", _schema(SWAPPED))
    assert decoder is not None
    np.testing.assert_array_equal([decoder(one).position for one in data], found.positions)


def _schema(text: bytes):  # type: ignore[no-untyped-def]
    from mcap.records import Schema

    return Schema(data=text, encoding="ros2msg", id=1, name=JOINT_STATE)


@pytest.mark.parametrize(
    ("encoding", "schema_encoding", "text"),
    [
        ("cdr", "ros2msg", SCHEMA),
        ("cdr", "ros2msg", SCHEMA.partition(b"====")[0]),
        ("cdr", "ros2msg", SCHEMA.replace(b"\n", b"\r\n")),
        ("cdr", "ros2msg", SCHEMA.replace(b"string[] name", b"uint8 MOST=8\nstring[] name  # joints")),
        ("cdr", "ros2idl", IDL),
        ("ros1", "ros1msg", ROS1_SCHEMA),
    ],
)
def test_the_usual_fields_are_the_usual_layout(encoding: str, schema_encoding: str, text: bytes) -> None:
    found = declared("/arm", encoding, schema_encoding, text)

    assert found.arrays == ("position", "velocity", "effort")
    assert found.position == 0
    assert found.said is None


def test_without_a_text_the_usual_fields_are_assumed_and_that_is_said() -> None:
    assert declared("/arm", "cdr", "ros2msg", b" ").said == (
        "the schema of /arm has no text, so the usual fields of JointState are assumed"
    )


OTHERS = {
    "float32": SCHEMA.replace(b"float64[] position", b"float32[] position"),
    "no position": SCHEMA.replace(b"float64[] position\n", b""),
    "a field before the names": SCHEMA.replace(b"string[] name", b"uint32 count\nstring[] name"),
    "a field behind": SCHEMA.replace(b"float64[] effort", b"float64[] effort\nstring note"),
    "one position": SCHEMA.replace(b"float64[] position", b"float64 position"),
    "a bounded array": SCHEMA.replace(b"float64[] position", b"float64[7] position"),
    "another header": SCHEMA.replace(b"string frame_id", b"uint32 seq\nstring frame_id"),
    "another time": SCHEMA.replace(b"uint32 nanosec", b"uint64 nanosec"),
    "a header of ROS 1": SCHEMA.replace(b"builtin_interfaces/Time stamp", b"uint32 seq\nbuiltin_interfaces/Time stamp"),
    "names elsewhere": SCHEMA.replace(b"string[] name\n", b"") + b"",
    "noise": b"\xff\x00{]",
    "position twice": SCHEMA.replace(b"velocity", b"position"),
    "protobuf": b"\n\x10sensor_msgs.proto",
}


@pytest.mark.parametrize("kind", OTHERS)
def test_other_fields_are_refused_and_named(tmp_path: Path, kind: str) -> None:
    data = [payload(NAMES, [float(i), 2.0 * i], 10**9 * (i + 1)) for i in range(4)]
    report = inspect_recording(write(tmp_path / "other.mcap", OTHERS[kind], data))

    assert report.reason == "unsupported-encoding"
    assert report.detail is not None
    assert report.detail.startswith("The schema of topic /arm declares a JointState of (")
    assert [topic.topic for topic in report.topics] == ["/arm"]


@pytest.mark.parametrize(
    ("encoding", "schema_encoding"),
    [("cdr", "protobuf"), ("cdr", "ros1msg"), ("cdr", "jsonschema"), ("ros1", "ros2msg"), ("cdr", "")],
)
def test_messages_and_schema_in_different_languages_are_refused(
    tmp_path: Path, encoding: str, schema_encoding: str
) -> None:
    path = write(tmp_path / "mixed.mcap", SCHEMA, [payload(NAMES, [1.0, 2.0])] * 3, schema_encoding, encoding)

    with pytest.raises(
        RecordingError, match=f"its messages are {encoding!r} and its schema {schema_encoding!r}"
    ) as error:
        read_joint_states(path)

    assert error.value.reason == "unsupported-encoding"


def test_another_topic_that_can_be_read_is_read(tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        odd = writer.register_channel("/odd", "cdr", writer.register_schema(JOINT_STATE, "protobuf", b"x"))
        good = writer.register_channel("/good", "cdr", writer.register_schema(JOINT_STATE, "ros2msg", SCHEMA))
        for number in range(3):
            data = payload(NAMES, [float(number), 1.0], 10**9 * (number + 1))
            for channel in (odd, good):
                writer.add_message(channel, number + 1, data, number + 1)
        writer.finish()

    assert read_joint_states(path).topic == "/good"
    with pytest.raises(RecordingError, match="Topic /odd says that its messages are 'cdr' and its schema 'protobuf'"):
        read_joint_states(path, "/odd")


@pytest.mark.parametrize(
    "piece", [b"/*", b"struct JointState {", b"=\n", b"MSG: a\n", b"@a(", b"uint8 A=1\n", b"struct "]
)
def test_a_text_costs_no_more_than_its_length(piece: bytes) -> None:
    text = (piece * MOST_CHARACTERS)[:MOST_CHARACTERS]
    for encoding in ("ros2msg", "ros2idl"):
        with pytest.raises(RecordingError, match="declares a JointState of"):
            declared("/arm", "cdr", encoding, text)


def test_a_text_that_is_too_long_is_not_looked_at() -> None:
    with pytest.raises(RecordingError, match="has 100001 bytes; at most 100000"):
        declared("/arm", "cdr", "ros2msg", b"x" * (MOST_CHARACTERS + 1))
