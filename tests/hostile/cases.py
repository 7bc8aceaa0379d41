"""Broken and hostile recordings by number: case `n` is the same bytes in every run, whatever other cases there are."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer

from pipeline.formats.mcap.joint_state_cdr import encode_joint_states
from tests.support.joint_bags import (
    JOINT_STATE,
    MAGIC,
    SCHEMA,
    channel_record,
    chunk_record,
    file_of,
    message_record,
    payload,
    record,
    schema_record,
    text,
)

SEED = 20_261_123
NAMES = ("bend", "gripper", "rail", "swing")  # as the arm in tests/support/gantry_project.py has them, and one more
START_NS = 1_700_000_000_000_000_000
STEP_NS = 50_000_000  # so that a few dozen poses are no faster than an arm
HEAVY_EVERY = 100  # every hundredth case asks for gigabytes or hours
HEADER, FOOTER, MESSAGE, CHUNK, STATISTICS, METADATA, DATA_END = 1, 2, 5, 6, 11, 12, 15

# how a recording that is cut off may end; all but the first with salvage, the last five where too little is left
CUT = {"truncated", "salvaged", "no-joint-states", "joints-missing", "too-few-messages", "does-not-move", "far-ends"}
Rng = np.random.Generator


@dataclass(frozen=True)
class Case:
    """One file: its number, what was done to it, its bytes, and how it may end (anything but a crash, if empty)."""

    number: int
    kind: str
    content: bytes
    allowed: frozenset[str] = frozenset()


def case(number: int) -> Case:
    """The case `number`."""
    rng = np.random.default_rng([SEED, number])
    kinds = HEAVY if number % HEAVY_EVERY == HEAVY_EVERY - 1 else LIGHT
    names = sorted(kinds)
    kind = names[(number // HEAVY_EVERY if kinds is HEAVY else number) % len(names)]
    made = kinds[kind](rng)
    content, allowed = made if isinstance(made, tuple) else (made, ())
    return Case(number, kind, content, frozenset(allowed))


# What a sound recording is made of.


def _poses(rng: Rng, count: int) -> np.ndarray:
    s = np.clip(np.linspace(-0.2, 1.2, count), 0, 1)[:, None]
    start, goal = np.array([-0.3, -0.6, 0.1]), np.array([0.3, 0.9, -0.2])
    pose = start + s * (goal - start) + rng.uniform(-0.1, 0.1) * np.sin(np.pi * s)
    return np.stack([pose[:, 2], 0 * s[:, 0], pose[:, 0], pose[:, 1]], axis=1)


def _payloads(rng: Rng, count: int) -> list[bytes]:
    times = START_NS + STEP_NS * np.arange(count)
    none = np.empty((count, 0))
    rows = encode_joint_states(times, NAMES, (_poses(rng, count), none, none))
    return [row.tobytes() for row in rows]


def _messages(payloads: list[bytes], channel_id: int = 1) -> list[bytes]:
    return [message_record(data, START_NS + STEP_NS * i, channel_id) for i, data in enumerate(payloads)]


def _sound(rng: Rng, *, crcs: bool = True, chunked: bool | None = None) -> bytes:
    """By the official writer, with options by chance."""
    stream = io.BytesIO()
    payloads = _payloads(rng, int(rng.integers(30, 120)))
    writer = Writer(
        stream,
        chunk_size=int(rng.choice([500, 3_000, 1 << 20])),
        compression=CompressionType(int(rng.integers(1, 4))),
        use_chunking=bool(rng.integers(4)) if chunked is None else chunked,
        enable_crcs=crcs,
        enable_data_crcs=crcs,
        use_statistics=bool(rng.integers(2)),
        use_summary_offsets=bool(rng.integers(2)),
    )
    writer.start("ros2", "test")
    if rng.integers(2):
        writer.add_metadata("demonstration", {"participant": "somebody"})
    channel = writer.register_channel("/arm", "cdr", writer.register_schema(JOINT_STATE, "ros2msg", SCHEMA))
    for i, data in enumerate(payloads):
        writer.add_message(channel, START_NS + i * STEP_NS, data, START_NS + i * STEP_NS, i)
    writer.finish()
    return stream.getvalue()


def _split(content: bytes) -> list[bytes]:
    """The outer records of a sound file."""
    found, at = [], len(MAGIC)
    while at < len(content) - len(MAGIC):
        length = 9 + struct.unpack_from("<Q", content, at + 1)[0]
        found.append(content[at : at + length])
        at += length
    return found


def _joined(records: list[bytes]) -> bytes:
    return MAGIC + b"".join(records) + MAGIC


def _plain_chunk(data: bytes, kind: str = "", crc: bool = True) -> bytes:
    return chunk_record(_COMPRESS[kind](data), len(data), kind.split(" ")[0], zlib.crc32(data) if crc else 0)


_COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "lz4": lz4.frame.compress,
    "zstd": lambda data: zstandard.ZstdCompressor().compress(data),
    "zstd without a size": lambda data: zstandard.ZstdCompressor(write_content_size=False).compress(data),
}


def _file(rng: Rng, *inner: bytes, **more: Any) -> bytes:
    """A file of the given inner records, in a chunk or not, without CRC of the whole."""
    if rng.integers(2):
        kind = str(rng.choice(list(_COMPRESS)))
        return file_of(_plain_chunk(b"".join(inner), kind, crc=bool(rng.integers(2))), **more)
    return file_of(*inner, **more)


def _lie(rng: Rng, truth: int, bits: int) -> int:
    top = 1 << bits
    lies = [0, 1, truth - 1, truth + 1, 2 * truth, 1 << 20, 1 << 31, (1 << 31) - 1, (1 << 32) - 1, top >> 1, top - 1]
    return int([*lies, int(rng.integers(0, 1 << 31))][int(rng.integers(len(lies) + 1))]) % top


def _flip(rng: Rng, content: bytes, count: int, first: int = 0) -> bytes:
    changed = bytearray(content)
    for bit in rng.integers(8 * first, 8 * len(content), count).tolist():
        changed[bit // 8] ^= 1 << (bit % 8)
    return bytes(changed)


# The kinds: each takes a random generator, and gives the bytes and, where it is known, how the case must end.


def sound(rng: Rng) -> tuple[bytes, set[str]]:
    return _sound(rng, crcs=bool(rng.integers(2))), {"usable"}


def bits_flipped_under_checksums(rng: Rng) -> tuple[bytes, set[str]]:
    content = _sound(rng)
    at = int(rng.integers(8 * len(content)))
    changed = bytearray(content)
    changed[at // 8] ^= 1 << (at % 8)
    return bytes(changed), CUT | {"corrupt", "not-mcap", "too-large", "unsupported-compression", "unsupported-encoding"}


def bits_flipped_without_checksums(rng: Rng) -> bytes:
    return _flip(rng, _sound(rng, crcs=False), int(rng.integers(1, 9)))


def bytes_replaced(rng: Rng) -> bytes:
    content = bytearray(_sound(rng, crcs=False))
    length = int(rng.integers(1, 64))
    start = int(rng.integers(8, len(content) - length))
    content[start : start + length] = bytes(length) if rng.integers(2) else rng.bytes(length)
    return bytes(content)


def cut_at_a_record(rng: Rng) -> tuple[bytes, set[str]]:
    records = _split(_sound(rng))
    whole = MAGIC + b"".join(records[: int(rng.integers(len(records)))])
    return whole[: max(0, len(whole) - int(rng.choice([0, 0, 1, 2, 8])))], CUT | {"not-mcap"}


def cut_within_a_frame(rng: Rng) -> tuple[bytes, set[str]]:
    records = _split(_sound(rng))
    last = int(rng.integers(len(records)))
    return MAGIC + b"".join(records[:last]) + records[last][: int(rng.integers(1, 9))], CUT


def cut_anywhere(rng: Rng) -> tuple[bytes, set[str]]:
    content = _sound(rng)
    return content[: int(rng.integers(len(content)))], CUT | {"not-mcap"}


def cut_and_padded(rng: Rng) -> bytes:
    content = _sound(rng)
    length = int(rng.integers(1, 5000))
    return content[: int(rng.integers(8, len(content)))] + (bytes(length) if rng.integers(2) else rng.bytes(length))


def record_length_that_lies(rng: Rng) -> bytes:
    records = _split(_sound(rng, crcs=bool(rng.integers(2))))
    place = int(rng.integers(len(records)))
    truth = len(records[place]) - 9
    records[place] = records[place][:1] + struct.pack("<Q", _lie(rng, truth, 64)) + records[place][9:]
    return _joined(records)


def inner_length_that_lies(rng: Rng) -> bytes:
    inner = [schema_record(), channel_record(), *_messages(_payloads(rng, 30))]
    place = int(rng.integers(len(inner)))
    truth = len(inner[place]) - 9
    inner[place] = inner[place][:1] + struct.pack("<Q", _lie(rng, truth, 64)) + inner[place][9:]
    return _file(rng, *inner)


def field_that_lies(rng: Rng) -> bytes:
    """Any four bytes of a record's body as a length that is too long, or too short."""
    outer = [
        record(HEADER, text("ros2") + text("test")),
        record(METADATA, text("demonstration") + struct.pack("<I", 20) + text("participant") + text("p")),
        schema_record(),
        channel_record(),
        *_messages(_payloads(rng, 4)),
        record(STATISTICS, struct.pack("<QHIIIIQQI", 4, 1, 1, 0, 1, 0, 0, 0, 0)),
    ]
    place = int(rng.integers(len(outer)))
    at = 9 + int(rng.integers(max(1, len(outer[place]) - 12)))
    changed = bytearray(outer[place])
    truth = struct.unpack_from("<I", changed, at)[0]
    struct.pack_into("<I", changed, at, _lie(rng, truth, 32))
    outer[place] = bytes(changed)
    return MAGIC + b"".join(outer) + record(DATA_END, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC


def chunk_that_claims_gigabytes(rng: Rng) -> tuple[bytes, set[str]]:
    data = b"".join([schema_record(), channel_record(), *_messages(_payloads(rng, 20))])
    kind = str(rng.choice(list(_COMPRESS)))
    size = int(rng.choice([1 << 30, 5 << 30, 1 << 40, (1 << 63) - 1]))
    return file_of(chunk_record(_COMPRESS[kind](data), size, kind.split(" ")[0])), {"too-large", "corrupt"}


@cache
def _bomb(kind: str, size: int) -> bytes:
    return _COMPRESS[kind](bytes(size))


def small_bomb(rng: Rng) -> tuple[bytes, set[str]]:
    kind = str(rng.choice(["lz4", "zstd", "zstd without a size"]))
    size = int(rng.choice([1 << 22, 1 << 24, 1 << 26]))
    stated = int(rng.choice([0, 1, 1000, size - 1, size, size + 1, size * 64]))
    copies = int(rng.integers(1, 4))
    chunk = chunk_record(_bomb(kind, size) * copies, stated, kind.split(" ")[0])
    return file_of(chunk), {"too-large", "corrupt", "no-joint-states"}


def compression_unknown(rng: Rng) -> tuple[bytes, set[str]]:
    names = ["bz2", "gzip", "ZSTD", "none", "lz4 ", "zstd\0", "\x1b[2J", "x" * 5000]
    data = b"".join([schema_record(), channel_record(), *_messages(_payloads(rng, 5))])
    return file_of(chunk_record(data, len(data), names[int(rng.integers(len(names)))])), {"unsupported-compression"}


def compressed_data_damaged(rng: Rng) -> bytes:
    data = b"".join([schema_record(), channel_record(), *_messages(_payloads(rng, 40))])
    kind = str(rng.choice(["lz4", "zstd", "zstd without a size"]))
    stored = _COMPRESS[kind](data)
    damaged = [_flip(rng, stored, 3), stored[:-5], stored + b"\0" * 9, stored[4:], rng.bytes(len(stored)), stored * 2]
    crc = int(rng.choice([0, zlib.crc32(data)]))
    return file_of(chunk_record(damaged[int(rng.integers(6))], len(data), kind.split(" ")[0], crc))


def checksum_wrong(rng: Rng) -> tuple[bytes, set[str]]:
    """Of a chunk, the data section or the summary; with the summary and without."""
    records = _split(_sound(rng))
    end = next(i for i, r in enumerate(records) if r[0] == DATA_END)
    wrong = struct.pack("<I", int(rng.integers(1, 1 << 32)))
    chunks = [i for i, r in enumerate(records) if r[0] == CHUNK]
    which = int(rng.integers(3))
    if which == 0 and chunks:
        place = int(rng.choice(chunks))
        records[place] = records[place][: 9 + 24] + wrong + records[place][9 + 28 :]
    elif which == 1:
        records[-1] = records[-1][:-4] + wrong
    else:
        records[end] = records[end][:9] + wrong
    if rng.integers(2) and which != 1:
        records = [*records[: end + 1], record(FOOTER, bytes(20))]
    return _joined(records), {"corrupt"}


def magic_wrong(rng: Rng) -> tuple[bytes, set[str]]:
    content = _sound(rng)
    starts = [
        b"",
        b"\x89",
        b"\x89MCAP1\r\n",
        b"\x89MCAP0\n\n",
        b"#ROSBAG V2.0\n",
        b"PAR1",
        b"SQLite format 3\0",
        bytes(8),
    ]
    if rng.integers(2):
        return starts[int(rng.integers(len(starts)))] + (content[8:] if rng.integers(2) else b""), {"not-mcap"}
    return content[:-8] + rng.bytes(int(rng.integers(0, 12))), CUT


def ids_duplicate_or_missing(rng: Rng) -> bytes:
    messages = _messages(_payloads(rng, 25))
    choices = [
        [schema_record(), schema_record(), channel_record(), channel_record(), *messages],
        [schema_record(), channel_record(), *messages, channel_record(topic="/b")],
        [schema_record(), channel_record(), *messages[:9], schema_record(name="other/msg/Type"), *messages[9:]],
        [schema_record(), *messages],
        [channel_record(), *messages],
        [channel_record(schema_id=0), *messages],
        [schema_record(0), channel_record(schema_id=0), *messages],
        [channel_record(), schema_record(), *messages],
        [*messages, schema_record(), channel_record()],
        [schema_record(), channel_record(), channel_record(2), *messages, *_messages(_payloads(rng, 25), 2)],
        [schema_record(65_535), channel_record(65_535, 65_535), *_messages(_payloads(rng, 25), 65_535)],
    ]
    return _file(rng, *choices[int(rng.integers(len(choices)))])


def payload_field_that_lies(rng: Rng) -> bytes:
    payloads = _payloads(rng, 20)
    for place in rng.choice(20, int(rng.integers(1, 21)), replace=False).tolist():
        changed = bytearray(payloads[place])
        at = 4 * int(rng.integers(1, len(changed) // 4))
        truth = struct.unpack_from("<I", changed, at)[0]
        struct.pack_into("<I", changed, at, _lie(rng, truth, 32))
        payloads[place] = bytes(changed)
    return _file(rng, schema_record(), channel_record(), *_messages(payloads))


def payload_cut_or_grown(rng: Rng) -> bytes:
    payloads = _payloads(rng, 20)
    place = int(rng.integers(20))
    data = payloads[place]
    payloads[place] = (
        data[: int(rng.integers(len(data)))] if rng.integers(2) else data + rng.bytes(int(rng.integers(1, 99)))
    )
    return _file(rng, schema_record(), channel_record(), *_messages(payloads))


def payload_of_noise(rng: Rng) -> bytes:
    head = [b"", b"\0\1\0\0", b"\0\0\0\0", b"\0\3\0\0", b"\xff\xff\xff\xff"][int(rng.integers(5))]
    payloads = [head + rng.bytes(int(rng.integers(0, 300))) for _ in range(20)]
    return _file(rng, schema_record(), channel_record(), *_messages(payloads))


def payload_bits_flipped(rng: Rng) -> bytes:
    payloads = [_flip(rng, data, 1) if rng.integers(4) == 0 else data for data in _payloads(rng, 40)]
    return _file(rng, schema_record(), channel_record(), *_messages(payloads))


def two_billion_of_something(rng: Rng) -> tuple[bytes, set[str]]:
    """2^31 bytes of frame id, names, bytes of a name, positions, velocities or efforts."""
    data = payload(NAMES, [0.0] * 4, START_NS, [0.0] * 4, [0.0] * 4)
    places = [12, 20, 24, 36, 72, 108, 148]
    at = places[int(rng.integers(len(places)))]
    count = int(rng.choice([1 << 31, (1 << 31) - 1, (1 << 32) - 1, 1 << 28]))
    lying = data[:at] + struct.pack("<I", count) + data[at + 4 :]
    mixed = [lying, *_payloads(rng, 5)] if rng.integers(2) else [lying] * 5
    return _file(rng, schema_record(), channel_record(), *_messages(mixed)), {"corrupt"}


def numbers_that_are_none(rng: Rng) -> bytes:
    poses = _poses(rng, 40)
    odd = [np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e6, 1.1e6, 1e17, -0.0]
    poses[rng.integers(40), rng.integers(4)] = odd[int(rng.integers(len(odd)))]
    return _file(
        rng, schema_record(), channel_record(),
        *[
            message_record(payload(NAMES, row, START_NS + STEP_NS * i), START_NS + STEP_NS * i)
            for i, row in enumerate(poses)
        ],
    )  # fmt: skip


def times_that_are_none(rng: Rng) -> bytes:
    """Stamps before 1970, nanoseconds beyond a second, log times beyond 2262, centuries between two poses."""
    second = START_NS // 10**9
    stamps = [
        (0, 0),
        (-1, 0),
        (0, 1),
        (-(1 << 31), 0),
        ((1 << 31) - 1, (1 << 32) - 1),
        (second, 0),
        (second + 31 * 86_400, 0),
    ]
    logs = [0, 1, START_NS, (1 << 63) - 1, 1 << 63, (1 << 64) - 1]
    messages = []
    for i, row in enumerate(_poses(rng, 30)):
        data = bytearray(payload(NAMES, row, START_NS + STEP_NS * i))
        if rng.integers(8) == 0:
            struct.pack_into("<iI", data, 4, *stamps[int(rng.integers(len(stamps)))])
        log = logs[int(rng.integers(len(logs)))] if rng.integers(8) == 0 else START_NS + STEP_NS * i
        messages.append(message_record(bytes(data), log))
    return _file(rng, schema_record(), channel_record(), *messages)


def texts_that_do_harm(rng: Rng) -> bytes:
    """Control codes, megabytes, reserved words and no text at all, as topics, joints, metadata and schema names."""
    harm = [
        b"\x1b]0;mine\x07", b"\n\r\t", b"\xff\xfe", b"\0", b"", "\u202e\u2066".encode(), b"a" * 1_000_000, b"all",
        b"task",
        b"../../etc/passwd", b"'; drop table posteriors; --", b"<script>alert(1)</script>", b"=cmd()", b"[red]x[/red]",
        b"{\"effort\": NaN}", b"[" * 9000, b"{\"effort\": 1e999}", b"{\"effort\": 1}", b"\xed\xa0\x80", b"9" * 5000,
    ]  # fmt: skip

    def pick(usual: bytes) -> bytes:
        value = harm[int(rng.integers(len(harm)))] if rng.integers(2) else usual
        return struct.pack("<I", len(value)) + value

    about = pick(b"participant") + pick(b"somebody") + pick(b"true_theta") + pick(b"{}")
    return file_of(
        record(METADATA, pick(b"demonstration") + struct.pack("<I", len(about)) + about),
        record(3, struct.pack("<H", 1) + pick(JOINT_STATE.encode()) + pick(b"ros2msg") + pick(b"")),
        record(4, struct.pack("<HH", 1, 1) + pick(b"/arm") + pick(b"cdr") + struct.pack("<I", 0)),
        *_messages(_payloads(rng, 20)),
    )


def metadata_that_does_harm(rng: Rng) -> bytes:
    """What a recording says about who demonstrated and what they wanted."""
    people = ["somebody", "all", "task", "", " ", "a\nb", "x" * 300, "\x1b[2J", "\u202eabc", "p" * 200]
    thetas = ["{}", "[]", "null", "nan", '{"a": NaN}', '{"a": 1e999}', '{"a": "b"}', '{"a": true}', '{"a": [1]}',
              "9" * 9999, "[" * 9999, '{"a": -2.5}', '{"a": 1e10}', "{" * 20_000,
              '{"a": ' + "9" * 400 + "}"]  # fmt: skip
    about = text("participant") + _text(people[int(rng.integers(len(people)))])
    about += text("true_theta") + text(thetas[int(rng.integers(len(thetas)))])
    if rng.integers(4) == 0:
        about += text("simulated") + text("true")
    return file_of(
        record(METADATA, text("demonstration") + struct.pack("<I", len(about)) + about),
        schema_record(),
        channel_record(),
        *_messages(_payloads(rng, 20)),
    )


def _text(value: str) -> bytes:
    encoded = value.encode()
    return struct.pack("<I", len(encoded)) + encoded


def records_shuffled(rng: Rng) -> bytes:
    """Records left out, doubled or exchanged, of a file without checksums."""
    records = _split(_sound(rng, crcs=False))
    for _ in range(int(rng.integers(1, 4))):
        if not records:
            break
        one, other = (int(rng.integers(len(records))) for _ in range(2))
        action = int(rng.integers(3))
        if action == 0:
            del records[one]
        elif action == 1:
            records.insert(other, records[one])
        else:
            records[one], records[other] = records[other], records[one]
    return _joined(records)


def records_of_noise(rng: Rng) -> bytes:
    """Any record types, with bodies of noise."""
    return file_of(*[record(int(rng.integers(0, 256)), rng.bytes(int(rng.integers(0, 60)))) for _ in range(30)])


def files_put_together(rng: Rng) -> bytes:
    one, other = _sound(rng, crcs=bool(rng.integers(2))), _sound(rng, crcs=bool(rng.integers(2)))
    cut = int(rng.integers(8, len(one)))
    nested = _plain_chunk(_plain_chunk(schema_record() + channel_record() + b"".join(_messages(_payloads(rng, 9)))))
    return [
        one + other, one[:-8] + other, one[:cut] + other[8:], one[:cut] + other[cut:], other + bytes(99),
        file_of(nested), file_of(record(HEADER, bytes(8)), *_split(one)),
    ][int(rng.integers(7))]  # fmt: skip


def drivers_on_one_topic(rng: Rng) -> bytes:
    """Messages of other joints, of fewer, of none, in other orders and byte orders, on one topic or two."""
    poses = _poses(rng, 40)
    out = []
    for i, row in enumerate(poses):
        names, values = list(NAMES), row.tolist()
        order, channel_id = "<", 1
        match int(rng.integers(10)):
            case 0:
                names, values = names[::-1], values[::-1]
            case 1:
                names, values = ["other"], [0.0]
            case 2:
                values = []
            case 3:
                order = ">"
            case 4 if rng.integers(8) == 0:
                names, values = names[:2], values[:2]
            case 5 if rng.integers(8) == 0:
                channel_id = 2
            case _:
                pass
        out.append(message_record(payload(names, values, START_NS + i, order=order), START_NS + i, channel_id))
    return _file(rng, schema_record(), channel_record(), channel_record(2, topic="/other_arm"), *out)


def schema_text_that_lies(rng: Rng) -> bytes:
    """Lines of the schema's text left out, doubled, exchanged or of another type; other encodings; no text."""
    lines = SCHEMA.splitlines()
    for _ in range(int(rng.integers(1, 4))):
        one, other = (int(rng.integers(len(lines))) for _ in range(2))
        action = int(rng.integers(5))
        if action == 0 and len(lines) > 1:
            del lines[one]
        elif action == 1:
            lines.insert(other, lines[one])
        elif action == 2:
            lines[one], lines[other] = lines[other], lines[one]
        elif action == 3:
            lines[one] = lines[one].replace(b"float64", rng.choice([b"float32", b"string", b"uint8"]))
        else:
            lines[one] = rng.bytes(int(rng.integers(0, 40)))
    written = b"" if rng.integers(8) == 0 else b"\n".join(lines)
    language = str(rng.choice(["ros2msg"] * 5 + ["ros1msg", "ros2idl", "protobuf", "jsonschema", ""]))
    encoding = str(rng.choice(["cdr"] * 5 + ["ros1", "json", "protobuf", ""]))
    named = struct.pack("<H", 1) + text(JOINT_STATE) + text(language) + struct.pack("<I", len(written)) + written
    channel = struct.pack("<HH", 1, 1) + text("/arm") + text(encoding) + struct.pack("<I", 0)
    return _file(rng, record(3, named), record(4, channel), *_messages(_payloads(rng, 40)))


def records_behind_the_data(rng: Rng) -> tuple[bytes, set[str]]:
    """Messages, chunks or whole files behind the end of the data section."""
    behind = [
        b"".join(_messages(_payloads(rng, 9))), _plain_chunk(b"".join(_messages(_payloads(rng, 9)))),
        record(DATA_END, bytes(4)), record(METADATA, text("demonstration") + struct.pack("<I", 0)),
        record(HEADER, text("ros2") + text("test")), _attachment(b"x"), record(7, bytes(6)),
    ]  # fmt: skip
    messages = _messages(_payloads(rng, 40))
    extra = behind[int(rng.integers(len(behind)))]
    return file_of(schema_record(), channel_record(), *messages, statistics=extra), {"corrupt"}


def attachments_that_lie(rng: Rng) -> bytes:
    """Attachments whose lengths or checksum are wrong by chance."""
    data = bytearray(_attachment(rng.bytes(int(rng.integers(0, 300)))))
    for _ in range(int(rng.integers(0, 3))):
        data[int(rng.integers(9, len(data)))] ^= 1 << int(rng.integers(8))
    return file_of(schema_record(), channel_record(), bytes(data), *_messages(_payloads(rng, 40)))


def _attachment(data: bytes) -> bytes:
    body = bytes(16) + text("photo") + text("image/png") + struct.pack("<Q", len(data)) + data
    return record(9, body + struct.pack("<I", zlib.crc32(body)))


# Heavy kinds: what asks for more than it may have.


def _bomb_of(data: bytes, copies: int) -> Iterator[bytes]:
    """A chunk of `copies` times `data`, stored in about 250 times less: zstd would pass the limit on the ratio."""
    yield _plain_chunk(data * copies, "lz4")


def channels_by_the_hundred_thousand(rng: Rng) -> bytes:
    count = 100_000
    long = "/" + "t" * int(rng.choice([1, 40, 400]))
    channels = [channel_record(i % 65_536, int(rng.integers(2)), f"{long}{i % 65_536}") for i in range(1, count)]
    messages = [message_record(b"", START_NS, 1 + i % 60_000) for i in range(int(rng.choice([0, 60_000])))]
    inner = [schema_record(), *channels, *messages]
    return file_of(_plain_chunk(b"".join(inner), "zstd")) if rng.integers(2) else file_of(*inner)


def big_bomb(rng: Rng) -> bytes:
    kind = str(rng.choice(["lz4", "zstd", "zstd without a size"]))
    size = 1 << int(rng.choice([28, 29, 30]))
    stated = int(rng.choice([1 << 20, 64 << 20, size]))
    return file_of(*[chunk_record(_bomb(kind, size), stated, kind.split(" ")[0])] * int(rng.integers(1, 4)))


def many_chunks_of_the_greatest_size(rng: Rng) -> bytes:
    size = 60 << 20
    filler = record(0x80, bytes(1 << int(rng.integers(10, 20))))
    chunks = list(_bomb_of(filler, size // len(filler)))
    return file_of(*chunks * int(rng.integers(5, 30)))


def records_without_content(rng: Rng) -> bytes:
    nothing = struct.pack("<BQ", int(rng.choice([0x80, 0xFF, 8, 13])), 0)
    if rng.integers(2):
        return file_of(*list(_bomb_of(nothing, (60 << 20) // 9)) * 20)
    return file_of(nothing * (30 << 20 >> 3))


def messages_that_alternate(rng: Rng) -> bytes:
    pair = message_record(b"", START_NS, 1) + message_record(b"", START_NS, 2)
    declared = _plain_chunk(schema_record() + channel_record() + channel_record(2, 0, "/b"))
    return file_of(declared, *list(_bomb_of(pair, (60 << 20) // len(pair))) * int(rng.integers(1, 9)))


def messages_that_all_differ(rng: Rng) -> bytes:
    """Other names, or another length, in every message."""
    count = int(rng.choice([20_000, 60_000]))
    if rng.integers(2):
        payloads = [payload([f"j{i}"], [0.1]) for i in range(count)]
    else:
        payloads = [payload(["a"], [0.1]) + bytes(i) for i in range(min(count, 9000))]
    joints = [payload([f"j{i}_{k}" for k in range(250)], [0.0] * 250) for i in range(1500)] if rng.integers(2) else []
    return file_of(schema_record(), channel_record(), *_messages([*payloads, *joints]))


def poses_by_the_million(rng: Rng) -> bytes:
    """Sound content, as much as is allowed and more: many poses of few joints, or fewer of very many."""
    joints = int(rng.choice([1, 7, 250]))
    names = [f"joint_{i}" for i in range(joints)]
    one = message_record(payload(names, [0.25] * joints, START_NS), START_NS)
    per_chunk = (48 << 20) // len(one)
    chunks = max(1, round(float(rng.choice([0.5, 0.99, 1.2])) * 16_000_000 / joints / per_chunk))
    return file_of(_plain_chunk(schema_record() + channel_record()), *list(_bomb_of(one, per_chunk)) * min(chunks, 20))


def motion_by_the_million(rng: Rng) -> bytes:
    """A usable recording near the limits: poses of the arm, each at a time of its own."""
    count = int(rng.choice([300_000, 900_000]))
    times = START_NS + 1_000_000 * np.arange(count)
    s = np.linspace(0, 1, count)[:, None]
    pose = np.array([0.1, 0, -0.3, -0.6]) + s * np.array([-0.3, 0, 0.6, 1.5])
    none = np.empty((count, 0))
    rows = encode_joint_states(times, NAMES, (pose, none, none))
    head = np.frombuffer(message_record(bytes(rows.shape[1]), 0)[:31], np.uint8)
    framed = np.concatenate([np.tile(head, (count, 1)), rows], axis=1)
    framed[:, 15:23] = times.astype("<u8")[:, None].view(np.uint8)
    chunks = [_plain_chunk(part.tobytes(), "lz4") for part in np.array_split(framed, 1 + framed.size // (20 << 20))]
    return file_of(_plain_chunk(schema_record() + channel_record()), *chunks)


def maps_without_end(rng: Rng) -> bytes:
    """Metadata, channels and statistics with millions of entries."""
    count = int(rng.choice([100_000, 1_000_000, 4_000_000]))
    body = b"".join([struct.pack("<II", 1, 0)[:4] + bytes([65 + k]) + bytes(4) for k in range(26)]) * (count // 26)
    sized = struct.pack("<I", len(body)) + body
    statistics = record(11, struct.pack("<QHIIIIQQI", 0, 1, 1, 0, 0, 0, 0, 0, count * 10) + bytes(count * 10))
    which = int(rng.integers(3))
    if which == 0:
        return file_of(record(METADATA, text("m") + sized))
    if which == 1:
        return file_of(record(4, struct.pack("<HH", 1, 0) + text("/t") + text("cdr") + sized))
    return file_of(schema_record(), channel_record(), *_messages(_payloads(rng, 20)), statistics=statistics)


def declarations_that_fill_memory(rng: Rng) -> bytes:
    size = int(rng.choice([1 << 12, 1 << 16, 1 << 20]))
    count = min(60_000, (1 << 29) // size)
    schemas = (
        record(3, struct.pack("<H", i) + text(f"s{i}") + text("") + struct.pack("<I", size) + bytes(size))
        for i in range(1, count)
    )
    whole: list[bytes] = []
    part = bytearray()
    for schema in schemas:
        part += schema
        if len(part) > 30 << 20:
            whole.append(_plain_chunk(bytes(part), "lz4"))
            part.clear()
    return file_of(*whole, _plain_chunk(bytes(part), "lz4"))


def file_of_zeros(rng: Rng) -> bytes:
    """Space that was allocated and never written."""
    return _sound(rng)[: int(rng.integers(8, 2000))] + bytes(int(rng.choice([1 << 20, 48 << 20])))


LIGHT: dict[str, Callable[[Rng], Any]] = {
    made.__name__: made
    for made in (
        sound, bits_flipped_under_checksums, bits_flipped_without_checksums, bytes_replaced, cut_at_a_record,
        cut_within_a_frame, cut_anywhere, cut_and_padded, record_length_that_lies, inner_length_that_lies,
        field_that_lies, chunk_that_claims_gigabytes, small_bomb, compression_unknown, compressed_data_damaged,
        checksum_wrong, magic_wrong, ids_duplicate_or_missing, payload_field_that_lies, payload_cut_or_grown,
        payload_of_noise, payload_bits_flipped,
        two_billion_of_something, numbers_that_are_none, times_that_are_none, texts_that_do_harm,
        metadata_that_does_harm,
        records_shuffled, records_of_noise, files_put_together, drivers_on_one_topic,
        schema_text_that_lies, records_behind_the_data, attachments_that_lie,
    )
}  # fmt: skip
HEAVY: dict[str, Callable[[Rng], Any]] = {
    made.__name__: made
    for made in (
        channels_by_the_hundred_thousand, big_bomb, many_chunks_of_the_greatest_size, records_without_content,
        messages_that_alternate, messages_that_all_differ, poses_by_the_million, motion_by_the_million,
        maps_without_end,
        declarations_that_fill_memory, file_of_zeros,
    )
}  # fmt: skip
