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
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Protocol, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, DataEnd, Footer

from pipeline.errors import RecordingError
from pipeline.formats.mcap.chunks import inflate, match_crc
from pipeline.formats.mcap.limits import FILTER, Limits, Meter
from pipeline.formats.mcap.rejection_reasons import Reason, rejection

ENDING = ".mcap"
MAGIC = b"\x89MCAP0\r\n"
FRAME = struct.Struct("<BQ")  # opcode, length of the body
_CONTENT = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_DATA_ALONE = (
    Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END
)  # fmt: skip
_ATTACHMENT_TIMES, _TEXT_LENGTH, _DATA_LENGTH, _CRC = 16, struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<I")
_LOOSE_BLOCK_BYTES = 1 << 20
_REST_BYTES = 1 << 20
_RECORD_STEPS, _CHUNK_STEPS = 4, 40
_RECOVER = "set ingest.salvage to use what stands before"

Record = TypeVar("Record")


class Digest(Protocol):
    """Such as `hashlib.sha256()`."""

    def update(self, data: bytes, /) -> None:
        """Take more bytes."""


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


def is_recording(path: Path) -> bool:
    """Whether a file is taken for an MCAP file: by its ending, in capitals or not."""
    return path.suffix.lower() == ENDING


def scan(path: Path, meter: Meter, digest: Digest | None = None) -> Iterator[tuple[int, bytes]]:
    """Walk a whole MCAP file, checking magic, framing and every CRC it carries.

    Args:
        path: the file.
        meter: counts what it costs.
        digest: is given every byte of a file that is whole or cut off, in order, as it is read.

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
            stream, size = file if digest is None else _Digesting(file, digest), os.fstat(file.fileno()).st_size
            if size > meter.limits.stored_bytes:
                raise rejection(
                    "too-large", f"The file has {size} bytes, at most {meter.limits.stored_bytes} are read; {FILTER}."
                )
            walk = _Walk(stream, size, meter)
            try:
                yield from walk.records()
                walk.end()
            except CutOff:
                while stream.tell() < size and stream.read(_REST_BYTES):
                    pass
                raise
    except OSError as error:
        raise rejection("unreadable", f"{path} cannot be read: {error.strerror or error}.") from error


def parse(read: Callable[[ReadDataStream], Record], body: bytes) -> Record:
    """Parse the body of one record with the official class's `read`, never past the body's end."""
    try:
        return read(_Body(BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError) as error:
        raise rejection("corrupt", "A record's content does not fit its length or is not valid text.") from error


class _Digesting:
    """A file whose bytes go to a digest as they are read."""

    def __init__(self, file: BinaryIO, digest: Digest) -> None:
        self._file, self._digest = file, digest

    def read(self, size: int) -> bytes:
        data = self._file.read(size)
        self._digest.update(data)
        return data

    def tell(self) -> int:
        return self._file.tell()


class _Body(ReadDataStream):
    """The official stream, with a short read as an error."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


