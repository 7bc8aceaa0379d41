"""What one MCAP file holds: its channels, metadata and decoded joint states, gathered in one pass."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema
from numpy.lib.stride_tricks import sliding_window_view

from pipeline.arrays import ByteArray, IntArray
from pipeline.errors import RecordingError
from pipeline.formats.mcap.container import FRAME, CutOff, parse, scan
from pipeline.formats.mcap.declared_layout import Declared, declared
from pipeline.formats.mcap.joint_state_cdr import ENCODINGS, JointBlock, decode_joint_states
from pipeline.formats.mcap.limits import Limits, Meter
from pipeline.formats.mcap.rejection_reasons import rejection

JOINT_STATE_SCHEMAS = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
_MESSAGE_HEAD = 22  # channel id u2, sequence u4, log time u8, publish time u8
_CHANNEL_AT, _LOG_TIME_AT, _PUBLISH_TIME_AT = FRAME.size, FRAME.size + 6, FRAME.size + 14
_PAYLOAD_AT = FRAME.size + _MESSAGE_HEAD
_CHANNEL_ID = struct.Struct("<H")
_MESSAGE_COUNT = struct.Struct("<Q")
_DECODED_BYTES = 8 << 20  # of messages that are decoded together
_LAYOUT_STEPS, _MAP_ENTRY_BYTES, _TEXT_BYTES = 40, 8, 16


@dataclass(frozen=True)
class LoggedBlock:
    """Decoded poses with where they stand in the file, (k,), and when they were logged and published, (k,) ns."""

    place: IntArray
    log_ns: IntArray
    publish_ns: IntArray
    states: JointBlock


@dataclass
class ChannelContents:
    """One channel as far as it was read; `blocks` stays empty unless it carries joint states.

    `layout` is what its schema declares, `refused` why a channel of that name cannot be read; else both are None.
    """

    topic: str
    schema: str
    encoding: str
    layout: Declared | None = None
    refused: RecordingError | None = None
    messages: int = 0
    first_log_ns: int = 0
    last_log_ns: int = 0
    blocks: list[LoggedBlock] = field(default_factory=list)

    def count(self, log_ns: IntArray) -> None:
        """Take messages into account that were logged at (k,) ns."""
        first, last = int(log_ns.min()), int(log_ns.max())
        self.first_log_ns = min(self.first_log_ns, first) if self.messages else first
        self.last_log_ns = max(self.last_log_ns, last)
        self.messages += len(log_ns)

    @property
    def has_joint_states(self) -> bool:
        """Whether its messages are JointState, in an encoding and with fields that can be read."""
        return self.layout is not None


@dataclass
class Contents:
    """All that was found in a file; filled by `read`, and left as far as that came when it raises.

    Attributes:
        profile: of the MCAP header.
        library: what wrote the file.
        channels: by channel id.
        metadata: metadata records, name -> key -> text.
        cut: where the file breaks off, if it does.
        sha256: of the bytes that were read, once all of them were.
    """

    profile: str = ""
    library: str = ""
    channels: dict[int, ChannelContents] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    cut: CutOff | None = None
    sha256: str = ""
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _declared: dict[tuple[int, int], bytes] = field(default_factory=dict)
    _stated: int | None = None
    _place: int = 0

    def read(self, path: Path, limits: Limits) -> None:
        """Read the whole file at `path`.

        Raises:
            RecordingError: anything `container.scan` raises, corrupt, unsupported-encoding or too-large.
        """
        digest = hashlib.sha256()
        try:
            meter = Meter(limits)
            for opcode, body in scan(path, meter, digest):
                self._take(opcode, body, meter)
        except CutOff as cut:
            self.cut, self.sha256 = cut, digest.hexdigest()
            raise
        self.sha256 = digest.hexdigest()
        if self._stated not in (None, self.messages):
            raise rejection("corrupt", f"The file states {self._stated} messages and holds {self.messages}.")

    @property
    def messages(self) -> int:
        """How many messages were read, on all channels."""
        return sum(channel.messages for channel in self.channels.values())

    def _take(self, opcode: int, body: bytes, meter: Meter) -> None:
        if opcode == Opcode.CHUNK:
            self._take_block(body, meter)
        elif opcode == Opcode.METADATA:
            self._take_metadata(body, meter)
        elif opcode == Opcode.HEADER:
            header = parse(Header.read, body)
            self.profile, self.library = header.profile, header.library
        elif opcode == Opcode.STATISTICS:
            if len(body) < _MESSAGE_COUNT.size:
                raise rejection("corrupt", f"A statistics record has {len(body)} bytes, too few for its counts.")
            self._stated = _MESSAGE_COUNT.unpack_from(body)[0]

    def _take_metadata(self, body: bytes, meter: Meter) -> None:
        meter.declare(len(body))
        meter.step(len(body) // _MAP_ENTRY_BYTES)
        record = parse(Metadata.read, body)
        self.metadata.setdefault(record.name, {}).update(record.metadata)

    def _take_block(self, data: bytes, meter: Meter) -> None:
        view = np.frombuffer(data, np.uint8)
        for (channel_id, stride), offsets in self._messages(data, view, meter).items():
            channel, at = self.channels[channel_id], np.array(offsets)
            log_ns = _log_times(channel, view, at)
            channel.count(log_ns)
            if channel.has_joint_states:
                self._take_joint_states(channel, view, stride, at, log_ns, meter)
        self._place += len(data)

    def _take_joint_states(
        self, channel: ChannelContents, view: ByteArray, stride: int, at: IntArray, log_ns: IntArray, meter: Meter
    ) -> None:
        if channel.messages > meter.limits.joint_states:
            raise rejection(
                "too-large",
                f"Topic {channel.topic} has more than {meter.limits.joint_states} messages; "
                "cut the recording to one demonstration.",
            )
        publish_ns = _publish_times(view, at)
        together = max(1, _DECODED_BYTES // stride)
        for start in range(0, len(at), together):
            part = slice(start, start + together)
            payloads = sliding_window_view(view, stride)[at[part]][:, _PAYLOAD_AT:]
            layout = channel.layout or Declared()
            states_of = decode_joint_states(payloads, channel.encoding, len(layout.arrays), layout.position)
            for rows, states in states_of:
                meter.step(_LAYOUT_STEPS + len(states.names))
                meter.hold(states.positions.size)
                place = self._place + at[part][rows]
                channel.blocks.append(LoggedBlock(place, log_ns[part][rows], publish_ns[part][rows], states))

    def _messages(self, data: bytes, view: ByteArray, meter: Meter) -> dict[tuple[int, int], list[int]]:
        """Where the messages start, by channel and record length; schemas and channels are taken on the way."""
        found: dict[tuple[int, int], list[int]] = {}
        at = 0
        while at < len(data):
            if at + FRAME.size > len(data):
                raise rejection("corrupt", "A chunk ends within a record.")
            opcode, length = FRAME.unpack_from(data, at)
            stride, count = FRAME.size + length, 1
            if at + stride > len(data):
                raise rejection("corrupt", f"A record in a chunk states {length} bytes, more than the chunk has left.")
            if opcode == Opcode.MESSAGE:
                if length < _MESSAGE_HEAD:
                    raise rejection("corrupt", f"A message record has {length} bytes, fewer than {_MESSAGE_HEAD}.")
                channel_id = _CHANNEL_ID.unpack_from(data, at + _CHANNEL_AT)[0]
                if channel_id not in self.channels:
                    raise rejection("corrupt", f"A message belongs to the undeclared channel {channel_id}.")
                count = _run(data, view, at, stride)
                found.setdefault((channel_id, stride), []).extend(range(at, at + count * stride, stride))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declare(opcode, data[at + FRAME.size : at + stride], meter)
            meter.step()
            at += count * stride
        return found

    def _declare(self, opcode: int, body: bytes, meter: Meter) -> None:
        if len(body) < _CHANNEL_ID.size:
            raise rejection("corrupt", "A schema or channel record is too short for its id.")
        key = (opcode, _CHANNEL_ID.unpack_from(body)[0])
        if key in self._declared:
            if self._declared[key] != body:
                kind = "schema" if opcode == Opcode.SCHEMA else "channel"
                raise rejection("corrupt", f"The {kind} id {key[1]} is declared twice, differently.")
            return
        meter.declare(len(body))
        meter.step(_LAYOUT_STEPS)
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema.read, body)
            if schema.id == 0:
                raise rejection("corrupt", "A schema has the id 0, which stands for none.")
            self._schemas[schema.id] = schema
        else:
            meter.step(len(body) // _MAP_ENTRY_BYTES)
            channel = parse(Channel.read, body)
            if channel.schema_id and channel.schema_id not in self._schemas:
                raise rejection(
                    "corrupt",
                    f"Topic {channel.topic} uses the undeclared schema {channel.schema_id}.",
                )
            self.channels[channel.id] = _channel(channel, self._schemas.get(channel.schema_id), meter)
        self._declared[key] = body


def _channel(channel: Channel, schema: Schema | None, meter: Meter) -> ChannelContents:
    """What is known of a channel before its messages."""
    found = ChannelContents(channel.topic, "" if schema is None else schema.name, channel.message_encoding)
    if schema is not None and schema.name in JOINT_STATE_SCHEMAS and channel.message_encoding in ENCODINGS:
        meter.step(len(schema.data) // _TEXT_BYTES)
        try:
            found.layout = declared(channel.topic, channel.message_encoding, schema.encoding, schema.data)
        except RecordingError as error:
            found.refused = error
    return found


def _log_times(channel: ChannelContents, view: ByteArray, at: IntArray) -> IntArray:
    """(k,) ns of the messages that start at (k,)."""
    log_ns = sliding_window_view(view, 8)[at + _LOG_TIME_AT].view("<u8")[:, 0]
    if log_ns.max() > np.iinfo(np.int64).max:
        raise rejection("corrupt", f"A message on {channel.topic} has a log time beyond the year 2262.")
    return log_ns.astype(np.int64)


def _publish_times(view: ByteArray, at: IntArray) -> IntArray:
    """(k,) ns of the messages that start at (k,), 0 where it is beyond the year 2262."""
    publish_ns = sliding_window_view(view, 8)[at + _PUBLISH_TIME_AT].view("<u8")[:, 0]
    return np.where(publish_ns > np.iinfo(np.int64).max, 0, publish_ns).astype(np.int64)


def _run(data: bytes, view: ByteArray, at: int, stride: int) -> int:
    """How many records from `at` on share opcode, length and channel; windows grow, so the cost follows the result."""
    shared = _CHANNEL_AT + _CHANNEL_ID.size
    if data[at : at + shared] != data[at + stride : at + stride + shared]:
        return 1
    count, window, left = 1, 8, (len(data) - at) // stride
    while count < left:
        size = min(window, left - count)
        frames = view[at + count * stride : at + (count + size) * stride].reshape(size, stride)
        same = (frames[:, :shared] == view[at : at + shared]).all(axis=1)
        if not same.all():
            return count + int(same.argmin())
        count, window = count + size, 4 * window
    return count
