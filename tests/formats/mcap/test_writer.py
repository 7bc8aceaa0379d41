"""Writing joint states: the official reader and mcap-ros2-support's decoder see the bag of a ROS 2 driver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

import pipeline.formats.mcap.writer as writing
import schemas
from pipeline.errors import ArgumentError, StageError
from pipeline.formats.mcap.joint_states import read_joint_states, write_joint_states
from tests.support.joint_bags import decoded

START = 1_700_000_000_000_000_000
SCHEMA = Path(schemas.__file__).parent / "joint_state.ros2msg"
METADATA = {"demonstration": {"participant": "p01", "source": "simulated"}, "notes": {}}


def write(path: Path, count: int = 50, names: tuple[str, ...] = ("a", "bb", "ccc"), **changes: object) -> np.ndarray:
    q = np.random.default_rng(count).normal(size=(count, len(names)))
    arguments = {"time_ns": START + 10_000_000 * np.arange(count), "names": names, "positions": q}
    options = {"topic": "/driver/joint_states", "metadata": METADATA, "frame_id": "base"}
    write_joint_states(path, **(arguments | options | changes))
    return q


def test_the_official_reader_sees_a_ros_2_bag(tmp_path: Path) -> None:
    q = write(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        header, summary = reader.get_header(), reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        rows = [(message, decoded) for _, _, message, decoded in reader.iter_decoded_messages()]
    (schema,), (channel,) = summary.schemas.values(), summary.channels.values()
    assert (header.profile, header.library) == ("ros2", "lessbench")
    assert (schema.name, schema.encoding) == ("sensor_msgs/msg/JointState", "ros2msg")
    assert (channel.topic, channel.message_encoding) == ("/driver/joint_states", "cdr")
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
    assert metadata == METADATA
    times = [START + 10_000_000 * i for i in range(50)]
    assert [message.log_time for message, _ in rows] == times
    assert [message.publish_time for message, _ in rows] == times
    assert [message.sequence for message, _ in rows] == list(range(50))
    assert {(state.header.frame_id, tuple(state.name), len(state.effort)) for _, state in rows} == {
        ("base", ("a", "bb", "ccc"), 0)
    }
    np.testing.assert_array_equal([state.position for _, state in rows], q)
    # central differences over 20 ms; the sample times are exact in ns and rounded once in s
    np.testing.assert_allclose([rows[7][1].velocity], [(q[8] - q[6]) / 0.02], rtol=1e-9)


@pytest.mark.parametrize("frame_id", ["", "base", "µ"])
def test_messages_are_byte_for_byte_those_of_the_official_writer(tmp_path: Path, frame_id: str) -> None:
    """Names of all lengths modulo 8, so that every padding occurs."""
    names = (*("abcdefgh"[:length] for length in range(1, 9)), "ÄÖ")
    q = write(tmp_path / "ours.mcap", count=5, names=names, frame_id=frame_id)
    ours, times = messages(tmp_path / "ours.mcap"), [START + 10_000_000 * i for i in range(5)]
    velocities = np.gradient(q, (np.array(times) - START) / 1e9, axis=0)
    with (tmp_path / "theirs.mcap").open("wb") as stream:
        official = Writer(stream)
        schema = official.register_msgdef("sensor_msgs/msg/JointState", SCHEMA.read_text(encoding="utf-8"))
        for i, time_ns in enumerate(times):
            stamp = {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}
            message = {
                "header": {"stamp": stamp, "frame_id": frame_id}, "name": list(names), "position": q[i].tolist(),
                "velocity": velocities[i].tolist(), "effort": [],
            }  # fmt: skip
            official.write_message("/j", schema, message, log_time=time_ns)
        official.finish()
    assert ours == messages(tmp_path / "theirs.mcap")


def messages(path: Path) -> list[bytes]:
    with path.open("rb") as stream:
        return [message.data for _, _, message in make_reader(stream).iter_messages()]


joint = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(names=st.lists(joint, min_size=1, max_size=6, unique=True), frame_id=joint, data=st.data())
def test_names_times_and_positions_survive_the_round_trip(
    tmp_path: Path, names: list[str], frame_id: str, data: st.DataObject
) -> None:
    longest = 29 * 86_400 * 10**9
    start = data.draw(st.integers(1, 2**31 * 10**9 - 1 - longest))
    times = sorted(start + after for after in data.draw(st.sets(st.integers(0, longest), min_size=2, max_size=5)))
    pose = st.lists(st.floats(-1e6, 1e6), min_size=len(names), max_size=len(names))
    q = np.array(data.draw(st.lists(pose, min_size=len(times), max_size=len(times))))
    path = tmp_path / "a.mcap"
    write_joint_states(path, times, names, q, topic="/j", metadata={}, frame_id=frame_id)
    recording = read_joint_states(path)
    assert (recording.names, recording.time_ns.tolist(), recording.clock) == (tuple(names), times, "header")
    np.testing.assert_array_equal(recording.positions, q)
    stamps, official_names, positions = decoded(path)
    assert (stamps.tolist(), official_names[0]) == (times, names)
    np.testing.assert_array_equal(positions, q)


def test_many_batches_and_chunks_round_trip(tmp_path: Path) -> None:
    q = write(tmp_path / "a.mcap", count=9001)
    recording = read_joint_states(tmp_path / "a.mcap")
    assert recording.metadata == METADATA
    np.testing.assert_array_equal(recording.positions, q)


def test_log_times_may_differ_from_stamps(tmp_path: Path) -> None:
    stamps = np.array([0, 5, 9])
    write(tmp_path / "a.mcap", count=3, time_ns=stamps, log_time_ns=START + stamps)
    recording = read_joint_states(tmp_path / "a.mcap")
    assert recording.clock == "header"  # a clock that begins at zero
    assert recording.time_ns.tolist() == [0, 5, 9]
    recording = read_joint_states(tmp_path / "a.mcap", clock="log")
    assert recording.time_ns.tolist() == [START, START + 5, START + 9]


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    write(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "a.mcap")
    before = (tmp_path / "a.mcap").read_bytes()

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(writing.Writer, "finish", fail)
    with pytest.raises(StageError, match="disk full"):
        write(tmp_path / "a.mcap", count=60)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert (tmp_path / "a.mcap").read_bytes() == before


@pytest.mark.parametrize(
    "changes",
    [
        {"time_ns": [1.0, 2.0, 3.0]},
        {"time_ns": [3, 2, 4]},
        {"time_ns": [2, 2, 4]},
        {"time_ns": [-1, 2, 4]},
        {"time_ns": [1, 2, 1 << 62]},
        {"time_ns": [7], "positions": np.zeros((1, 3))},
        {"log_time_ns": [1, 2]},
        {"names": ("a", "a", "b")},
        {"names": ("a", "b\0", "c")},
        {"names": ()},
        {"positions": np.zeros((3, 2))},
        {"positions": np.full((3, 3), np.nan)},
        {"topic": ""},
        {"metadata": {"demonstration": {"attempt": 3}}},
    ],
)
def test_arguments_outside_what_is_allowed_are_named(tmp_path: Path, changes: dict) -> None:
    with pytest.raises(ArgumentError, match=next(iter(changes)).removeprefix("log_")):
        write(tmp_path / "a.mcap", count=3, **changes)
    assert not list(tmp_path.iterdir())
