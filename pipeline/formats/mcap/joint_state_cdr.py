"""JointState messages, many at a time: bytes to arrays, from plain CDR (XCDR1) and from ROS 1, and back to CDR.

Layout, offsets counted from behind the first 4 bytes, in CDR numbers aligned to their own size:
stamp int32 s, uint32 ns · frame_id string · name string[] · position float64[] · velocity float64[] · effort float64[].
The first 4 bytes are the encapsulation header in CDR, the running number of the message in ROS 1, where nothing is
aligned. A string is its length as uint32, in CDR with the closing NUL, then the bytes; a sequence is its length as
uint32, then the elements.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import ByteArray, FloatArray, IndexArray, IntArray
from pipeline.formats.mcap.rejection_reasons import rejection

MAX_JOINTS = 256
ENCODINGS = ("cdr", "ros1")
_HEADER = 4  # encapsulation, or the running number
_SHARED_LAYOUTS = 16
_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}


@dataclass(frozen=True)
class JointBlock:
    """Poses with the same joint names.

    Attributes:
        stamp_ns: header stamps, (k,) int64.
        names: joints, in the messages' order.
        positions: (k, len(names)) rad or m, any value.
    """

    stamp_ns: IntArray
    names: tuple[str, ...]
    positions: FloatArray


@dataclass(frozen=True)
class _Wire:
    order: str  # '<' or '>'
    aligned: bool  # numbers, to their own size
    closed: bool  # strings, by a NUL
    fixed: int  # bytes at the start that are the same in all messages

    def start(self, at: int, size: int) -> int:
        """Where a number of `size` bytes begins that comes at `at` or behind."""
        return _aligned(at, size) if self.aligned else at


_ROS1 = _Wire("<", aligned=False, closed=False, fixed=0)


@dataclass(frozen=True)
class _Layout:
    wire: _Wire
    names: tuple[str, ...]
    arrays: tuple[tuple[int, int], ...]  # start, count of position, velocity, effort, in the order of the schema
    position: int  # which of them that is

    def fixed(self) -> tuple[slice, ...]:
        """The bytes that make the layout what it is: all but the stamp and the numbers."""
        stops = [start + 8 * count for start, count in self.arrays]
        starts = [_HEADER + 8, *stops[:-1]]
        spans = zip(starts, (start for start, _ in self.arrays), strict=True)
        return (slice(0, self.wire.fixed), *(slice(start, stop) for start, stop in spans))


def decode_joint_states(
    payloads: ByteArray, encoding: str = "cdr", arrays: int = 3, position: int = 0
) -> Iterator[tuple[IndexArray, JointBlock]]:
    """Decode messages of equal length, all that share a layout in one step.

    Args:
        payloads: (k, n) bytes, one message a row.
        encoding: one of `ENCODINGS`.
        arrays: how many arrays of float64 follow the names, by the schema.
        position: which of them has the positions.

    Yields:
        The rows each block holds, ascending, and the block; messages without positions give a block of no joints.

    Raises:
        RecordingError: corrupt, unsupported-encoding.
    """
    rest = np.arange(len(payloads))
    for _ in range(_SHARED_LAYOUTS):
        if not len(rest):
            return
        rows = payloads[rest]
        layout = _layout(rows[0].tobytes(), encoding, arrays, position)
        same = np.logical_and.reduce([(rows[:, span] == rows[0, span]).all(axis=1) for span in layout.fixed()])
        yield rest[same], _block(rows[same], layout)
        rest = rest[~same]
    # a bag has a layout per driver; looking for the mates of each message would be quadratic where every one differs
    for row in rest[:, None]:
        yield row, _block(payloads[row], _layout(payloads[row].tobytes(), encoding, arrays, position))


def _block(payloads: ByteArray, layout: _Layout) -> JointBlock:
    def numbers(start: int, count: int, kind: str) -> NDArray[Any]:
        dtype = np.dtype(layout.wire.order + kind)
        return np.ascontiguousarray(payloads[:, start : start + count * dtype.itemsize]).view(dtype)

    seconds, nanoseconds = numbers(_HEADER, 1, "i4"), numbers(_HEADER + 4, 1, "u4")
    start, count = layout.arrays[layout.position]
    positions = numbers(start, count, "f8") if count else np.empty((len(payloads), 0))
    return JointBlock(
        stamp_ns=(seconds.astype(np.int64) * 1_000_000_000 + nanoseconds)[:, 0],
        names=layout.names if count else (),
        positions=positions.astype(np.float64),
    )


def _layout(payload: bytes, encoding: str, count_of_arrays: int, position: int) -> _Layout:
    if len(payload) < _HEADER:
        raise rejection("corrupt", f"A JointState message has {len(payload)} bytes, too few for any message.")
    wire = _ROS1 if encoding == "ros1" else _cdr(payload)
    try:
        at, names = _names(payload, wire)
        arrays = []
        for _ in range(count_of_arrays):
            at, count = _count(payload, wire, at)
            start = wire.start(at, 8) if count else at
            at = start + 8 * count
            arrays.append((start, count))
    except (struct.error, UnicodeDecodeError) as error:
        raise rejection("corrupt", "A JointState message is shorter than it states, or a name is not text.") from error
    if at > len(payload):
        raise rejection("corrupt", f"A JointState message states {at} bytes and has {len(payload)}.")
    positions = arrays[position][1]
    if positions not in (0, len(names)):
        raise rejection("corrupt", f"A JointState message has {len(names)} names for {positions} positions.")
    if len(set(names)) < len(names):
        raise rejection("corrupt", f"A JointState message names a joint twice among {names[:8]}.")
    return _Layout(wire, names, tuple(arrays), position)


def _cdr(payload: bytes) -> _Wire:
    order = _BYTE_ORDERS.get(payload[:2])
    if order is None:
        raise rejection(
            "unsupported-encoding",
            f"A JointState message has the CDR representation 0x{payload[:2].hex()}; readable are 0x0000 and 0x0001.",
        )
    return _Wire(order, aligned=True, closed=True, fixed=_HEADER)


def _names(payload: bytes, wire: _Wire) -> tuple[int, tuple[str, ...]]:
    at, length = _count(payload, wire, _HEADER + 8)
    at, count = _count(payload, wire, at + length)  # past the frame_id
    if count > MAX_JOINTS:
        raise rejection("corrupt", f"A JointState message states {count} joints, at most {MAX_JOINTS} are read.")
    names = []
    for _ in range(count):
        at, length = _count(payload, wire, at)
        name = payload[at : at + length]
        if length == 0 or len(name) < length or (wire.closed and name[-1] != 0):
            raise rejection("corrupt", "A joint name in a JointState message does not end where its length says.")
        names.append((name[:-1] if wire.closed else name).decode())
        at += length
    return at, tuple(names)


def _count(payload: bytes, wire: _Wire, at: int) -> tuple[int, int]:
    at = wire.start(at, 4)
    return at + 4, struct.unpack_from(wire.order + "I", payload, at)[0]


def _aligned(at: int, size: int) -> int:
    return at + (_HEADER - at) % size


def encode_joint_states(
    stamp_ns: IntArray,
    names: Sequence[str],
    arrays: Sequence[FloatArray],
    frame_id: str = "",
) -> ByteArray:
    """Encode poses as little-endian CDR, byte for byte as mcap-ros2-support's writer does.

    All messages at once and not one by one: that writer takes several times as long.

    Args:
        stamp_ns: (M,) header stamps, not negative.
        names: K joints.
        arrays: positions, velocities and efforts, each (M, K), or (M, 0) for an empty field.
        frame_id: of the header.

    Returns:
        (M, n) bytes, one message a row.
    """
    template = bytearray(b"\x00\x01\x00\x00" + bytes(8))

    def put_count(count: int) -> None:
        template.extend(bytes(_aligned(len(template), 4) - len(template)) + struct.pack("<I", count))

    def put_text(text: str) -> None:
        encoded = text.encode() + b"\x00"
        put_count(len(encoded))
        template.extend(encoded)

    put_text(frame_id)
    put_count(len(names))
    for name in names:
        put_text(name)
    starts = []
    for values in arrays:
        count = values.shape[1]
        put_count(count)
        if count:
            template.extend(bytes(_aligned(len(template), 8) - len(template)))
        starts.append(len(template))
        template.extend(bytes(8 * count))
    rows = np.tile(np.frombuffer(bytes(template), np.uint8), (len(stamp_ns), 1))
    seconds, nanoseconds = np.divmod(stamp_ns, 1_000_000_000)
    rows[:, 4:8] = seconds.astype("<i4")[:, None].view(np.uint8)
    rows[:, 8:12] = nanoseconds.astype("<u4")[:, None].view(np.uint8)
    for start, values in zip(starts, arrays, strict=True):
        if values.shape[1]:
            rows[:, start : start + 8 * values.shape[1]] = np.ascontiguousarray(values, "<f8").view(np.uint8)
    return rows
