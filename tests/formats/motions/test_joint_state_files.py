"""Motions as MCAP: what other readers find in the files, and ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.formats.motions.joint_state_files import TOPIC, file_name, write_mcap
from pipeline.formats.motions.named_motions import MotionSet, NamedMotion

BEGIN = 1_700_000_000_123_456_789


def two() -> MotionSet:
    rng = np.random.default_rng(0)
    motions = tuple(
        NamedMotion(name, who, BEGIN, np.arange(count) * 20_000_000, rng.normal(size=(count, 3)), {"simulated": "true"})
        for name, who, count in (("tea/../1", "Zoë", 7), ("tea", "ben", 2))
    )
    return MotionSet("pour", ("rail", "swing joint", "bend"), (True, False, False), motions)


def test_the_libraries_of_others_read_the_values(tmp_path: Path) -> None:
    motions = two()
    write_mcap(tmp_path, motions)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tea.mcap", "tea_.._1.mcap"]
    for file, motion in (("tea_.._1", motions.motions[0]), ("tea", motions.motions[1])):
        with (tmp_path / f"{file}.mcap").open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            metadata = {record.name: record.metadata for record in reader.iter_metadata()}
            found = list(reader.iter_decoded_messages())
        assert metadata["demonstration"] == {
            "participant": motion.participant, "demonstration_id": motion.name, "simulated": "true",
        }  # fmt: skip
        assert {channel.topic for _, channel, _, _ in found} == {TOPIC}
        assert {schema.name for schema, _, _, _ in found} == {"sensor_msgs/msg/JointState"}
        messages = [message for _, _, _, message in found]
        assert {tuple(message.name) for message in messages} == {motions.joints}
        np.testing.assert_array_equal([message.position for message in messages], motion.positions)
        stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in messages]
        np.testing.assert_array_equal(stamps, BEGIN + motion.time_ns)


def test_our_own_reader_finds_the_same(tmp_path: Path) -> None:
    motions = two()
    write_mcap(tmp_path, motions)
    read = read_joint_states(tmp_path / "tea.mcap", joints=motions.joints)
    np.testing.assert_array_equal(read.positions, motions.motions[1].positions)
    np.testing.assert_array_equal(read.time_ns, BEGIN + motions.motions[1].time_ns)
    assert read.metadata["demonstration"]["participant"] == "ben"


def test_names_of_files_are_plain_short_and_different() -> None:
    taken: set[str] = set()
    names = ["a", "A", "a/b", "a\\b", "..", "\x1b[2J", "ü" * 300, " "]
    found = [file_name(name, taken) for name in names]
    assert found[:6] == ["a", "A (2)", "a_b", "a_b (2)", "motion", "__2J"]
    assert found[7] == "motion (2)"
    assert len(found[6].encode()) <= 200
    assert len({name.casefold() for name in found}) == len(names)
