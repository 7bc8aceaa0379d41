"""Bags of ROS 2 in SQLite (.db3), with the standard library's sqlite3.

rosbags reads them as well, but counts and joins whole tables before anything of it can be bounded, so it serves as the
tests' second opinion. The file is opened read-only and as one that does not change, so that neither it nor a journal
beside it is touched. A file whose schema has more than plain tables and indices (views, triggers, virtual tables,
computed columns) is refused before any of its tables is read, as these are SQL of somebody else that would be run.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from mcap.records import Channel, Schema

from pipeline.formats.mcap.channels import ChannelContents, Contents
from pipeline.formats.mcap.limits import Limits, Meter
from pipeline.formats.mcap.rejection_reasons import rejection

_TABLES = ("messages", "topics")
_LARGEST_SCHEMA = 1 << 20
_MOST_ENTRIES = 1000  # of the schema, and topics
_BATCH = 256  # messages
_INSTRUCTIONS, _LOOKS = 1_000_000, 1_000  # how much SQLite may do between two looks, and how many looks
_ROS = {"ros2msg": "ros2msg", "ros2idl": "ros2idl"}
REMEDY = "keep only the joint states with `ros2 bag convert`"


def fill_from_sqlite(contents: Contents, path: Path, limits: Limits) -> None:
    """Read all channels of a file, and the messages of those that have poses.

    Raises:
        RecordingError: corrupt, too-large or unsupported-encoding.
    """
    meter = Meter(limits, REMEDY)
    contents.profile, contents.library = "ros2", "sqlite3"
    with _opened(path, limits) as database:
        _require_plain(database)
        channels = dict(_channels(database, contents, meter))
        order = "order by timestamp, id" if _columns(database, "messages") >= {"id"} else "order by timestamp"
        wanted = [number for number, channel in channels.items() if channel.layout or channel.decoding]
        for number, count, first, last in database.execute(
            "select topic_id, count(*), min(timestamp), max(timestamp) from messages group by topic_id"
        ):
            _count(number, (count, first, last), channels, wanted)
        places = ", ".join("?" * len(wanted))
        rows = database.execute(
            f"select topic_id, timestamp, data from messages where topic_id in ({places}) {order}", wanted
        )
        while batch := rows.fetchmany(_BATCH):
            _take(batch, channels, contents, meter)


@contextmanager
def _opened(path: Path, limits: Limits) -> Iterator[sqlite3.Connection]:
    looks = 0

    def look() -> int:
        nonlocal looks
        looks += 1
        return looks > _LOOKS

    try:
        with closing(sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1", uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limits.record_bytes)
            database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
            database.set_progress_handler(look, _INSTRUCTIONS)
            database.text_factory = _text
            for setting in ("trusted_schema = off", "cell_size_check = on", "mmap_size = 0", "temp_store = file"):
                database.execute(f"pragma {setting}")
            yield database
    except sqlite3.OperationalError as error:
        if looks > _LOOKS:
            raise rejection("too-large", f"{path.name} takes too long to read; it is damaged, or {REMEDY}.") from error
        raise rejection("corrupt", f"{path.name} cannot be read as a bag in SQLite ({_said(error)}).") from error
    except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
        raise rejection("corrupt", f"{path.name} cannot be read as a bag in SQLite ({_said(error)}).") from error


def _require_plain(database: sqlite3.Connection) -> None:
    """Refuse SQL of the file that reading its tables would run.

    Raises:
        RecordingError: corrupt.
    """
    entries = database.execute("select type, name, sql from sqlite_master").fetchmany(_MOST_ENTRIES + 1)
    for kind, name, sql in entries:
        words = str(sql or "").lower().split()
        if len(entries) > _MOST_ENTRIES or kind not in ("table", "index") or words[:2] == ["create", "virtual"]:
            raise rejection("corrupt", f"The database has a {kind} {name!r} that no bag has, which is not run.")
    tables = {name for kind, name, _ in entries if kind == "table"}
    if missing := [table for table in _TABLES if table not in tables]:
        raise rejection("corrupt", f"The database has no table {missing[0]!r}, so it is no bag of ROS 2.")
    for table in tables:
        if any(hidden for *_, hidden in database.execute("select * from pragma_table_xinfo(?)", (table,))):
            raise rejection("corrupt", f"The table {table!r} has a column that is computed, which is not run.")


def _channels(database: sqlite3.Connection, contents: Contents, meter: Meter) -> Iterator[tuple[int, ChannelContents]]:
    definitions = {}
    if _columns(database, "message_definitions") >= {"topic_type", "encoding", "encoded_message_definition"}:
        found = database.execute("select topic_type, encoding, encoded_message_definition from message_definitions")
        definitions = {str(name): (str(kind), str(text)) for name, kind, text in found.fetchmany(_MOST_ENTRIES)}
    topics = database.execute("select id, name, type, serialization_format from topics").fetchmany(_MOST_ENTRIES + 1)
    if len(topics) > _MOST_ENTRIES:
        raise rejection("too-large", f"The bag has more than {_MOST_ENTRIES} topics; {REMEDY}.")
    for number, name, kind, encoding in topics:
        if not all(isinstance(one, str) for one in (name, kind, encoding)) or not isinstance(number, int):
            raise rejection("corrupt", "The table 'topics' has a row that is no topic.")
        form, text = definitions.get(kind, ("ros2msg", ""))
        data = text.encode()
        if len(data) > _LARGEST_SCHEMA:
            raise rejection("too-large", f"The definition of {kind} has {len(data)} bytes; at most {_LARGEST_SCHEMA}.")
        schema = Schema(id=number, name=kind, encoding=_ROS.get(form, "ros2msg"), data=data)
        channel = Channel(id=number, topic=name, message_encoding=encoding, metadata={}, schema_id=number)
        yield number, contents.add_channel(channel, schema, meter)


def _count(
    number: Any, found: tuple[Any, Any, Any], channels: dict[int, ChannelContents], wanted: Sequence[int]
) -> None:
    """Take note of how many messages a topic has that is not read, and refuse those of no topic."""
    channel = channels.get(number)
    if channel is None:
        raise rejection("corrupt", f"A message belongs to the undeclared topic {number!r}.")
    if number not in wanted:
        if not all(type(value) is int and value >= 0 for value in found):
            raise rejection("corrupt", f"A message on {channel.topic} has no time, or no content.")
        channel.messages, channel.first_log_ns, channel.last_log_ns = found


def _take(
    rows: list[tuple[Any, Any, Any]], channels: dict[int, ChannelContents], contents: Contents, meter: Meter
) -> None:
    """Hand messages on, those of one channel that follow each other together."""
    start = 0
    for end in range(1, len(rows) + 1):
        if end < len(rows) and rows[end][0] == rows[start][0]:
            continue
        run, channel = rows[start:end], channels[rows[start][0]]
        start = end
        if not all(type(time) is int and time >= 0 and isinstance(data, bytes) for _, time, data in run):
            raise rejection("corrupt", f"A message on {channel.topic} has no time, or no content.")
        meter.inflate(sum(len(data) for *_, data in run))
        contents.add_messages(channel, [data for *_, data in run], np.array([time for _, time, _ in run]), meter)


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {name for _, name, *_ in database.execute("select * from pragma_table_xinfo(?)", (table,))}


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _said(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
