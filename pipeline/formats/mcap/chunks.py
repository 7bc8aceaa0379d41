"""Chunks and messages, inflated to no more than they state, chunks checked against their checksum."""

from __future__ import annotations

import zlib

import lz4.frame
import zstandard
from mcap.records import Chunk

from pipeline.formats.mcap.limits import Limits, Meter
from pipeline.formats.mcap.rejection_reasons import rejection

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def is_zstd(data: bytes, at: int = 0) -> bool:
    """Whether data begin at a place as what zstd compressed does, and as no message of ROS does."""
    return data[at : at + len(ZSTD_MAGIC)] == ZSTD_MAGIC


def inflate_message(data: bytes, meter: Meter) -> bytes:
    """A message that a recorder compressed by itself, or a RecordingError."""
    try:
        size = zstandard.frame_content_size(data)
        most = meter.limits.message_bytes
        if size > most:
            raise rejection("too-large", f"A compressed message states {size} bytes inflated; at most {most} are read.")
        inflated = zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1) if size >= 0 else most)
    except zstandard.ZstdError as error:
        raise rejection("corrupt", "A message's zstd data is damaged or longer than is read.") from error
    meter.inflate(len(inflated))
    meter.step()
    return inflated


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
    match_crc("chunk", chunk.uncompressed_crc, zlib.crc32(data))
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


def match_crc(what: str, stated: int, computed: int) -> None:
    """Refuse a file whose stated checksum is not the computed one."""
    if stated not in (0, computed):  # 0 stands for "not computed" in MCAP
        raise rejection("corrupt", f"The checksum of the {what} is {computed:#010x}, the file states {stated:#010x}.")
