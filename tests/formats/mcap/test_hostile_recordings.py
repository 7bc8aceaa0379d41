"""Broken and hostile recordings: each ends in a RecordingError, soon, without the memory it asks for."""

from __future__ import annotations

import os
import struct
import time
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from pipeline.errors import RecordingError
from pipeline.formats.mcap.joint_states import REASONS, Limits, inspect_recording, read_joint_states, write_joint_states
from tests.support.joint_bags import (
    MAGIC,
    channel_record,
    chunk_record,
    file_of,
    message_record,
    payload,
    plain_chunk,
    record,
    schema_record,
    text,
    write_bag,
)

NAMES = ["a", "b", "c"]
START = 1_700_000_000_000_000_000
MESSAGES = [message_record(payload(NAMES, [i, 0.0, 1.0], START + i), START + i) for i in range(4)]
DECLARED = [schema_record(), channel_record()]
BOMB = 1 << 28


def outcome(path: Path, **arguments: object) -> str:
    """The reason, after no more than a second."""
    began = time.perf_counter()
    with pytest.raises(RecordingError) as caught:
        read_joint_states(path, **arguments)
    assert time.perf_counter() - began < 1.0
    assert caught.value.reason in REASONS
    assert caught.value.detail.endswith(".")
    return caught.value.reason


def reason_of(tmp_path: Path, content: bytes, **arguments: object) -> str:
    path = tmp_path / "hostile.mcap"
    path.write_bytes(content)
    return outcome(path, **arguments)


@pytest.fixture
def intact(tmp_path: Path) -> bytes:
    """A file in several chunks with every CRC there is."""
    path = tmp_path / "intact.mcap"
    q = np.random.default_rng(3).normal(size=(40, 3))
    messages = [("/joint_states", START + i, payload(NAMES, row, START + i)) for i, row in enumerate(q)]
    return write_bag(path, messages, chunk_size=900, enable_data_crcs=True).read_bytes()


def test_the_hand_made_file_is_sound(tmp_path: Path) -> None:
    path = tmp_path / "sound.mcap"
    for content in (file_of(*DECLARED, *MESSAGES), file_of(plain_chunk(*DECLARED, *MESSAGES))):
        path.write_bytes(content)
        assert read_joint_states(path).positions[:, 0].tolist() == [0, 1, 2, 3]


def test_a_file_cut_off_anywhere_is_truncated(tmp_path: Path, intact: bytes) -> None:
    for length in [*range(0, len(intact), 37), *range(len(intact) - 40, len(intact))]:
        reason = reason_of(tmp_path, intact[:length])
        assert reason == ("not-mcap" if length < len(MAGIC) else "truncated"), length


def test_any_flipped_bit_is_noticed(tmp_path: Path, intact: bytes) -> None:
    rng = np.random.default_rng(11)
    for position in rng.choice(8 * len(intact), 300, replace=False):
        flipped = bytearray(intact)
        flipped[position // 8] ^= 1 << (position % 8)
        reason_of(tmp_path, bytes(flipped))


def test_random_damage_without_data_crcs_never_escapes_as_another_error(tmp_path: Path) -> None:
    sound = file_of(plain_chunk(*DECLARED, *MESSAGES), record(12, text("demonstration") + struct.pack("<I", 0)))
    rng = np.random.default_rng(12)
    path = tmp_path / "damaged.mcap"
    for _ in range(300):
        damaged = bytearray(sound)
        start = int(rng.integers(len(MAGIC), len(sound)))
        damaged[start : start + 4] = rng.bytes(4)
        path.write_bytes(damaged)
        inspect_recording(path)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"\x89MCAP1\r\n" + bytes(99), b"#ROSBAG V2.0\n" + bytes(99)])
def test_other_files_are_not_mcap(tmp_path: Path, content: bytes) -> None:
    assert reason_of(tmp_path, content) == "not-mcap"


def test_paths_that_are_no_files_are_unreadable(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "missing.mcap", tmp_path / "pipe"):
        assert outcome(path) == "unreadable"


