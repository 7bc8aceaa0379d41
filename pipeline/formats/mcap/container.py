"""Bounded, checked reading of MCAP files: what a broken or hostile file can cost is limited before it is paid.

Only the framing is our own. The official stream reader parses every index entry in Python, lets a length inside a
record run past the record's end, checks few CRCs and inflates a chunk to whatever size its frame states. The bodies of
the records are parsed by the official classes.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, DataEnd, Footer

from pipeline.errors import RecordingError
from pipeline.formats.mcap.rejection_reasons import Reason, rejection

MAGIC = b"\x89MCAP0\r\n"
FRAME = struct.Struct("<BQ")  # opcode, length of the body
_CONTENT = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_LOOSE_BLOCK_BYTES = 1 << 20
_FILTER = "keep only the joint states with `mcap filter --include-topic-regex`"
_RECORD_STEPS, _CHUNK_STEPS = 4, 40
_RECOVER = "set ingest.salvage to use what stands before"

Record = TypeVar("Record")


class CutOff(RecordingError):
    """The file ends, or its framing breaks, before its end mark; all records before that place were read whole.

    Attributes:
        at: byte from which on nothing can be read.
        left: bytes from there to the end of the file.
        in_data: whether that is before the end of the data section, so that messages may be lost.
        unchecked: bytes of the messages before that place which no checksum covers.
    """

    def __init__(self, detail: str, at: int, left: int) -> None:
        reason: Reason = "truncated"
        super().__init__(reason, detail)
        self.at, self.left = at, left
        self.in_data = True
        self.unchecked = 0


@dataclass(frozen=True)
class Limits:
    """What reading one file may cost.

    Attributes:
        record_bytes: longest record, as stored.
        chunk_bytes: longest chunk, inflated.
        total_bytes: all chunks and loose records together, inflated.
        ratio: inflated over stored size of a chunk that inflates to more than `ratio_floor_bytes`.
        declared_bytes: all schemas, channels and metadata records together.
        joint_states: messages on one JointState channel.
        joint_values: positions in all JointState messages together.
        steps: what is looked at one by one: a record that is unlike the one before it is 1 step, an opened chunk or a new
            layout of messages about as many as the time it takes.
    """

    record_bytes: int = 64 << 20
    chunk_bytes: int = 64 << 20
    total_bytes: int = 1 << 30
    ratio: int = 1000
    ratio_floor_bytes: int = 4 << 20
    declared_bytes: int = 16 << 20
    joint_states: int = 2_000_000
    joint_values: int = 16_000_000
    steps: int = 1_000_000


class Meter:
    """Counts what reading one file costs, and refuses what goes beyond the limits."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._inflated = self._declared = self._values = self._steps = 0

    def inflate(self, size: int) -> None:
        """Pay for `size` bytes of records."""
        self._inflated += size
        if self._inflated > self.limits.total_bytes:
            raise rejection("too-large", f"The file inflates to more than {self.limits.total_bytes} bytes; {_FILTER}.")

    def declare(self, size: int) -> None:
        """Pay for a schema, channel or metadata record of `size` bytes."""
        self._declared += size
        if self._declared > self.limits.declared_bytes:
            raise rejection(
                "too-large",
                f"The file holds more than {self.limits.declared_bytes} bytes of schemas, channels and metadata; {_FILTER}.",
            )

    def hold(self, values: int) -> None:
        """Pay for `values` positions that are kept."""
        self._values += values
        if self._values > self.limits.joint_values:
            raise rejection(
                "too-large",
                f"The file holds more than {self.limits.joint_values} joint positions; "
                "cut the recording to one demonstration.",
            )

    def step(self, count: int = 1) -> None:
        """Pay for `count` steps."""
        self._steps += count
        if self._steps > self.limits.steps:
            raise rejection(
                "too-large",
                f"The file takes more than {self.limits.steps} steps to read, for its many small or differing records; "
                f"{_FILTER}.",
            )


def scan(path: Path, meter: Meter) -> Iterator[tuple[int, bytes]]:
    """Walk a whole MCAP file, checking magic, framing and every CRC it carries.

    Yields:
        `(opcode, body)` of header, metadata and statistics records, and `(Opcode.CHUNK, data)` for each inflated
        chunk. Schemas, channels and messages outside chunks come as such blocks too; copies in the summary do not.

    Raises:
        CutOff: truncated; whatever stands before that place has been yielded.
        RecordingError: unreadable, not-mcap, corrupt, unsupported-compression or too-large.
    """
    if path.is_dir():
        raise rejection("unreadable", f"{path} is a folder; give the .mcap file inside it.")
    if path.exists() and not path.is_file():
        raise rejection("unreadable", f"{path} is not a regular file; give an .mcap file.")
    try:
        with path.open("rb") as file:
            yield from _scan(file, os.fstat(file.fileno()).st_size, meter)
    except OSError as error:
        raise rejection("unreadable", f"{path} cannot be read: {error.strerror or error}.") from error


