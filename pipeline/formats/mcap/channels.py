"""What one recording holds: its channels, metadata and decoded joint states, gathered in one pass.

An MCAP file is read by `Contents.read`. Readers of other forms declare channels and hand in messages or poses one by
one, so that topics, joints, clocks and positions are judged in one place, whatever the file is.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema
from numpy.lib.stride_tricks import sliding_window_view

from pipeline.arrays import ByteArray, FloatArray, IntArray
from pipeline.errors import RecordingError
from pipeline.formats.mcap.chunks import inflate_message, is_zstd
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
_DECODED_STEPS, _DECODED_STEP_BYTES = 3, 150  # of a message that is decoded by itself, and bytes in it for each further
_TRIED = 100  # messages without a pose, after which a channel that does not declare any is left alone
_ALIKE = 16  # messages in a row that cost a step where they are handed in together


@dataclass(frozen=True)
class Decoded:
    """Poses that one message holds; most hold one, a planned motion many.

    Attributes:
        stamp_ns: (k,) by the message itself, 0 where it says nothing; None: as its log time.
        names: J joints, each once.
        positions: (k, J) rad or m, any value.
        after_ns: (k,) from the message's own time to each pose; None: 0.
    """

    stamp_ns: IntArray | None
    names: tuple[str, ...]
    positions: FloatArray
    after_ns: IntArray | None = None


Decoder = Callable[[bytes], Decoded]
"""From a message to its poses; raises a RecordingError."""


@dataclass(frozen=True)
class Decoding:
    """How the messages of a channel are read that are no JointState of ROS.

    Attributes:
        decode: a message.
        planned: whether they say where the arm was to be, and not where it was.
        sure: whether the channel declares that it has poses; else its messages must show it.
        said: a remark, or None.
    """

    decode: Decoder
    planned: bool = False
    sure: bool = True
    said: str | None = None


DecodingOf = Callable[[Channel, Schema | None], Decoding | None]
"""How a channel is read, from what it declares; None if it holds no poses. Raises a RecordingError."""


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

    `layout` is what the schema of a JointState declares, `decoding` how other messages with poses are read, `refused`
    why a channel of that name cannot be read; else they are None.
    """

    topic: str
    schema: str
    encoding: str
    layout: Declared | None = None
    decoding: Decoding | None = None
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
        """Whether its messages have poses, in an encoding and with fields that can be read."""
        return self.layout is not None or (self.decoding is not None and (self.decoding.sure or self.has_poses))

    @property
    def has_poses(self) -> bool:
        """Whether a pose has been found in its messages so far."""
        return any(block.states.names for block in self.blocks)

    @property
    def planned(self) -> bool:
        """Whether its poses are those of a plan."""
        return self.decoding is not None and self.decoding.planned

    @property
    def said(self) -> str | None:
        """A remark on how it is read."""
        known = self.layout or self.decoding
        return None if known is None else known.said