def test_a_report_of_a_cut_off_file_says_what_was_found_before_the_cut(tmp_path: Path, intact: bytes) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(intact[: 2 * len(intact) // 5])
    report = inspect_recording(path)
    (topic,) = report.topics
    assert (report.reason, topic.topic, topic.joints) == ("truncated", "/joint_states", ("a", "b", "c"))
    assert 0 < topic.messages < 40


def zstd(data: bytes, sized: bool = True) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=sized).compress(data)


COMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstd,
    "zstd without a size": lambda data: zstd(data, sized=False),
    "lz4": lz4.frame.compress,
    "": bytes,
}


@pytest.mark.parametrize("kind", COMPRESSORS)
def test_chunks_of_every_compression_are_read_and_their_lies_noticed(tmp_path: Path, kind: str) -> None:
    data = b"".join([*DECLARED, *MESSAGES])
    stored, name, crc = COMPRESSORS[kind](data), kind.split(" ")[0], zlib.crc32(data)
    path = tmp_path / "sound.mcap"
    path.write_bytes(file_of(chunk_record(stored, len(data), name, crc)))
    assert len(read_joint_states(path).time_ns) == 4
    for size in (0, 1, len(data) - 1, len(data) + 1):
        assert reason_of(tmp_path, file_of(chunk_record(stored, size, name, crc))) == "corrupt"
    assert reason_of(tmp_path, file_of(chunk_record(stored, len(data), name, crc ^ 1))) == "corrupt"
    assert reason_of(tmp_path, file_of(chunk_record(stored[:-9], len(data), name, crc))) == "corrupt"
    assert reason_of(tmp_path, file_of(chunk_record(b"", len(data), name, crc))) == "corrupt"


