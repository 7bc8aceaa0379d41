"""Reading joint states: values, topics, joints, clocks; the oracle is mcap-ros2-support's decoder."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from pipeline.errors import ArgumentError, RecordingError
from pipeline.formats.mcap.joint_states import inspect_recording, read_joint_states
from tests.support.joint_bags import decoded, payload, write_bag

REAL = Path(__file__).resolve().parents[3] / "../shared/real/jaco/recordings"
ARM = [f"j2s7s300_joint_{i}" for i in range(1, 8)]
TOPIC = "/joint_states"
SECOND = 10**9
START = 1_700_000_000 * SECOND

real_data = pytest.mark.skipif(not REAL.is_dir(), reason="the shared real recordings are not beside the repository")


def poses(count: int, joints: int = 3) -> np.ndarray:
    return np.random.default_rng(7).normal(size=(count, joints))


def states(q: np.ndarray, names: list[str], topic: str = TOPIC, stamped: bool = True, **fields: object) -> list:
    """Messages at 100 Hz."""
    times = [START + i * SECOND // 100 for i in range(len(q))]
    return [(topic, t, payload(names, row, t if stamped else 0, **fields)) for t, row in zip(times, q, strict=True)]


def rejected(path: Path, **arguments: object) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        read_joint_states(path, **arguments)
    report = inspect_recording(path, **arguments)
    assert (report.usable, report.reason, report.detail) == (False, caught.value.reason, str(caught.value))
    return caught.value


@real_data
def test_real_recordings_are_read_as_the_official_decoder_reads_them() -> None:
    files = sorted(REAL.glob("*.mcap"))
    assert len(files) == 21
    for path in files:
        stamps, names, positions = decoded(path)
        recording = read_joint_states(path)
        assert all(list(recording.names) == each for each in names)
        assert recording.clock == "header"
        np.testing.assert_array_equal(recording.time_ns, stamps)
        np.testing.assert_array_equal(recording.positions, positions)
        arm = read_joint_states(path, joints=ARM[::-1])
        assert arm.names == tuple(ARM[::-1])
        np.testing.assert_array_equal(arm.positions, positions[:, 6::-1])


@real_data
def test_a_real_recording_is_reported_with_its_topic_rate_and_metadata() -> None:
    report = inspect_recording(REAL / "tablelaptop_case1_00.mcap", joints=ARM)
    (topic,) = report.topics
    assert report.usable
    assert (report.profile, report.metadata["demonstration"]["participant"]) == ("ros2", "expert00")
    assert (topic.topic, topic.schema, topic.encoding) == (
        "/j2s7s300_driver/out/joint_state",
        "sensor_msgs/msg/JointState",
        "cdr",
    )
    assert (topic.messages, topic.duration_s, len(topic.joints)) == (28, 2.7, 10)
    assert topic.rate_hz == pytest.approx(10.0)
    assert report.recording is not None
    assert report.recording.positions.shape == (28, 7)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("frame_id", ["", "base", "root7"])
@pytest.mark.parametrize("filled", [(), (1.0, 2.0, 3.0)])
def test_every_alignment_and_byte_order_is_read(tmp_path: Path, order: str, frame_id: str, filled: tuple) -> None:
    q = poses(5)
    fields = {"order": order, "frame_id": frame_id, "velocity": filled, "effort": filled[:2]}
    path = write_bag(tmp_path / "a.mcap", states(q, ["a", "bc", "def"], **fields))
    recording = read_joint_states(path)
    np.testing.assert_array_equal(recording.positions, q)
    np.testing.assert_array_equal(recording.positions, decoded(path)[2])
    np.testing.assert_array_equal(np.diff(recording.time_ns), 10_000_000)


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("options", [{}, {"chunk_size": 700}, {"use_chunking": False}, {"enable_data_crcs": True}])
@pytest.mark.parametrize("schema", ["sensor_msgs/msg/JointState", "sensor_msgs/JointState"])
def test_every_container_layout_is_read(
    tmp_path: Path, compression: CompressionType, options: dict, schema: str
) -> None:
    q = poses(40)
    path = write_bag(tmp_path / "a.mcap", states(q, ["a", "b", "c"]), schema, compression=compression, **options)
    np.testing.assert_array_equal(read_joint_states(path).positions, q)


message = st.tuples(
    st.sampled_from(["/joint_states", "/other/camera"]),
    st.permutations(["a", "b", "c"]),
    st.sampled_from(["<", ">"]),
    st.sampled_from(["", "base", "a longer frame"]),
    st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
    st.lists(st.floats(), max_size=3),
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(drawn=st.lists(message, min_size=2, max_size=60), chunk_size=st.integers(100, 3000))
def test_any_mixture_of_layouts_and_channels_gives_what_was_written(
    tmp_path: Path, drawn: list, chunk_size: int
) -> None:
    messages, expected = [], []
    for i, (topic, names, order, frame_id, q, velocity) in enumerate(drawn):
        stamp = START + i
        messages.append((topic, stamp, payload(names, q, stamp, velocity, frame_id=frame_id, order=order)))
        if topic == TOPIC:
            expected.append((stamp, [q[list(names).index(name)] for name in "abc"]))
    path = write_bag(tmp_path / "a.mcap", messages, chunk_size=chunk_size)
    if len(expected) < 2:
        assert rejected(path, joints=["a", "b", "c"]).reason in ("too-few-messages", "no-joint-states")
        return
    recording = read_joint_states(path, joints=["a", "b", "c"])
    assert [(int(t), list(q)) for t, q in zip(recording.time_ns, recording.positions, strict=True)] == expected


def test_more_layouts_than_are_searched_for_are_read_one_by_one(tmp_path: Path) -> None:
    q = poses(50)
    messages = [
        (TOPIC, START + i, payload(["a", "b", "c"], row, START + i, frame_id=f"{i:03}")) for i, row in enumerate(q)
    ]
    np.testing.assert_array_equal(read_joint_states(write_bag(tmp_path / "a.mcap", messages)).positions, q)


def test_times_that_go_back_in_the_file_are_refused(tmp_path: Path) -> None:
    q = poses(30)
    shuffled = [states(q, ["a", "b", "c"])[i] for i in np.random.default_rng(1).permutation(30)]
    with pytest.raises(RecordingError) as refused:
        read_joint_states(write_bag(tmp_path / "a.mcap", shuffled, chunk_size=400))
    assert refused.value.reason == "time-not-increasing"
    stepped = [
        (topic, log_ns - (i >= 15) * 50_500_000, data)
        for i, (topic, log_ns, data) in enumerate(states(q, ["a", "b", "c"], stamped=False))
    ]
    with pytest.raises(RecordingError) as refused:
        read_joint_states(write_bag(tmp_path / "b.mcap", stepped))
    assert refused.value.reason == "time-not-increasing"


def test_a_position_that_no_joint_reaches_is_refused(tmp_path: Path) -> None:
    q = poses(4)
    q[2, 1] = 1e307
    with pytest.raises(RecordingError, match=r"1e\+307") as refused:
        read_joint_states(write_bag(tmp_path / "a.mcap", states(q, ["a", "b", "c"])))
    assert refused.value.reason == "out-of-range"


def test_log_times_serve_when_stamps_are_missing(tmp_path: Path) -> None:
    q = poses(4)
    path = write_bag(tmp_path / "a.mcap", states(q, ["a", "b", "c"], stamped=False))
    recording = read_joint_states(path)
    assert recording.clock == "log"
    np.testing.assert_array_equal(recording.time_ns, START + 10_000_000 * np.arange(4))
    assert recording.remarks == ("header stamps are 0, so log times are used",)
    mixed = states(q, ["a", "b", "c"])
    mixed[2] = (TOPIC, mixed[2][1], payload(["a", "b", "c"], q[2], 0))
    recording = read_joint_states(write_bag(tmp_path / "b.mcap", mixed))
    assert (recording.clock, recording.dropped) == ("header", 1)
    assert recording.remarks == ("1 samples without a header stamp are left out",)
    np.testing.assert_array_equal(recording.positions, q[[0, 1, 3]])


def test_header_stamps_win_over_log_times(tmp_path: Path) -> None:
    messages = [(TOPIC, START + i, payload(["a"], [float(i)], 5 * SECOND + 1000 * i)) for i in range(3)]
    recording = read_joint_states(write_bag(tmp_path / "a.mcap", messages))
    assert (recording.clock, recording.time_ns.tolist()) == ("header", [5000000000, 5000001000, 5000002000])


def test_results_are_read_only(tmp_path: Path) -> None:
    recording = read_joint_states(write_bag(tmp_path / "a.mcap", states(poses(4), ["a", "b", "c"])))
    for array in (recording.time_ns, recording.positions):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_the_topic_with_all_joints_is_found(tmp_path: Path) -> None:
    q = poses(6)
    other = states(q[:, :2], ["x", "y"], "/gripper")
    path = write_bag(tmp_path / "a.mcap", [*states(q, ["a", "b", "c"], "/arm"), *other])
    assert read_joint_states(path, joints=["b", "a"]).topic == "/arm"
    assert read_joint_states(path, topic="/gripper").names == ("x", "y")
    error = rejected(path)
    assert (error.reason, "/arm, /gripper" in error.detail) == ("ambiguous-topic", True)
    error = rejected(path, joints=["a", "x"])
    assert (error.reason, "/arm: a, b, c; /gripper: x, y" in error.detail) == ("joints-missing", True)
    error = rejected(path, topic="/leg")
    assert (error.reason, "/arm (sensor_msgs/msg/JointState, cdr)" in error.detail) == ("no-joint-states", True)


def test_long_lists_of_names_are_cut_short(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "a.mcap", states(poses(2, 200), [f"joint_{i}" for i in range(200)]))
    assert rejected(path, joints=["a"]).detail.endswith("joint_31, and 168 more.")


def test_of_two_topics_the_one_by_its_usual_name_or_the_fuller_one_is_read_and_said(tmp_path: Path) -> None:
    q = poses(8, 2)
    named = states(q, ["a", "b"], "/arm/joint_states") + states(q + 1, ["a", "b"], "/arm/joint_states_desired")
    recording = read_joint_states(write_bag(tmp_path / "a.mcap", named))
    np.testing.assert_array_equal(recording.positions, q)
    assert "/arm/joint_states is read for its name" in recording.remarks[0]
    assert "ingest.topic" in recording.remarks[0]
    desired = read_joint_states(tmp_path / "a.mcap", "/arm/joint_states_desired")
    np.testing.assert_array_equal(desired.positions, q + 1)
    assert desired.remarks == ()
    q = q[:, :1]
    fuller = states(q, ["a"], "/measured") + states(q[:4] + 1, ["a"], "/wanted")
    recording = read_joint_states(write_bag(tmp_path / "b.mcap", fuller))
    assert (recording.topic, "8 messages" in recording.remarks[0]) == ("/measured", True)
    almost = states(q, ["a"], "/measured") + states(q[:5] + 1, ["a"], "/wanted")
    assert "ingest.topic" in rejected(write_bag(tmp_path / "c.mcap", almost)).detail
    both = states(q, ["a"], "/left/joint_states") + states(q, ["a"], "/right/joint_states")
    assert rejected(write_bag(tmp_path / "d.mcap", both)).reason == "ambiguous-topic"


def test_two_topics_with_all_joints_are_ambiguous(tmp_path: Path) -> None:
    q = poses(3)
    path = write_bag(tmp_path / "a.mcap", states(q, ["a", "b", "c"], "/left") + states(q, ["c", "b", "a"], "/right"))
    assert rejected(path, joints=["a"]).reason == "ambiguous-topic"
    assert read_joint_states(path, topic="/right", joints=["a"]).positions[:, 0].tolist() == q[:, 2].tolist()


def test_another_device_on_the_topic_and_messages_without_positions_are_left_out(tmp_path: Path) -> None:
    q = poses(10)
    arm, hand = states(q, ["a", "b", "c"]), states(q, ["x", "y", "z"])
    empty = [(TOPIC, START + 5, payload(["a", "b", "c"], [], START + 5, velocity=[1.0, 2.0, 3.0]))]
    mixed = [message for pair in zip(arm, hand, strict=True) for message in pair] + empty
    path = write_bag(tmp_path / "a.mcap", mixed)
    for joints in (["a", "b", "c"], None):
        recording = read_joint_states(path, joints=joints)
        assert recording.names == ("a", "b", "c")
        np.testing.assert_array_equal(recording.positions, q)


def test_joints_in_messages_of_their_own_are_put_together_by_name(tmp_path: Path) -> None:
    q = poses(6)
    left, right = states(q[:, :2], ["a", "b"]), states(q[:, 2:], ["c"])
    both = [message for pair in zip(left, right, strict=True) for message in pair]
    recording = read_joint_states(write_bag(tmp_path / "a.mcap", both), joints=["c", "a", "b"])
    np.testing.assert_array_equal(recording.positions, q[:, [2, 0, 1]])
    assert "12 of 12 messages have some of the joints only" in recording.remarks[0]
    # a joint keeps its value until it is heard of again; a pose is complete when all have been
    slower = [*left[:3], right[2], *left[3:], right[5]]
    recording = read_joint_states(write_bag(tmp_path / "b.mcap", slower), joints=["a", "b", "c"])
    np.testing.assert_array_equal(recording.positions, q[[2, 5]])
    error = rejected(write_bag(tmp_path / "c.mcap", left), joints=["a", "x"], topic=TOPIC)
    assert (error.reason, "No message on /joint_states has x; they have a, b." in error.detail) == (
        "joints-missing",
        True,
    )


def test_exact_repeats_count_once_and_of_two_poses_at_one_time_the_second_is_dropped(tmp_path: Path) -> None:
    q = poses(3)
    messages = states(q, ["a", "b", "c"])
    path = write_bag(tmp_path / "a.mcap", [messages[0], messages[1], messages[1], messages[2]])
    np.testing.assert_array_equal(read_joint_states(path).positions, q)
    clash = (TOPIC, messages[1][1], payload(["a", "b", "c"], q[2], messages[1][1]))
    recording = read_joint_states(write_bag(tmp_path / "b.mcap", [*messages[:2], clash, messages[2]]))
    np.testing.assert_array_equal(recording.positions, q)
    assert recording.dropped == 1
    assert "1 of 4 samples left out" in recording.remarks[0]


def test_a_stamp_that_runs_backwards_is_an_error(tmp_path: Path) -> None:
    stamps = [3 * SECOND, 4 * SECOND, 2 * SECOND]
    messages = [(TOPIC, START + i, payload(["a"], [float(i)], stamp)) for i, stamp in enumerate(stamps)]
    error = rejected(write_bag(tmp_path / "a.mcap", messages))
    assert (error.reason, "Pose 3 on /joint_states is 2 s earlier" in error.detail) == ("time-not-increasing", True)
    assert "ingest.clock to publish or log" in error.detail
    recording = read_joint_states(tmp_path / "a.mcap", clock="log")
    assert (recording.clock, recording.positions[:, 0].tolist()) == ("log", [0.0, 1.0, 2.0])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_position_that_is_not_finite_is_an_error_only_where_it_is_used(tmp_path: Path, value: float) -> None:
    q = poses(5)
    q[3, 1] = value
    path = write_bag(tmp_path / "a.mcap", states(q, ["a", "b", "c"]))
    error = rejected(path)
    assert (error.reason, "Pose 4" in error.detail, "b at" in error.detail) == ("not-finite", True, True)
    np.testing.assert_array_equal(read_joint_states(path, joints=["a", "c"]).positions, q[:, [0, 2]])


def test_fewer_than_two_poses_are_too_few(tmp_path: Path) -> None:
    messages = states(poses(1), ["a", "b", "c"])
    assert rejected(write_bag(tmp_path / "a.mcap", messages)).reason == "too-few-messages"
    assert rejected(write_bag(tmp_path / "b.mcap", messages * 3)).reason == "too-few-messages"
    empty = [(TOPIC, START + i, payload(["a"], [], START + i)) for i in range(3)]
    assert rejected(write_bag(tmp_path / "c.mcap", empty)).reason == "too-few-messages"


@pytest.mark.parametrize(
    ("schema", "encoding"), [("geometry_msgs/msg/Pose", "cdr"), ("sensor_msgs/JointState", "json")]
)
def test_without_readable_joint_states_the_topics_are_listed(tmp_path: Path, schema: str, encoding: str) -> None:
    path = write_bag(tmp_path / "a.mcap", states(poses(3), ["a", "b", "c"]), schema, encoding)
    error = rejected(path)
    assert error.reason == "no-joint-states"
    assert f"/joint_states ({schema}, {encoding})" in error.detail
    assert "no topics" in rejected(write_bag(tmp_path / "b.mcap", [])).detail


@pytest.mark.parametrize("joints", [[], ["a", "a"], "joint"])
def test_joints_must_be_different_names(tmp_path: Path, joints: object) -> None:
    for function in (read_joint_states, inspect_recording):
        with pytest.raises(ArgumentError, match="joints"):
            function(tmp_path / "a.mcap", joints=joints)


def test_messages_of_ros_1_are_read(tmp_path: Path) -> None:
    def ros1(number: int, names: list[str], position: np.ndarray, stamp_ns: int) -> bytes:
        """Packed value by value, as genpy does: no alignment, no closing NUL."""
        out = struct.pack("<III", number, stamp_ns // SECOND, stamp_ns % SECOND) + struct.pack("<I", 3) + b"arm"
        out += struct.pack("<I", len(names)) + b"".join(struct.pack("<I", len(n)) + n.encode() for n in names)
        return out + struct.pack(f"<I{len(position)}d", len(position), *position) + bytes(8)

    q = poses(5)
    messages = [(TOPIC, START + i, ros1(i, ["shoulder", "a", "hand"], q[i], START + i * 1000)) for i in range(5)]
    recording = read_joint_states(write_bag(tmp_path / "a.mcap", messages, "sensor_msgs/JointState", "ros1"))
    assert (recording.names, recording.clock) == (("shoulder", "a", "hand"), "header")
    np.testing.assert_array_equal(recording.positions, q)
    np.testing.assert_array_equal(recording.time_ns, START + 1000 * np.arange(5))
    cut_short = [(TOPIC, START + i, data[:-20]) for i, (_, _, data) in enumerate(messages)]
    assert rejected(write_bag(tmp_path / "b.mcap", cut_short, "sensor_msgs/JointState", "ros1")).reason == "corrupt"


@pytest.mark.parametrize("cut", [0, 100])
def test_the_hash_is_of_the_bytes_that_were_read(tmp_path: Path, cut: int) -> None:
    path = write_bag(tmp_path / "a.mcap", states(poses(400), ["a", "b", "c"]), chunk_size=512)
    content = path.read_bytes()[: -cut or None]
    path.write_bytes(content)
    recording = read_joint_states(path, salvage=True)
    assert recording.hashes == {path: hashlib.sha256(content).hexdigest()}
    assert (recording.lost is None) == (cut == 0)