@dataclass
class Contents:
    """All that was found in a file; filled by its reader, and left as far as that came when it raises.

    Attributes:
        decoding_of: how channels are read that are no JointState of ROS; None: not.
        profile: of the MCAP header.
        library: what wrote the file.
        channels: by channel id.
        metadata: metadata records, name -> key -> text.
        cut: where the file breaks off, if it does.
        sha256: of the bytes that were read, once all of them were.
    """

    decoding_of: DecodingOf | None = None
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
        """Read the whole MCAP file at `path`.

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
            if channel.layout is not None or channel.decoding is not None:
                publish_ns = _publish_times(view, at)
                payloads_at, length = at + _PAYLOAD_AT, stride - _PAYLOAD_AT
                if channel.decoding is None and not is_zstd(data, int(payloads_at[0])):
                    self._take_joint_states(channel, view, length, payloads_at, log_ns, publish_ns, self._place, meter)
                else:
                    payloads = [data[start : start + length] for start in payloads_at]
                    self._take_payloads(channel, payloads, self._place + payloads_at, log_ns, publish_ns, meter)
        self._place += len(data)

    def add_channel(self, channel: Channel, schema: Schema | None, meter: Meter) -> ChannelContents:
        """Declare a channel of a file that is no MCAP file, as one in MCAP would be declared."""
        meter.declare(len(schema.data) if schema else 0)
        meter.step(_LAYOUT_STEPS)
        self.channels[channel.id] = _channel(channel, schema, meter, self.decoding_of)
        return self.channels[channel.id]

    def add_messages(self, channel: ChannelContents, payloads: Sequence[bytes], log_ns: IntArray, meter: Meter) -> None:
        """Take the next messages of a channel, logged at (k,) ns, in their order in the file."""
        meter.step(1 + len(payloads) // _ALIKE)
        channel.count(log_ns)
        if channel.layout is not None or channel.decoding is not None:
            place = self._place + np.arange(len(payloads))
            self._take_payloads(channel, payloads, place, log_ns, log_ns, meter)
        self._place += len(payloads)

    def add_poses(self, topic: str, form: str, time_ns: IntArray, states: Mapping[str, FloatArray]) -> None:
        """Take the poses of a file that is a table: the only channel, whose clocks are one.

        Args:
            topic: what the table is called in messages.
            form: what kind of file it is from.
            time_ns: (M,), M >= 1.
            states: (M,) positions by joint, rad or m.
        """
        channel = ChannelContents(topic, "positions", form, layout=Declared())
        channel.count(time_ns)
        positions = np.stack(list(states.values()), axis=1) if states else np.empty((len(time_ns), 0))
        block = JointBlock(time_ns, tuple(states), positions)
        channel.blocks.append(LoggedBlock(np.arange(len(time_ns)), time_ns, time_ns, block))
        self.channels[len(self.channels)] = channel

    def _take_joint_states(
        self,
        channel: ChannelContents,
        view: ByteArray,
        length: int,
        at: IntArray,
        log_ns: IntArray,
        publish_ns: IntArray,
        place: int,
        meter: Meter,
    ) -> None:
        """Decode messages of one length that begin at (k,) in `view`, which begins at `place` of the file."""
        _require_few(channel, meter)
        together = max(1, _DECODED_BYTES // max(length, 1))
        for start in range(0, len(at), together):
            part = slice(start, start + together)
            payloads = sliding_window_view(view, length)[at[part]] if length else np.empty((len(at[part]), 0), np.uint8)
            layout = channel.layout or Declared()
            states_of = decode_joint_states(payloads, channel.encoding, len(layout.arrays), layout.position)
            for rows, states in states_of:
                meter.step(_LAYOUT_STEPS + len(states.names))
                meter.hold(states.positions.size)
                where = place + at[part][rows]
                channel.blocks.append(LoggedBlock(where, log_ns[part][rows], publish_ns[part][rows], states))

    def _take_payloads(
        self,
        channel: ChannelContents,
        payloads: Sequence[bytes],
        place: IntArray,
        log_ns: IntArray,
        publish_ns: IntArray,
        meter: Meter,
    ) -> None:
        """Decode messages of any length that are at (k,) in the file; those that are compressed, one by one."""
        _require_few(channel, meter)
        if any(is_zstd(payload) for payload in payloads):
            payloads = [inflate_message(one, meter) if is_zstd(one) else one for one in payloads]
        if channel.decoding is not None:
            self._take_one_by_one(channel, channel.decoding, payloads, place, log_ns, publish_ns, meter)
            return
        alike: dict[int, list[int]] = {}
        for row, payload in enumerate(payloads):
            alike.setdefault(len(payload), []).append(row)
        for length, rows in alike.items():
            view = np.frombuffer(b"".join(payloads[row] for row in rows), np.uint8)
            layout = channel.layout or Declared()
            together = view.reshape(len(rows), length)
            of = np.array(rows)
            states_of = decode_joint_states(together, channel.encoding, len(layout.arrays), layout.position)
            for found, states in states_of:
                meter.step(_LAYOUT_STEPS + len(states.names))
                meter.hold(states.positions.size)
                here = of[found]
                channel.blocks.append(LoggedBlock(place[here], log_ns[here], publish_ns[here], states))

    def _take_one_by_one(
        self,
        channel: ChannelContents,
        decoding: Decoding,
        payloads: Sequence[bytes],
        place: IntArray,
        log_ns: IntArray,
        publish_ns: IntArray,
        meter: Meter,
    ) -> None:
        """Decode messages, of a channel that does not declare poses only as long as it may turn out to have some."""
        if decoding.sure or channel.has_poses:
            self._take_decoded(channel, decoding.decode, payloads, place, log_ns, publish_ns, meter)
            return
        first = slice(0, _TRIED)
        try:
            self._take_decoded(
                channel, decoding.decode, payloads[first], place[first], log_ns[first], publish_ns[first], meter
            )
        except RecordingError as error:
            channel.refused = error
        if channel.has_poses and channel.refused is None:
            rest = slice(_TRIED, None)
            self._take_decoded(
                channel, decoding.decode, payloads[rest], place[rest], log_ns[rest], publish_ns[rest], meter
            )
        elif channel.refused is not None or channel.messages >= _TRIED:
            channel.decoding = None
            channel.blocks.clear()

    def _take_decoded(
        self,
        channel: ChannelContents,
        decode: Decoder,
        payloads: Sequence[bytes],
        place: IntArray,
        log_ns: IntArray,
        publish_ns: IntArray,
        meter: Meter,
    ) -> None:
        """Decode messages one by one; those in a row with the same joints become one block."""
        run: list[tuple[int, Decoded]] = []
        for row, payload in enumerate(payloads):
            if len(payload) > meter.limits.message_bytes:
                raise rejection(
                    "too-large",
                    f"A message on {channel.topic} has {len(payload)} bytes; of its kind at most "
                    f"{meter.limits.message_bytes} are read.",
                )
            meter.step(_DECODED_STEPS + len(payload) // _DECODED_STEP_BYTES)
            decoded = decode(payload)
            meter.hold(decoded.positions.size)
            if run and run[-1][1].names != decoded.names:
                channel.blocks.append(_block_of(run, place, log_ns, publish_ns))
                meter.step(_LAYOUT_STEPS)
                run = []
            run.append((row, decoded))
        if run:
            channel.blocks.append(_block_of(run, place, log_ns, publish_ns))

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
            stated = parse(Schema.read, body)
            if stated.id == 0:
                raise rejection("corrupt", "A schema has the id 0, which stands for none.")
            self._schemas[stated.id] = stated
        else:
            meter.step(len(body) // _MAP_ENTRY_BYTES)
            channel = parse(Channel.read, body)
            if channel.schema_id and channel.schema_id not in self._schemas:
                raise rejection(
                    "corrupt",
                    f"Topic {channel.topic} uses the undeclared schema {channel.schema_id}.",
                )
            schema = self._schemas.get(channel.schema_id) if channel.schema_id else None
            self.channels[channel.id] = _channel(channel, schema, meter, self.decoding_of)
        self._declared[key] = body


def _channel(
    channel: Channel, schema: Schema | None, meter: Meter, decoding_of: DecodingOf | None = None
) -> ChannelContents:
    """What is known of a channel before its messages."""
    found = ChannelContents(channel.topic, "" if schema is None else schema.name, channel.message_encoding)
    try:
        if schema is not None and schema.name in JOINT_STATE_SCHEMAS and channel.message_encoding in ENCODINGS:
            meter.step(len(schema.data) // _TEXT_BYTES)
            found.layout = declared(channel.topic, channel.message_encoding, schema.encoding, schema.data)
        elif decoding_of is not None:
            found.decoding = decoding_of(channel, schema)
    except RecordingError as error:
        found.refused = error
    return found


def _require_few(channel: ChannelContents, meter: Meter) -> None:
    if channel.messages > meter.limits.joint_states:
        raise rejection(
            "too-large",
            f"Topic {channel.topic} has more than {meter.limits.joint_states} messages; "
            "cut the recording to one demonstration.",
        )


def _block_of(
    run: Sequence[tuple[int, Decoded]], place: IntArray, log_ns: IntArray, publish_ns: IntArray
) -> LoggedBlock:
    """Decoded messages with the same joints, with the rows that they have among (k,) times."""
    rows = np.repeat([row for row, _ in run], [len(one.positions) for _, one in run])
    after = np.concatenate([_or_zeros(one.after_ns, one) for _, one in run])
    stamps = [np.full(len(one.positions), log_ns[row]) if one.stamp_ns is None else one.stamp_ns for row, one in run]
    stamp_ns = np.concatenate(stamps) + after
    states = JointBlock(stamp_ns, run[0][1].names, np.concatenate([one.positions for _, one in run]))
    return LoggedBlock(place[rows], log_ns[rows] + after, publish_ns[rows] + after, states)


def _or_zeros(times: IntArray | None, one: Decoded) -> IntArray:
    return np.zeros(len(one.positions), np.int64) if times is None else times


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
