"""Bags of ROS 1 and ROS 2 as rosbags writes them: the same values whichever reader is for them."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import RecordingError
from pipeline.formats.mcap.joint_states import JointRecording
from pipeline.formats.mcap.limits import Limits
from pipeline.formats.recordings.folders import bag_of, bags_of, read_folder
from pipeline.formats.recordings.readers import inspect, read_recording
from tests.support.recorded_forms import (
    NAMES,
    SECOND,
    START,
    TOPIC,
    Message,
    joint_state,
    joint_trajectory,
    motion,
    states,
    write_ros1,
    write_ros2,
)  # fmt: skip

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")


def check(recording: JointRecording, names: tuple[str, ...] = NAMES) -> None:
    times, positions = motion()
    assert recording.names == names
    assert recording.clock == "header"
    np.testing.assert_array_equal(recording.time_ns, times)
    np.testing.assert_array_equal(recording.positions, positions[:, [NAMES.index(name) for name in names]])


def rejected(path: Path, **arguments: Any) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        read_recording(bag_of(path), **arguments)
    return caught.value


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize(
    ("storage", "compression"),
    [(storage, how) for storage in ("SQLITE3", "MCAP") for how in (None, "FILE", "MESSAGE")] + [("MCAP", "STORAGE")],
)
def test_bags_of_ros_2(tmp_path: Path, storage: str, compression: str | None, version: int) -> None:
    folder = write_ros2(
        tmp_path / "tea", lambda store: states(store, 2), storage, compression, version, {"participant": "P3"}
    )
    (bag,) = read_folder(tmp_path).bags
    assert (bag.name, bag.source.startswith("tea/tea")) == ("tea", True)
    recording = read_recording(bag, joints=NAMES)
    check(recording)
    check(read_recording(bags_of(folder)[0], joints=NAMES[::-1]), NAMES[::-1])
    assert recording.metadata["demonstration"] == {"participant": "P3"}
    report = inspect(bag)
    assert report.usable
    assert [(topic.topic, topic.messages, topic.joints) for topic in report.topics] == [(TOPIC, 60, NAMES)]
    (file,) = bag.files
    assert list(recording.hashes) == [file]


def test_the_library_reads_the_same(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    folder = write_ros2(tmp_path / "tea", lambda store: states(store, 2))
    recording = read_recording(bag_of(folder))
    with AnyReader([folder]) as reader:
        messages = [reader.deserialize(data, one.msgtype) for one, _, data in reader.messages()]
    np.testing.assert_array_equal(recording.positions, [message.position for message in messages])
    stamps = [message.header.stamp.sec * SECOND + message.header.stamp.nanosec for message in messages]
    np.testing.assert_array_equal(recording.time_ns, stamps)


def test_a_file_in_sqlite_needs_no_folder(tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "tea", lambda store: states(store, 2))
    (file,) = folder.glob("*.db3")
    alone = tmp_path / "odd name?#%20.db3"
    file.rename(alone)
    check(read_recording(bag_of(alone)))


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_bags_of_ros_1(tmp_path: Path, compression: str | None) -> None:
    path = write_ros1(tmp_path / "tea.bag", lambda store: states(store, 1), compression)
    (bag,) = read_folder(tmp_path).bags
    assert bag.name == "tea"
    check(read_recording(bag, joints=NAMES))
    report = inspect(bag)
    assert (report.profile, report.usable) == ("ros1", True)
    assert [(topic.topic, topic.encoding, topic.messages) for topic in report.topics] == [(TOPIC, "ros1", 60)]
    assert path in read_recording(bag).hashes


def test_ros_1_in_mcap_as_its_library_writes_it(tmp_path: Path) -> None:
    from mcap_ros1.writer import Writer as Ros1Writer

    class Stamp:
        def __init__(self, time_ns: int) -> None:
            self.secs, self.nsecs = divmod(time_ns, SECOND)

    class JointState:
        """As genpy makes it."""

        _type = "sensor_msgs/JointState"
        _full_text = (
            "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
            + "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
        )  # fmt: skip

        def __init__(self, data: bytes) -> None:
            self._data = data

        def serialize(self, stream: Any) -> None:
            stream.write(self._data)

    def bytes_of(time_ns: int, row: np.ndarray) -> bytes:
        def text(value: str) -> bytes:
            return struct.pack("<I", len(value)) + value.encode()

        numbers = struct.pack("<I", len(row)) + np.asarray(row, "<f8").tobytes()
        head = struct.pack("<III", 5, time_ns // SECOND, time_ns % SECOND) + text("base")
        return head + struct.pack("<I", 3) + b"".join(map(text, NAMES)) + numbers + struct.pack("<II", 0, 0)

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Ros1Writer(stream)
        for time, row in zip(*motion(), strict=True):
            writer.write_message(TOPIC, JointState(bytes_of(int(time), row)), int(time) + 5)
        writer.finish()
    check(read_recording(bag_of(path)))


def trajectories(store: Any, ros: int, stamped: bool = True) -> list[Message]:
    """The motion in two plans, of which the second replaces the end of the first, which would go elsewhere."""
    times, positions = motion()
    wrong = np.concatenate([positions[:30], positions[30:45] + 1])
    kind = "trajectory_msgs/msg/JointTrajectory"
    found = []
    for start, rows in ((0, wrong), (30, positions[30:])):
        after = times[start : start + len(rows)] - times[start]
        stamp = int(times[start]) if stamped else 0
        found.append(("/plan", int(times[start]), kind, joint_trajectory(store, ros, stamp, NAMES, after, rows)))
    return found


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("form", ["sqlite", "mcap", "ros1"])
def test_planned_motions_are_read_and_said(tmp_path: Path, form: str, stamped: bool) -> None:
    if form == "ros1":
        path = write_ros1(tmp_path / "a.bag", lambda store: trajectories(store, 1, stamped))
    else:
        storage = {"sqlite": "SQLITE3", "mcap": "MCAP"}[form]
        path = write_ros2(tmp_path / "a", lambda store: trajectories(store, 2, stamped), storage)
    recording = read_recording(bag_of(path), joints=NAMES)
    check(recording)
    assert "/plan says where the arm was to be (JointTrajectory), and not where it was" in recording.remarks


def test_measured_states_are_read_and_not_the_plan_unless_it_is_named(tmp_path: Path) -> None:
    def both(store: Any) -> list[Message]:
        times, positions = motion()
        kind = "trajectory_msgs/msg/JointTrajectory"
        plan = joint_trajectory(store, 2, int(times[0]), NAMES, times - times[0], positions + 0.5)
        return [("/plan", int(times[0]), kind, plan), *states(store, 2)]

    bag = bag_of(write_ros2(tmp_path / "a", both))
    check(read_recording(bag, joints=NAMES))
    assert read_recording(bag, topic="/plan").positions[0, 0] == motion()[1][0, 0] + 0.5


def test_a_plan_of_other_fields_is_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        text = b"string[] joint_names\n"
        schema = writer.register_schema("trajectory_msgs/msg/JointTrajectory", "ros2msg", text)
        writer.add_message(writer.register_channel("/plan", "cdr", schema), 1, b"\0\1\0\0", 1)
        writer.finish()
    error = rejected(path)
    assert (error.reason, "of other fields" in error.detail) == ("unsupported-encoding", True)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP", "ros1"])
def test_joints_in_messages_of_their_own_are_put_together(tmp_path: Path, storage: str) -> None:
    ros = 1 if storage == "ros1" else 2

    def split(store: Any) -> list[Message]:
        found = []
        for time, row in zip(*motion(), strict=True):
            for part in ([0, 2], [1]):
                names = [NAMES[joint] for joint in part]
                message = joint_state(store, ros, time, names, row[part])
                found.append((TOPIC, int(time) + len(part), "sensor_msgs/msg/JointState", message))
        return found

    path = write_ros1(tmp_path / "a.bag", split) if ros == 1 else write_ros2(tmp_path / "a", split, storage)
    recording = read_recording(bag_of(path), joints=NAMES)
    check(recording)
    assert "poses are put together by name" in recording.remarks[0]


def test_other_topics_are_listed_and_not_decoded(tmp_path: Path) -> None:
    def with_text(store: Any) -> list[Message]:
        kind = "std_msgs/msg/String"
        text = store.types[kind](data="x" * 1000)
        return [*states(store, 1), *(("/talk", START + i, kind, text) for i in range(5))]

    report = inspect(bag_of(write_ros1(tmp_path / "a.bag", with_text, "LZ4")))
    assert report.usable
    assert {topic.topic: (topic.messages, topic.joints) for topic in report.topics} == {
        TOPIC: (60, NAMES), "/talk": (5, ())
    }  # fmt: skip


# what is damaged or hostile


@pytest.fixture
def database(tmp_path: Path) -> Path:
    folder = write_ros2(tmp_path / "tea", lambda store: states(store, 2))
    (file,) = folder.glob("*.db3")
    return file.rename(tmp_path / "tea.db3")


@pytest.mark.parametrize(
    ("sql", "said"),
    [
        ("alter table messages rename to m; create view messages as select * from m", "has a view 'messages'"),
        ("create trigger t after insert on messages begin select 1; end", "has a trigger 't'"),
        ("create virtual table v using fts5(a)", "has a table 'v'"),
        ("alter table topics add column c generated always as (abs(id)) virtual", "a column that is computed"),
        ("drop table messages", "no table 'messages'"),
        ("delete from topics", "undeclared topic"),
        ("update messages set data = 'text'", "has no time, or no content"),
        ("update messages set timestamp = -1", "has no time, or no content"),
        ("update topics set name = x'00'", "no topic"),
        ("update messages set data = x'00010000'", "shorter than it states"),
    ],
)
def test_a_database_that_is_no_bag_is_refused_before_its_sql_runs(database: Path, sql: str, said: str) -> None:
    with sqlite3.connect(database) as connection:
        connection.executescript(sql)
    connection.close()
    before = database.read_bytes()
    error = rejected(database)
    assert error.reason == "corrupt"
    assert said in error.detail
    assert database.read_bytes() == before


def test_a_database_is_not_written_to_nor_anything_beside_it(database: Path) -> None:
    database.chmod(0o444)
    check(read_recording(bag_of(database)))
    assert sorted(path.name for path in database.parent.glob("*.db3*")) == ["tea.db3"]


def test_what_a_compressed_file_or_message_may_inflate_to_is_bounded(tmp_path: Path) -> None:
    import zstandard

    bomb = tmp_path / "a.db3.zstd"
    bomb.write_bytes(zstandard.ZstdCompressor().compress(bytes(64 << 20)))
    error = rejected(bomb, limits=Limits(stored_bytes=1 << 20))
    assert (error.reason, "inflates to more than" in error.detail) == ("too-large", True)
    folder = write_ros2(tmp_path / "tea", lambda store: states(store, 2), compression="MESSAGE")
    (file,) = folder.glob("*.db3")
    with sqlite3.connect(file) as connection:
        connection.execute("update messages set data = ?", (zstandard.ZstdCompressor().compress(bytes(64 << 20)),))
    connection.close()
    error = rejected(folder)
    assert (error.reason, "compressed message states" in error.detail) == ("too-large", True)


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_a_damaged_bag_of_ros_1_is_one_sentence(tmp_path: Path, compression: str | None) -> None:
    content = write_ros1(tmp_path / "a.bag", lambda store: states(store, 1), compression).read_bytes()
    rng = np.random.default_rng(1)
    path = tmp_path / "b.bag"
    outcomes = set()
    for _ in range(150):
        data = bytearray(content)
        if rng.random() < 0.3:
            del data[rng.integers(20, len(data)) :]
        for at in rng.integers(13, len(data), 3):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        try:
            read_recording(bag_of(path), joints=NAMES)
            outcomes.add("read")
        except RecordingError as error:
            outcomes.add(error.reason)
    assert "corrupt" in outcomes


def test_a_chunk_of_ros_1_that_inflates_without_end_is_refused(tmp_path: Path) -> None:
    def much(store: Any) -> list[Message]:
        kind = "std_msgs/msg/String"
        return [*states(store, 1), ("/talk", START + SECOND, kind, store.types[kind](data="x" * (4 << 20)))]

    path = write_ros1(tmp_path / "a.bag", much, "BZ2")
    assert path.stat().st_size < 1 << 16
    error = rejected(path, limits=Limits(chunk_bytes=1 << 20))
    assert (error.reason, "inflates to more than" in error.detail) == ("too-large", True)


def test_a_bag_whose_index_points_to_one_chunk_again_and_again_is_refused(tmp_path: Path) -> None:
    content = write_ros1(tmp_path / "a.bag", lambda store: states(store, 1)).read_bytes()
    count = content.index(b"chunk_count=") + len(b"chunk_count=")
    # the index ends with one record for the chunk; as many copies as the header then states
    start = _last_record(content)
    copies = 2000
    hostile = content[:count] + struct.pack("<I", copies) + content[count + 4 :] + content[start:] * (copies - 1)
    path = tmp_path / "b.bag"
    path.write_bytes(hostile)
    error = rejected(path)
    assert (error.reason, "again and again" in error.detail) == ("too-large", True)


def _last_record(content: bytes) -> int:
    """Where the last record of a bag begins."""
    at = len(b"#ROSBAG V2.0\n")
    while True:
        start = at
        for _ in range(2):
            at += 4 + struct.unpack_from("<I", content, at)[0]
        if at >= len(content):
            return start


def test_without_rosbags_a_sentence_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_ros1(tmp_path / "a.bag", lambda store: states(store, 1))
    plan = write_ros2(tmp_path / "plan", lambda store: trajectories(store, 2), "MCAP")
    plain = write_ros2(tmp_path / "plain", lambda store: states(store, 2))

    def absent(name: str) -> Any:
        raise ModuleNotFoundError(name)

    from pipeline.formats.recordings import trajectories as planned

    planned._types.cache_clear()
    monkeypatch.setattr("pipeline.formats.recordings.extras.import_module", absent)
    for one in (path, plan):
        error = rejected(one)
        assert error.reason == "not-read"
        assert "`pip install 'lessbench[ros]'`" in error.detail
    check(read_recording(bag_of(plain)))


def test_what_an_index_of_ros_1_lists_is_bounded(tmp_path: Path) -> None:
    path = write_ros1(tmp_path / "a.bag", lambda store: states(store, 1))
    error = rejected(path, limits=Limits(joint_states=10))
    assert (error.reason, "at most 120 are read" in error.detail) == ("too-large", True)
    error = rejected(path, limits=Limits(record_bytes=1000))
    assert error.reason == "too-large"


def test_a_database_that_takes_too_long_is_left(database: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.formats.recordings.sqlite_bag._LOOKS", 0)
    monkeypatch.setattr("pipeline.formats.recordings.sqlite_bag._INSTRUCTIONS", 10)
    error = rejected(database)
    assert (error.reason, "takes too long" in error.detail) == ("too-large", True)


def test_a_damaged_database_is_one_sentence(database: Path) -> None:
    content, rng, reasons = database.read_bytes(), np.random.default_rng(2), set()
    for _ in range(150):
        data = bytearray(content)
        for at in rng.integers(0, 5000, 5):
            data[at] = rng.integers(256)
        database.write_bytes(data)
        try:
            read_recording(bag_of(database), joints=NAMES)
        except RecordingError as error:
            reasons.add(error.reason)
    assert "corrupt" in reasons
