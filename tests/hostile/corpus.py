"""Malformed MCAP files with what a reader should make of them, for this reader and for others.

    python -m tests.hostile.corpus OUT        # writes the files, expected.json and README.md

Each file is small, is the same in every run, and breaks one rule of the MCAP specification (version 0). All hold, or
would hold, the same four messages on the topic /joint_states, logged at 1, 2, 3 and 4 s. For each `expected.json` says

- `rule`: what the specification asks for, in words;
- `strict`: `accept` or `reject`, for a reader that validates all that it reads;
- `messages`: what a lenient reader may return from it, as numbers of messages; null where nothing can be known;
- `here`: how this project's reader ends, a reason of `pipeline/formats/mcap/rejection_reasons.py` or `accept`.
"""

from __future__ import annotations

import argparse
import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import lz4.frame
import zstandard

from tests.support.joint_bags import (
    MAGIC,
    SCHEMA,
    channel_record,
    chunk_record,
    message_record,
    payload,
    record,
    schema_record,
    text,
)

SECOND = 10**9
HEADER = record(1, text("ros2") + text("corpus"))
NOTHING_COMPUTED = 0


@dataclass(frozen=True)
class Malformed:
    """One file and what is expected of it."""

    name: str
    rule: str
    strict: str
    here: str
    content: bytes = field(repr=False)
    messages: list[int] | None = None


def message(number: int, channel_id: int = 1) -> bytes:
    """One of the four messages, from 1."""
    data = payload(["a", "b"], [0.1 * number, -0.1 * number], number * SECOND, velocity=[0.1, -0.1])
    return message_record(data, number * SECOND, channel_id)


DECLARED = schema_record() + channel_record()
MESSAGES = b"".join(message(number) for number in range(1, 5))


def end_of_data(data: bytes = b"") -> bytes:
    """With the checksum of `data`, or without one."""
    return record(15, struct.pack("<I", zlib.crc32(data) if data else NOTHING_COMPUTED))


def footer(summary: bytes = b"", start: int = 0) -> bytes:
    """Without a checksum."""
    return record(2, struct.pack("<QQI", start, 0, NOTHING_COMPUTED))


def whole(*parts: bytes, end: bytes | None = None, summary: bytes = b"", head: bytes = HEADER) -> bytes:
    """A file of parts of its data section."""
    return MAGIC + head + b"".join(parts) + (end_of_data() if end is None else end) + summary + footer() + MAGIC


def chunk(data: bytes, compression: str = "", crc: int | None = None, size: int | None = None) -> bytes:
    """A chunk with its checksum, unless another is given."""
    stored = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.ZstdCompressor().compress}.get(
        compression, bytes
    )(data)
    return chunk_record(
        stored, len(data) if size is None else size, compression, zlib.crc32(data) if crc is None else crc
    )


def attachment(data: bytes, crc: int) -> bytes:
    """With the checksum that is given."""
    body = bytes(16) + text("a.bin") + text("application/octet-stream") + struct.pack("<Q", len(data)) + data
    return record(9, body + struct.pack("<I", crc))


def statistics(messages: int) -> bytes:
    """That states so many messages, on one channel with a schema."""
    counts = struct.pack("<QHIIIIQQ", messages, 1, 1, 0, 0, 0, SECOND, 4 * SECOND)
    return record(11, counts + struct.pack("<I", 10) + struct.pack("<HQ", 1, messages))


def flipped(content: bytes, at: int) -> bytes:
    """With the lowest bit of one byte turned."""
    return content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]