class _Walk:
    """One pass over a file, record by record.

    Attributes of a pass: the checksum of the section so far, whether that is the data section, the records of messages
    outside chunks that have not been handed out yet, and how many bytes of messages no checksum covered.
    """

    def __init__(self, file: BinaryIO | _Digesting, size: int, meter: Meter) -> None:
        magic = file.read(len(MAGIC))
        if magic != MAGIC:
            raise rejection(
                "not-mcap", "The file does not start with the MCAP magic; only MCAP recordings can be read."
            )
        self._file, self._size, self._meter = file, size, meter
        self._crc = zlib.crc32(magic)
        self._in_data, self._loose, self._unchecked = True, bytearray(), 0

    def records(self) -> Iterator[tuple[int, bytes]]:
        """What `scan` yields, from the header to the footer."""
        opcode = None
        while opcode != Opcode.FOOTER:
            first = opcode is None
            try:
                frame, opcode, body = _record(self._file, self._size, self._meter.limits)
            except CutOff as cut:
                yield from self._loose_block()
                cut.in_data, cut.unchecked = self._in_data, self._unchecked if self._in_data else 0
                raise
            self._meter.step(_RECORD_STEPS)
            self._require_order(opcode, first)
            if opcode not in _CONTENT or len(self._loose) >= _LOOSE_BLOCK_BYTES:
                yield from self._loose_block()
            yield from self._taken(frame, opcode, body)
            self._check(frame, opcode, body)

    def _require_order(self, opcode: int, first: bool) -> None:
        """Refuse records where the format has none: what they hold would be read by some programs and not by others."""
        if first and opcode != Opcode.HEADER:
            raise rejection("corrupt", f"The file starts with a record of type {opcode} where the header should be.")
        if not first and opcode == Opcode.HEADER:
            raise rejection("corrupt", "The file has a second header; it was put together from several files.")
        if not self._in_data and opcode in _DATA_ALONE:
            raise rejection(
                "corrupt",
                f"The file has a {Opcode(opcode).name.lower().replace('_', ' ')} record behind the end of its data "
                "section, where other programs do not look; it was put together from several files, so use those.",
            )

    def end(self) -> None:
        """Refuse a file that ends otherwise than with its data section closed and the magic."""
        if self._in_data:
            raise rejection("corrupt", "The file has a footer but no end of the data section.")
        if self._file.read(len(MAGIC) + 1) != MAGIC:
            ending = CutOff(f"The MCAP magic that ends a finished file is missing; {_RECOVER}.", self._size, 0)
            ending.in_data = False
            raise ending

    def _taken(self, frame: bytes, opcode: int, body: bytes) -> Iterator[tuple[int, bytes]]:
        """What a record yields; messages outside chunks are kept until there is a block of them."""
        if opcode == Opcode.CHUNK and self._in_data:
            chunk = parse(Chunk.read, body)
            self._meter.step(_CHUNK_STEPS)
            self._meter.inflate(chunk.uncompressed_size)
            self._unchecked += 0 if chunk.uncompressed_crc else chunk.uncompressed_size
            yield Opcode.CHUNK, inflate(chunk, self._meter.limits)
        elif opcode in _CONTENT and self._in_data:
            self._loose += frame + body
            self._unchecked += len(frame) + len(body)
        elif opcode == Opcode.ATTACHMENT:
            _check_attachment(body)
        elif opcode in (Opcode.HEADER, Opcode.METADATA, Opcode.STATISTICS):
            yield opcode, body

    def _loose_block(self) -> Iterator[tuple[int, bytes]]:
        if self._loose:
            self._meter.inflate(len(self._loose))
            yield Opcode.CHUNK, bytes(self._loose)
            self._loose.clear()

    def _check(self, frame: bytes, opcode: int, body: bytes) -> None:
        """Compare the checksum where a section ends, and carry it on where it does not."""
        if opcode == Opcode.DATA_END:
            match_crc("data section", parse(DataEnd.read, body).data_section_crc, self._crc)
            self._in_data, self._crc = False, 0
            return
        if opcode == Opcode.FOOTER:
            match_crc("summary", parse(Footer.read, body).summary_crc, zlib.crc32(frame + body[:16], self._crc))
        self._crc = zlib.crc32(body, zlib.crc32(frame, self._crc))


def _check_attachment(body: bytes) -> None:
    """Refuse an attachment whose lengths or checksum are wrong; what is in it is not looked at."""
    at = _ATTACHMENT_TIMES
    for width in (_TEXT_LENGTH, _TEXT_LENGTH, _DATA_LENGTH):  # name, media type, data
        if at + width.size > len(body):
            raise rejection("corrupt", "An attachment is shorter than its own fields.")
        at += width.size + width.unpack_from(body, at)[0]
    if at + _CRC.size != len(body):
        raise rejection("corrupt", f"An attachment has {len(body)} bytes where its fields take {at + _CRC.size}.")
    match_crc("attachment", _CRC.unpack_from(body, at)[0], zlib.crc32(memoryview(body)[:at]))


def _record(file: BinaryIO | _Digesting, size: int, limits: Limits) -> tuple[bytes, int, bytes]:
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
            f"The record at byte {offset} has the type 0, which no record has; the file was not written any further or "
            f"is damaged, {_RECOVER}.",
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
            f"The record at byte {offset} has {length} bytes, at most {limits.record_bytes} are read; {FILTER}.",
        )
    body = file.read(length)
    if len(body) < length:
        raise CutOff(f"The file shrank while it was read, at byte {offset}.", offset, len(frame) + len(body))
    return frame, opcode, body
