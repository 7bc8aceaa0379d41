"""Bags of ROS 1 (.bag), with rosbags.

rosbags finds the messages; they are decoded here as those in MCAP are. What it reads of the file and what chunks
inflate to is bounded, since its own numbers are those that the file states.
"""

from __future__ import annotations

import bz2
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import numpy as np
from mcap.records import Channel, Schema

from pipeline.errors import RecordingError
from pipeline.formats.mcap.channels import ChannelContents, Contents
from pipeline.formats.mcap.limits import Limits, Meter
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.recordings.extras import needed

MAGIC = b"#ROSBAG V2.0\n"
REMEDY = "keep only the joint states with `rosbag filter`"
MOST_CONNECTIONS, MOST_CHUNKS = 10_000, 200_000
_ENTRY_BYTES = 12  # of a message in the index
_OFTEN = 4  # times the length of the file that may be read of it
_BATCH_BYTES, _BATCH = 1 << 20, 256


def fill_from_ros1_bag(contents: Contents, path: Path, limits: Limits) -> None:
    """Read all channels of a file, and the messages of those that have poses.

    Raises:
        RecordingError: not-read, corrupt, too-large or unsupported-encoding.
    """
    rosbag1 = needed("rosbags.rosbag1.reader", "A bag of ROS 1 is read")
    meter = Meter(limits, REMEDY)
    with path.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise rejection("corrupt", f"{path.name} does not start as a bag of ROS 1 of version 2.0 does.")
    contents.profile, contents.library = "ros1", "rosbag"
    try:
        _read(contents, _counted(rosbag1.Reader, limits)(_Bounded(path, limits)), rosbag1.decompressors, meter)
    except RecordingError:
        raise
    except Exception as error:  # of a damaged file it raises whatever its code meets
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise rejection("corrupt", f"{path.name} cannot be read as a bag of ROS 1 ({said}).") from error


def _read(contents: Contents, reader: Any, known: Mapping[str, Callable[[bytes], bytes]], meter: Meter) -> None:
    with reader:
        channels = {one.id: _declared(one, contents, meter) for one in reader.connections}
        if len(channels) < len(reader.connections):
            raise rejection("corrupt", "The bag declares a connection twice.")
        named = {function: name for name, function in known.items()}
        reader.chunks = {
            at: chunk._replace(decompressor=_bounded(named[chunk.decompressor], meter))
            for at, chunk in reader.chunks.items()
        }
        wanted = [one for one in reader.connections if channels[one.id].layout or channels[one.id].decoding]
        for number in set(channels) - {one.id for one in wanted}:
            if reader.indexes[number]:
                channels[number].count(np.array([entry.time for entry in reader.indexes[number]]))
        if not wanted:
            return
        run: list[tuple[int, bytes]] = []
        last: Any = None
        size = 0
        for one, time_ns, data in reader.messages(wanted):
            if run and (one.id != last or len(run) == _BATCH or size > _BATCH_BYTES):
                _take(run, channels[last], contents, meter)
                run, size = [], 0
            last = one.id
            run.append((time_ns, data))
            size += len(data)
        if run:
            _take(run, channels[last], contents, meter)


def _declared(connection: Any, contents: Contents, meter: Meter) -> ChannelContents:
    schema = Schema(id=connection.id, name=connection.msgtype, encoding="ros1msg", data=connection.msgdef.data.encode())
    channel = Channel(
        id=connection.id, topic=connection.topic, message_encoding="ros1", metadata={}, schema_id=connection.id
    )
    return contents.add_channel(channel, schema, meter)


def _take(run: list[tuple[int, bytes]], channel: ChannelContents, contents: Contents, meter: Meter) -> None:
    contents.add_messages(channel, [data for _, data in run], np.array([time for time, _ in run]), meter)


def _bounded(compression: str, meter: Meter) -> Callable[[bytes], bytes]:
    """What inflates a chunk to no more than may be read."""

    def inflate(data: bytes) -> bytes:
        most = meter.limits.chunk_bytes
        inflated = data
        if compression != "none":
            stream = bz2.BZ2Decompressor() if compression == "bz2" else lz4.frame.LZ4FrameDecompressor()
            inflated = stream.decompress(data, max_length=most + 1)
            if len(inflated) <= most and not stream.eof:
                raise rejection("corrupt", "A chunk of the bag is cut off.")
        if len(inflated) > most:
            raise rejection("too-large", f"A chunk of the bag inflates to more than {most} bytes; {REMEDY}.")
        meter.inflate(len(inflated))
        return inflated

    return inflate


def _counted(reader: Any, limits: Limits) -> Any:
    """The reader of rosbags that stops where an index has more entries than are read."""

    class Counted(reader):  # type: ignore[misc]
        """Counts connections, chunks and messages as they are read from the index."""

        def read_connection(self) -> Any:
            self._count("_connections", MOST_CONNECTIONS, "connections")
            return super().read_connection()

        def read_chunk_info(self) -> Any:
            self._count("_chunk_infos", MOST_CHUNKS, "chunks")
            return super().read_chunk_info()

        def read_index_data(self, pos: int, indexes: dict[int, list[Any]]) -> None:
            self.bio.most = _ENTRY_BYTES * limits.joint_states
            super().read_index_data(pos, indexes)
            self.bio.most = limits.record_bytes
            if sum(map(len, indexes.values())) > limits.joint_states:
                raise _too_many(limits.joint_states, "messages")

        def _count(self, name: str, most: int, what: str) -> None:
            count = getattr(self, name, 0) + 1
            setattr(self, name, count)
            if count > most:
                raise _too_many(most, what)

    return Counted


def _too_many(most: int, what: str) -> RecordingError:
    return rejection("too-large", f"The bag's index lists more than {most} {what}; {REMEDY}.")


class _Bounded:
    """A path whose file gives no more bytes than it has, and not many times over."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self._path, self._most = path, limits.record_bytes

    def exists(self) -> bool:
        return self._path.exists()

    def open(self, mode: str) -> BinaryIO:
        file = _BoundedFile(self._path, mode)
        file.most = self._most
        return file

    def __str__(self) -> str:
        return self._path.name


class _BoundedFile(io.BufferedReader):
    most = 0  # bytes that may be read at once

    def __init__(self, path: Path, mode: str) -> None:
        super().__init__(io.FileIO(path, mode.replace("b", "")))
        self._size = path.stat().st_size
        self._left = _OFTEN * self._size + (1 << 16)

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self._size - self.tell())
        wanted = left if size is None or size < 0 else min(size, left)
        if wanted > self.most:
            raise rejection("too-large", f"The bag has a record of {wanted} bytes, at most {self.most} are read.")
        self._left -= wanted + 1
        if self._left < 0:
            raise rejection("too-large", f"The bag's index points to the same places again and again; {REMEDY}.")
        return super().read(wanted)
