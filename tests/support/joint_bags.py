"""Slow, obvious bags of joint states: packed value by value, written and decoded by the official libraries."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

MAGIC = b"\x89MCAP0\r\n"
JOINT_STATE = "sensor_msgs/msg/JointState"
SCHEMA = (Path(__file__).parents[2] / "schemas/joint_state.ros2msg").read_bytes()

ROS1_SCHEMA = SCHEMA.partition(b"====")[0].replace(b"std_msgs/Header header", b"Header header") + (
    b"=" * 80 + b"\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
)


def payload(
    names: Sequence[str],
    position: Sequence[float],
    stamp_ns: int = 0,
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
    frame_id: str = "",
    order: str = "<",
) -> bytes:
    """One JointState message in XCDR1, little (`<`) or big (`>`) endian."""
    out = b""

    def put(kind: str, value: float) -> None:
        nonlocal out
        out += bytes(-len(out) % struct.calcsize(kind)) + struct.pack(order + kind, value)

    def put_text(text: str) -> None:
        nonlocal out
        put("I", len(text.encode()) + 1)
        out += text.encode() + b"\0"

    put("i", stamp_ns // 10**9)
    put("I", stamp_ns % 10**9)
    put_text(frame_id)
    put("I", len(names))
    for name in names:
        put_text(name)
    for values in (position, velocity, effort):
        put("I", len(values))
        for value in values:
            put("d", value)
    return bytes([0, 0 if order == ">" else 1, 0, 0]) + out


def write_bag(
    path: Path,
    messages: Iterable[tuple[str, int, bytes]],
    schema: str = JOINT_STATE,
    encoding: str = "cdr",
    compression: CompressionType = CompressionType.ZSTD,
    **options: object,
) -> Path:
    """Write `(topic, log_time_ns, payload)` messages; topics starting with /other get no schema."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, **options)
        writer.start("ros2", "test")
        ros1 = encoding == "ros1"
        schema_id = writer.register_schema(schema, "ros1msg" if ros1 else "ros2msg", ROS1_SCHEMA if ros1 else SCHEMA)
        channels: dict[str, int] = {}
        for topic, log_ns, data in messages:
            if topic not in channels:
                used = 0 if topic.startswith("/other") else schema_id
                channels[topic] = writer.register_channel(topic, encoding, used)
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()
    return path


def decoded(path: Path, topic: str | None = None) -> tuple[np.ndarray, list[list[str]], np.ndarray]:
    """Header stamps (M,) ns, names and positions (M, K) as the official decoder gives them."""
    stamps, names, positions = [], [], []
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for _, _, _, message in reader.iter_decoded_messages(topics=[topic] if topic else None):
            stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
            names.append(list(message.name))
            positions.append(list(message.position))
    return np.array(stamps), names, np.array(positions)


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def schema_record(schema_id: int = 1, name: str = JOINT_STATE) -> bytes:
    return record(
        3, struct.pack("<H", schema_id) + text(name) + text("ros2msg") + struct.pack("<I", len(SCHEMA)) + SCHEMA
    )


def channel_record(channel_id: int = 1, schema_id: int = 1, topic: str = "/joint_states") -> bytes:
    return record(4, struct.pack("<HH", channel_id, schema_id) + text(topic) + text("cdr") + struct.pack("<I", 0))


def message_record(data: bytes, log_ns: int, channel_id: int = 1) -> bytes:
    return record(5, struct.pack("<HIQQ", channel_id, 0, log_ns, log_ns) + data)


def chunk_record(stored: bytes, size: int, compression: str = "", crc: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, size, crc) + text(compression) + struct.pack("<Q", len(stored))
    return record(6, head + stored)


def file_of(*records: bytes, statistics: bytes = b"") -> bytes:
    """A file without CRCs and with the given records in its data section."""
    header = record(1, text("ros2") + text("test"))
    end = record(15, struct.pack("<I", 0))
    footer = record(2, struct.pack("<QQI", 0, 0, 0))
    return MAGIC + header + b"".join(records) + end + statistics + footer + MAGIC


def plain_chunk(*records: bytes) -> bytes:
    data = b"".join(records)
    return chunk_record(data, len(data), crc=zlib.crc32(data))