def parse(read: Callable[[ReadDataStream], Record], body: bytes) -> Record:
    """Parse the body of one record with the official class's `read`, never past the body's end."""
    try:
        return read(_Body(BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError) as error:
        raise rejection("corrupt", "A record's content does not fit its length or is not valid text.") from error


class _Body(ReadDataStream):
    """The official stream, with a short read as an error."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def _scan(file: BinaryIO, size: int, meter: Meter) -> Iterator[tuple[int, bytes]]:
    magic = file.read(len(MAGIC))
    if magic != MAGIC:
        raise rejection("not-mcap", "The file does not start with the MCAP magic; only MCAP recordings can be read.")
    crc = zlib.crc32(magic)
    in_data, loose, unchecked = True, bytearray(), 0
    opcode = None
    while opcode != Opcode.FOOTER:
        first = opcode is None
        try:
            frame, opcode, body = _record(file, size, meter.limits)
        except CutOff as cut:
            if loose:
                meter.inflate(len(loose))
                yield Opcode.CHUNK, bytes(loose)
            cut.in_data, cut.unchecked = in_data, unchecked if in_data else 0
            raise
        meter.step(_RECORD_STEPS)
        if first and opcode != Opcode.HEADER:
            raise rejection("corrupt", f"The file starts with a record of type {opcode} where the header should be.")
        if loose and (opcode not in _CONTENT or len(loose) >= _LOOSE_BLOCK_BYTES):
            meter.inflate(len(loose))
            yield Opcode.CHUNK, bytes(loose)
            loose.clear()
        if opcode == Opcode.CHUNK and in_data:
            chunk = parse(Chunk.read, body)
            meter.step(_CHUNK_STEPS)
            meter.inflate(chunk.uncompressed_size)
            unchecked += 0 if chunk.uncompressed_crc else chunk.uncompressed_size
            yield Opcode.CHUNK, inflate(chunk, meter.limits)
        elif opcode in _CONTENT and in_data:
            loose += frame + body
            unchecked += len(frame) + len(body)
        elif opcode in (Opcode.HEADER, Opcode.METADATA, Opcode.STATISTICS):
            yield opcode, body
        elif opcode == Opcode.DATA_END:
            _match_crc("data section", parse(DataEnd.read, body).data_section_crc, crc)
            in_data, crc = False, 0
            continue
        elif opcode == Opcode.FOOTER:
            _match_crc("summary", parse(Footer.read, body).summary_crc, zlib.crc32(frame + body[:16], crc))
        crc = zlib.crc32(body, zlib.crc32(frame, crc))
    if in_data:
        raise rejection("corrupt", "The file has a footer but no end of the data section.")
    if file.read(len(MAGIC) + 1) != MAGIC:
        ending = CutOff(f"The MCAP magic that ends a finished file is missing; {_RECOVER}.", size, 0)
        ending.in_data = False
        raise ending


def _record(file: BinaryIO, size: int, limits: Limits) -> tuple[bytes, int, bytes]:
    offset = file.tell()
    frame = file.read(FRAME.size)
    if len(frame) < FRAME.size:
        raise CutOff(
            f"The file ends after {size} bytes without a footer; it was cut off, {_RECOVER}.", offset, size - offset
        )
    opcode, length = FRAME.unpack(frame)
    left = size - offset - FRAME.size
    if opcode == 0:
        raise CutOff(
            f"The record at byte {offset} has the type 0, which no record has; the file was not written any further or is "
            f"damaged, {_RECOVER}.",
            offset,
            size - offset,
        )
    if length > left:
        raise CutOff(
            f"The record at byte {offset} states {length} bytes but {left} are left; the file is cut off or damaged, "
            f"{_RECOVER}.",
            offset,
            size - offset,
        )
    if length > limits.record_bytes:
        raise rejection(
            "too-large",
            f"The record at byte {offset} has {length} bytes, at most {limits.record_bytes} are read; {_FILTER}.",
        )
    body = file.read(length)
    if len(body) < length:
        raise CutOff(f"The file shrank while it was read, at byte {offset}.", offset, len(frame) + len(body))
    return frame, opcode, body


def _match_crc(what: str, stated: int, computed: int) -> None:
    if stated not in (0, computed):  # 0 stands for "not computed" in MCAP
        raise rejection("corrupt", f"The checksum of the {what} is {computed:#010x}, the file states {stated:#010x}.")


def inflate(chunk: Chunk, limits: Limits) -> bytes:
    """The records of a chunk, inflated to exactly its stated size, or a RecordingError."""
    size, stored = chunk.uncompressed_size, len(chunk.data)
    if size > limits.chunk_bytes or size > max(limits.ratio_floor_bytes, limits.ratio * stored):
        raise rejection(
            "too-large",
            f"A chunk of {stored} bytes states {size} bytes inflated; allowed are {limits.chunk_bytes} bytes "
            f"and a ratio of {limits.ratio}.",
        )
    if chunk.compression == "":
        data = chunk.data
    elif chunk.compression == "zstd":
        data = _inflate_zstd(chunk.data, size)
    elif chunk.compression == "lz4":
        data = _inflate_lz4(chunk.data, size)
    else:
        raise rejection(
            "unsupported-compression",
            f"A chunk is compressed with {chunk.compression[:40]!r}; readable are lz4, zstd and none, "
            "convert with `mcap compress`.",
        )
    if len(data) != size:
        raise rejection("corrupt", f"A chunk inflates to {len(data)} bytes where it states {size}.")
    _match_crc("chunk", chunk.uncompressed_crc, zlib.crc32(data))
    return data


def _inflate_zstd(data: bytes, size: int) -> bytes:
    try:
        # the library allocates what the frame states, whatever maximum it is given
        stated = zstandard.frame_content_size(data)
        if stated not in (-1, size):
            raise rejection("corrupt", f"A chunk's zstd frame states {stated} bytes where the chunk states {size}.")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))
    except zstandard.ZstdError as error:
        raise rejection("corrupt", "A chunk's zstd data is damaged or longer than it states.") from error


def _inflate_lz4(data: bytes, size: int) -> bytes:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    try:
        inflated: bytes = decompressor.decompress(data, max_length=size + 1)
    except (RuntimeError, EOFError, ValueError) as error:
        raise rejection("corrupt", "A chunk's lz4 data is damaged.") from error
    if not decompressor.eof:
        raise rejection("corrupt", "A chunk's lz4 data is cut off or longer than it states.")
    return inflated