def corpus() -> Iterator[Malformed]:
    """All files, in order of their names within each rule."""
    sound = whole(DECLARED, MESSAGES)
    chunked = whole(DECLARED, chunk(MESSAGES))
    data = MAGIC + HEADER + DECLARED + MESSAGES
    at_message = len(MAGIC + HEADER + DECLARED)
    reject, accept = "reject", "accept"

    def case(
        name: str, rule: str, content: bytes, strict: str, here: str, messages: list[int] | None = None
    ) -> Malformed:
        return Malformed(name, rule, strict, here, content, messages)

    yield case("sound", "nothing is wrong with this one", sound, accept, accept, [4])
    yield case("sound-chunked", "nothing is wrong with this one", chunked, accept, accept, [4])
    for kind in ("lz4", "zstd"):
        yield case(
            f"sound-{kind}",
            "nothing is wrong with this one",
            whole(DECLARED, chunk(MESSAGES, kind)),
            accept,
            accept,
            [4],
        )
    yield case(
        "sound-unknown-record", "records of types from 0x80 on are private and are to be skipped",
        whole(DECLARED, record(0x80, b"private"), MESSAGES), accept, accept, [4],
    )  # fmt: skip
    yield case("empty", "a file starts with the magic", b"", reject, "not-mcap", [0])
    yield case("magic-at-start-missing", "a file starts with the magic", sound[len(MAGIC) :], reject, "not-mcap")
    yield case(
        "magic-of-a-later-version", "the magic names version 0", sound.replace(b"MCAP0", b"MCAP1"), reject, "not-mcap"
    )
    yield case("magic-at-end-missing", "a file ends with the magic", sound[: -len(MAGIC)], reject, "truncated", [4])
    yield case("bytes-behind-the-end", "nothing follows the closing magic", sound + b"more", reject, "truncated", [4])
    yield case(
        "header-missing", "the header is the first record", whole(DECLARED, MESSAGES, head=b""), reject, "corrupt", [4]
    )
    yield case("header-twice", "there is one header", whole(HEADER, DECLARED, MESSAGES), reject, "corrupt", [4])
    yield case("two-files-joined", "a file has one beginning and one end", sound + sound, reject, "truncated", [4, 8])
    yield case(
        "cut-within-a-message", "every record is as long as it says", sound[: at_message + 60], reject, "truncated", [0]
    )
    yield case(
        "cut-behind-two-messages",
        "a file ends with footer and magic",
        sound[: at_message + len(MESSAGES) // 2],
        reject,
        "truncated",
        [2],
    )
    yield case(
        "cut-within-a-frame", "every record has nine bytes of frame", sound[: at_message + 4], reject, "truncated", [0]
    )
    yield case("zeros-behind-the-data", "the opcode 0 is no record", data + bytes(64), reject, "truncated", [4])
    yield case(
        "end-of-data-missing",
        "the data section is closed by a DataEnd record",
        whole(DECLARED, MESSAGES, end=b""),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "end-of-data-twice",
        "the data section is closed once",
        whole(DECLARED, MESSAGES, end=end_of_data() * 2),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "message-behind-the-data", "messages stand in the data section",
        whole(DECLARED, MESSAGES, summary=message(4)), reject, "corrupt", [4, 5],
    )  # fmt: skip
    yield case(
        "chunk-behind-the-data", "chunks stand in the data section",
        whole(DECLARED, MESSAGES, summary=chunk(message(4))), reject, "corrupt", [4, 5],
    )  # fmt: skip
    yield case(
        "data-checksum-wrong",
        "the DataEnd record has the CRC of the data section",
        flipped(whole(DECLARED, MESSAGES, end=end_of_data(data)), at_message + 50),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "chunk-checksum-wrong",
        "a chunk has the CRC of its records",
        whole(DECLARED, chunk(MESSAGES, crc=1)),
        reject,
        "corrupt",
        [0, 4],
    )
    yield case(
        "chunk-checksum-absent",
        "the CRC 0 says that none was computed",
        whole(DECLARED, chunk(MESSAGES, crc=0)),
        accept,
        accept,
        [4],
    )
    summary = schema_record() + channel_record()
    at_summary = len(whole(DECLARED, MESSAGES)) - len(footer()) - len(MAGIC)
    bad_footer = record(2, struct.pack("<QQI", at_summary, 0, 1))
    yield case(
        "summary-checksum-wrong",
        "the footer has the CRC of the summary",
        MAGIC + HEADER + DECLARED + MESSAGES + end_of_data() + summary + bad_footer + MAGIC,
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "attachment-checksum-wrong",
        "an attachment has the CRC of its fields",
        whole(DECLARED, attachment(b"x" * 9, 1), MESSAGES),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "attachment-shorter-than-its-fields",
        "the fields of an attachment fill it",
        whole(DECLARED, record(9, bytes(20)), MESSAGES),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "record-length-beyond-the-file",
        "every record is as long as it says",
        whole(DECLARED, struct.pack("<BQ", 5, 1 << 62), MESSAGES),
        reject,
        "truncated",
        [0],
    )
    yield case(
        "record-length-within-a-chunk",
        "records in a chunk end where it ends",
        whole(DECLARED, chunk(MESSAGES + struct.pack("<BQ", 5, 1 << 40))),
        reject,
        "corrupt",
        [0, 4],
    )
    yield case(
        "message-shorter-than-its-head",
        "a message has at least 22 bytes",
        whole(DECLARED, record(5, bytes(21)), MESSAGES),
        reject,
        "corrupt",
        [0, 4],
    )
    yield case(
        "channel-undeclared",
        "a message follows the declaration of its channel",
        whole(schema_record(), MESSAGES),
        reject,
        "corrupt",
        [0],
    )
    yield case(
        "channel-declared-later",
        "a message follows the declaration of its channel",
        whole(schema_record(), MESSAGES, channel_record()),
        reject,
        "corrupt",
        [0],
    )
    yield case(
        "schema-undeclared",
        "a channel follows the declaration of its schema",
        whole(channel_record(), MESSAGES),
        reject,
        "corrupt",
        [0, 4],
    )
    yield case(
        "channel-declared-differently",
        "a channel id means one channel",
        whole(DECLARED, channel_record(topic="/other"), MESSAGES),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "schema-declared-differently",
        "a schema id means one schema",
        whole(DECLARED, schema_record(name="other/msg/Thing"), MESSAGES),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "schema-with-id-zero",
        "the schema id 0 means that there is none",
        whole(schema_record(0), channel_record(1, 0), MESSAGES),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "statistics-state-more-messages",
        "statistics state what is there",
        whole(DECLARED, MESSAGES, summary=statistics(5)),
        reject,
        "corrupt",
        [4],
    )
    yield case(
        "chunk-compression-unknown",
        "the compression is lz4, zstd or none",
        whole(DECLARED, chunk(MESSAGES, "brotli")),
        reject,
        "unsupported-compression",
        [0],
    )
    yield case(
        "chunk-states-less",
        "a chunk inflates to the size it states",
        whole(DECLARED, chunk(MESSAGES, "zstd", size=len(MESSAGES) - 9)),
        reject,
        "corrupt",
        [0, 4],
    )
    yield case(
        "chunk-states-more",
        "a chunk inflates to the size it states",
        whole(DECLARED, chunk(MESSAGES, "lz4", size=len(MESSAGES) + 9)),
        reject,
        "corrupt",
        [0, 4],
    )
    yield case(
        "chunk-states-gigabytes",
        "a chunk inflates to the size it states",
        whole(DECLARED, chunk(MESSAGES, "zstd", size=1 << 40)),
        reject,
        "too-large",
        [0, 4],
    )
    yield case(
        "chunk-of-zeros-without-end",
        "nothing forbids it; a reader should bound what it inflates",
        whole(DECLARED, chunk(bytes(1 << 26), "zstd")),
        reject,
        "too-large",
        [0],
    )
    yield case(
        "chunk-within-a-chunk",
        "a chunk holds schemas, channels and messages",
        whole(DECLARED, chunk(chunk(MESSAGES))),
        reject,
        "too-few-messages",
        [0],
    )
    yield case(
        "text-that-is-none",
        "texts are UTF-8",
        whole(
            schema_record(),
            record(
                4, struct.pack("<HH", 1, 1) + struct.pack("<I", 2) + b"\xff\xfe" + text("cdr") + struct.pack("<I", 0)
            ),
            MESSAGES,
        ),
        reject,
        "corrupt",
        [0, 4],
    )
    yield case(
        "text-beyond-its-record",
        "a text ends within its record",
        whole(schema_record(), record(4, struct.pack("<HHI", 1, 1, 1 << 31)), MESSAGES),
        reject,
        "corrupt",
        [0],
    )
    yield case(
        "schema-text-of-other-fields",
        "not a rule of MCAP: the schema's text, and not its name, says how messages are laid out",
        whole(swapped_schema(), channel_record(), MESSAGES),
        accept,
        accept,
        [4],
    )
    yield case(
        "schema-in-another-language",
        "not a rule of MCAP: messages in CDR need a schema of ROS 2",
        whole(schema_of("protobuf", b"\n\x05a.bin"), channel_record(), MESSAGES),
        accept,
        "unsupported-encoding",
        [4],
    )


def swapped_schema() -> bytes:
    """Velocity before position."""
    return schema_of(
        "ros2msg", SCHEMA.replace(b"float64[] position\nfloat64[] velocity", b"float64[] velocity\nfloat64[] position")
    )


def schema_of(language: str, data: bytes) -> bytes:
    """A schema called JointState."""
    named = struct.pack("<H", 1) + text("sensor_msgs/msg/JointState") + text(language)
    return record(3, named + struct.pack("<I", len(data)) + data)


def write(out: Path) -> int:
    """Write everything into a folder; how many files."""
    out.mkdir(parents=True, exist_ok=True)
    expected = {}
    for one in corpus():
        (out / f"{one.name}.mcap").write_bytes(one.content)
        expected[f"{one.name}.mcap"] = {
            key: value for key, value in asdict(one).items() if key not in ("content", "name")
        }
    (out / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")
    (out / "README.md").write_text("# Malformed MCAP files\n\n" + (__doc__ or "").replace("    python", "    # python"))
    return len(expected)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.corpus", description="Malformed MCAP files.")
    parser.add_argument("out", type=Path, help="folder to write into")
    print(write(parser.parse_args().out), "files")


if __name__ == "__main__":
    main()