@pytest.mark.parametrize("kind", ["zstd", "zstd without a size", "lz4"])
@pytest.mark.parametrize(("stated", "reason"), [(BOMB, "too-large"), (1 << 62, "too-large"), (1 << 20, "corrupt")])
def test_a_bomb_is_refused_before_it_inflates(tmp_path: Path, kind: str, stated: int, reason: str) -> None:
    # lz4 cannot inflate to more than 255 times its size: there the limit on a chunk does the work
    content = file_of(chunk_record(COMPRESSORS[kind](bytes(BOMB)), stated, kind.split(" ")[0]))
    path = tmp_path / "bomb.mcap"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        assert outcome(path, limits=Limits(chunk_bytes=BOMB // 2)) == reason
        assert tracemalloc.get_traced_memory()[1] < 16e6
    finally:
        tracemalloc.stop()


def test_the_sum_of_chunks_and_the_number_of_messages_are_limited(tmp_path: Path) -> None:
    content = file_of(plain_chunk(*DECLARED), *[plain_chunk(*MESSAGES)] * 50)
    assert reason_of(tmp_path, content, limits=Limits(total_bytes=10_000)) == "too-large"
    assert reason_of(tmp_path, content, limits=Limits(joint_states=199)) == "too-large"
    assert reason_of(tmp_path, file_of(*DECLARED, *MESSAGES), limits=Limits(record_bytes=100)) == "too-large"
    metadata = record(12, text("m") + struct.pack("<I", 8 + (1 << 20)) + text("k") + text("v" * ((1 << 20) - 1)))
    assert reason_of(tmp_path, file_of(*[metadata] * 17)) == "too-large"
    joints = [f"j{i}" for i in range(250)]
    poses = [message_record(payload(joints, range(250), START + i), START + i) for i in range(40)]
    assert reason_of(tmp_path, file_of(*DECLARED, *poses), limits=Limits(joint_values=9_999)) == "too-large"


def test_the_number_of_small_records_is_limited(tmp_path: Path) -> None:
    nothing = struct.pack("<BQ", 0x80, 0)
    limits = Limits(steps=20_000)
    assert reason_of(tmp_path, file_of(*[nothing] * 5_001), limits=limits) == "too-large"
    assert reason_of(tmp_path, file_of(plain_chunk(nothing * 20_001)), limits=limits) == "too-large"
    assert reason_of(tmp_path, file_of(*[plain_chunk()] * 600), limits=limits) == "too-large"
    differing = [message_record(payload([f"{i:05}"], [0.0], START + i), START + i) for i in range(600)]
    assert reason_of(tmp_path, file_of(plain_chunk(*DECLARED, *differing)), limits=limits) == "too-large"
    channels = [channel_record(i, topic=f"/{i}") for i in range(2, 600)]
    assert reason_of(tmp_path, file_of(plain_chunk(*DECLARED, *channels)), limits=limits) == "too-large"


def test_a_recording_longer_than_a_month_is_no_demonstration(tmp_path: Path) -> None:
    days = [message_record(payload(NAMES, [i, 0, 0], START + i * 31 * 86_400 * 10**9), START + i) for i in range(2)]
    assert reason_of(tmp_path, file_of(*DECLARED, *days)) == "out-of-range"


def test_what_is_quoted_from_a_file_cannot_speak_to_a_terminal(tmp_path: Path) -> None:
    path = tmp_path / "loud.mcap"
    path.write_bytes(file_of(schema_record(), channel_record(topic="/\x1b]0;mine\x07\n" + "a" * 100_000, schema_id=0)))
    with pytest.raises(RecordingError) as caught:
        read_joint_states(path)
    assert caught.value.reason == "no-joint-states"
    assert caught.value.detail.isprintable()
    assert len(caught.value.detail) <= 2000


def test_a_chunk_of_very_many_different_records_stays_cheap(tmp_path: Path) -> None:
    different = [message_record(payload([f"{i:05}"], [0.0], START), START) for i in range(10_000)]
    alternating = [message_record(bytes(i // 2 % 2), START, 2) for i in range(100_000)]
    declared = [*DECLARED, channel_record(2, 0, "/other")] + [channel_record()] * 10_000
    data = b"".join([*declared, *different, *alternating])
    path = tmp_path / "many.mcap"
    path.write_bytes(file_of(chunk_record(zstd(data), len(data), "zstd")))
    began = time.perf_counter()
    assert inspect_recording(path).reason == "too-few-messages"
    assert time.perf_counter() - began < 3.0


@pytest.mark.parametrize("compression", ["bz2", "gzip", "ZSTD", "\x00" * 1000])
def test_an_unknown_compression_is_named(tmp_path: Path, compression: str) -> None:
    assert reason_of(tmp_path, file_of(chunk_record(b"abc", 3, compression))) == "unsupported-compression"


CONTRADICTIONS = {
    "no header": MAGIC + schema_record() + file_of()[8:],
    "no end of the data": MAGIC + record(1, text("") * 2) + record(2, struct.pack("<QQI", 0, 0, 0)) + MAGIC,
    "undeclared channel": file_of(schema_record(), *MESSAGES),
    "undeclared schema": file_of(channel_record(), *MESSAGES),
    "channel declared twice": file_of(*DECLARED, channel_record(topic="/b"), *MESSAGES),
    "schema declared twice": file_of(*DECLARED, schema_record(name="other/msg/Type"), *MESSAGES),
    "message without a head": file_of(*DECLARED, record(5, struct.pack("<H", 1) + bytes(10))),
    "log time beyond 2262": file_of(*DECLARED, message_record(payload(NAMES, [0, 0, 0]), 1 << 63)),
    "record longer than its chunk": file_of(plain_chunk(*DECLARED, struct.pack("<BQ", 5, 1 << 40))),
    "chunk ends in a frame": file_of(plain_chunk(*DECLARED, b"\x05\x00")),
    "chunk data longer than its record": file_of(record(6, bytes(28) + text("") + struct.pack("<Q", 1 << 63))),
    "string longer than its record": file_of(record(4, struct.pack("<HHI", 1, 0, 1 << 31))),
    "id cut off": file_of(record(3, b"\x01")),
    "map longer than its record": file_of(record(12, text("m") + struct.pack("<I", 1 << 31))),
    "topic that is no text": file_of(record(4, struct.pack("<HHI", 1, 0, 2) + b"\xff\xfe" + text("cdr") + bytes(4))),
    "fewer messages than stated": file_of(
        *DECLARED, *MESSAGES, statistics=record(11, struct.pack("<QHIIIIQQI", 5, 1, 1, 0, 0, 0, 0, 0, 0))
    ),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_contradictions_in_the_file_are_corrupt(tmp_path: Path, case: str) -> None:
    assert reason_of(tmp_path, CONTRADICTIONS[case]) == "corrupt"


SOUND = payload(NAMES, [1.0, 2.0, 3.0], START, [4.0], [5.0])
NAME_COUNT_AT, FIRST_NAME_AT = 20, 24
POSITION_COUNT_AT = 4 + 8 + 8 + 4 + 3 * 8

LIES = {
    "empty": b"",
    "shorter than its header": b"\x00\x01",
    "no content": SOUND[:4],
    "frame longer than the message": SOUND[:12] + struct.pack("<I", (1 << 32) - 1) + SOUND[16:],
    "two billion names": SOUND[:NAME_COUNT_AT] + struct.pack("<I", 1 << 31) + SOUND[NAME_COUNT_AT + 4 :],
    "a name of two billion": SOUND[:FIRST_NAME_AT] + struct.pack("<I", 1 << 31) + SOUND[FIRST_NAME_AT + 4 :],
    "a name of none": SOUND[:FIRST_NAME_AT] + struct.pack("<I", 0) + SOUND[FIRST_NAME_AT + 4 :],
    "a name that is no text": SOUND[: FIRST_NAME_AT + 4] + b"\xff" + SOUND[FIRST_NAME_AT + 5 :],
    "two billion positions": SOUND[:POSITION_COUNT_AT] + struct.pack("<I", 1 << 31) + SOUND[POSITION_COUNT_AT + 4 :],
    "two positions for three names": payload(NAMES, [1.0, 2.0]),
    "a joint twice": payload(["a", "a"], [1.0, 2.0]),
    "efforts cut off": SOUND[:-1],
}


@pytest.mark.parametrize("case", LIES)
def test_lies_within_a_message_are_corrupt(tmp_path: Path, case: str) -> None:
    for messages in ([LIES[case]] * 3, [SOUND, LIES[case], SOUND]):
        records = [message_record(data, START + i) for i, data in enumerate(messages)]
        assert reason_of(tmp_path, file_of(plain_chunk(*DECLARED, *records))) == "corrupt"


@pytest.mark.parametrize("kind", [b"\x00\x03", b"\x00\x07", b"\x00\x0b", b"\x01\x01"])
def test_other_representations_than_plain_cdr_are_named(tmp_path: Path, kind: bytes) -> None:
    records = [message_record(kind + SOUND[2:], START + i) for i in range(2)]
    assert reason_of(tmp_path, file_of(*DECLARED, *records)) == "unsupported-encoding"


def test_what_this_package_writes_is_guarded_bit_by_bit(tmp_path: Path) -> None:
    path = tmp_path / "written.mcap"
    times = START + 10_000_000 * np.arange(50)
    positions = np.random.default_rng(5).normal(size=(50, 3))
    write_joint_states(path, times, NAMES, positions, topic="/arm", metadata={"demonstration": {"participant": "p"}})
    written = path.read_bytes()
    for position in np.random.default_rng(6).choice(8 * len(written), 200, replace=False):
        flipped = bytearray(written)
        flipped[position // 8] ^= 1 << (position % 8)
        reason_of(tmp_path, bytes(flipped))


def test_what_stands_before_a_cut_is_salvaged_only_when_asked(tmp_path: Path, intact: bytes) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(intact)
    whole = read_joint_states(path, salvage=True)
    assert whole.lost is None
    kept = []
    for length in range(len(MAGIC), len(intact), 61):
        path.write_bytes(intact[:length])
        report = inspect_recording(path)
        assert report.reason == "truncated"
        if report.salvageable is None:
            with pytest.raises(RecordingError) as caught:
                read_joint_states(path, salvage=True)
            assert caught.value.reason in ("no-joint-states", "too-few-messages")
            continue
        part = read_joint_states(path, salvage=True)
        count = len(part.time_ns)
        assert (part.positions == whole.positions[:count]).all()
        assert part.lost is not None
        assert "checksum" not in part.lost
        assert f"{count} messages before" in part.lost or count == 40
        kept.append(count)
    assert kept == sorted(kept)
    assert {kept[0], kept[-1]} == {min(kept), 40}
    assert len(set(kept)) > 3


def test_a_failed_checksum_before_the_cut_is_never_salvaged(tmp_path: Path, intact: bytes) -> None:
    path = tmp_path / "cut.mcap"
    cut = bytearray(intact[: 3 * len(intact) // 5])
    path.write_bytes(cut)
    assert read_joint_states(path, salvage=True).lost
    data = intact.index(b"zstd") + 30
    cut[data] ^= 1
    path.write_bytes(cut)
    assert outcome(path, salvage=True) == "corrupt"


def test_a_salvage_says_what_no_checksum_covers_and_that_a_cut_behind_the_messages_loses_none(tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    sound = file_of(*DECLARED, *MESSAGES)
    for zeros in (b"", bytes(5000)):
        path.write_bytes(sound[: sound.index(MESSAGES[3])] + zeros)
        part = read_joint_states(path, salvage=True)
        assert part.positions[:, 0].tolist() == [0, 1, 2]
        assert part.lost is not None
        assert part.lost.startswith(f"{len(zeros)} bytes from byte ")
        assert "covered by no checksum" in part.lost
    path.write_bytes(sound[:-1])
    whole = read_joint_states(path, salvage=True)
    assert len(whole.time_ns) == 4
    assert whole.lost == "No message: the file breaks off after the last of them."


def test_a_file_with_holes_is_refused_by_its_length_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "holes.mcap"
    with path.open("wb") as stream:
        stream.write(file_of(*DECLARED, *MESSAGES)[:-45] + struct.pack("<BQ", 9, 1 << 50))
        stream.truncate(20 << 30)

    assert outcome(path) == "too-large"


def attachment(data: bytes, crc: int | None = None, **lies: int) -> bytes:
    length = lies.get("length", len(data))
    body = bytes(16) + text("photo") + text("image/png") + struct.pack("<Q", length) + data
    return record(9, body + struct.pack("<I", zlib.crc32(body) if crc is None else crc))


@pytest.mark.parametrize("data", [b"", b"x" * 1000])
def test_an_attachment_that_is_whole_changes_nothing(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.mcap"
    for content in (attachment(data), attachment(data, crc=0)):
        path.write_bytes(file_of(*DECLARED, *MESSAGES, content))
        assert read_joint_states(path).positions[:, 0].tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    "content",
    [
        attachment(b"x" * 9, crc=1), attachment(b"x" * 9, length=8), attachment(b"x" * 9, length=1 << 62),
        record(9, bytes(16)), record(9, b""), attachment(b"x") [:-1] + b"!",
    ],
)  # fmt: skip
def test_an_attachment_that_contradicts_itself_is_corrupt(tmp_path: Path, content: bytes) -> None:
    assert reason_of(tmp_path, file_of(*DECLARED, *MESSAGES, content)) == "corrupt"


END = record(15, bytes(4))


@pytest.mark.parametrize(
    "behind",
    [
        END, MESSAGES[0], plain_chunk(*MESSAGES[2:]), attachment(b""), record(12, text("a") + struct.pack("<I", 0)),
        record(7, bytes(6)), record(1, text("ros2") + text("test")), schema_record() + MESSAGES[3],
    ],
)  # fmt: skip
def test_what_stands_behind_the_end_of_the_data_is_refused(tmp_path: Path, behind: bytes) -> None:
    assert reason_of(tmp_path, file_of(*DECLARED, *MESSAGES[:2], statistics=behind)) == "corrupt"
    assert reason_of(tmp_path, file_of(*DECLARED, *MESSAGES[:2], END, *MESSAGES[2:])) == "corrupt"


def test_two_headers_are_refused(tmp_path: Path) -> None:
    again = record(1, text("ros2") + text("test"))
    assert reason_of(tmp_path, file_of(*DECLARED, *MESSAGES, again)) == "corrupt"
