"""Datasets of LeRobot and files of robomimic: each episode is a demonstration, and nothing leads out of the file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import RecordingError
from pipeline.formats.mcap.limits import Limits
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.folders import read_folder
from pipeline.formats.recordings.readers import inspect, read_recording
from tests.support.recorded_forms import NAMES, motion, write_hdf5, write_lerobot

VERSIONS = ["v2.1", "v3.0"]


def rejected(folder: Path, columns: ColumnMap | None = None, **arguments: Any) -> RecordingError:
    """Why the first recording of a folder, or the folder, cannot be used."""
    found = read_folder(folder, columns)
    if not found.bags:
        (one,) = found.unused
        return RecordingError(one.reason, one.detail)
    with pytest.raises(RecordingError) as caught:
        read_recording(found.bags[0], columns=columns, **arguments)
    return caught.value


# LeRobot


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("itself", [True, False])
def test_each_episode_of_lerobot_is_a_recording(tmp_path: Path, version: str, itself: bool) -> None:
    folder = write_lerobot(tmp_path / "picks", version)
    found = read_folder(folder if itself else tmp_path)
    prefix = "" if itself else "picks_"
    assert [bag.name for bag in found.bags] == [f"{prefix}episode_{number:06d}" for number in range(3)]
    assert found.unused == ()
    times, positions = motion()
    for number, bag in enumerate(found.bags):
        recording = read_recording(bag, joints=NAMES)
        assert (recording.clock, recording.names) == ("header", NAMES)
        np.testing.assert_allclose(recording.time_ns, times - times[0], atol=200)
        np.testing.assert_array_equal(recording.positions, (positions + 0.01 * number).astype(np.float32))
        assert recording.source.endswith(f".parquet: episode {number}")
        assert recording.dropped == 0
    assert inspect(found.bags[0]).topics[0].joints == NAMES


@pytest.mark.parametrize(
    "names",
    [
        {"motors": list(NAMES)},
        {"arm": ["rail", "swing"], "wrist": ["bend"]},
        {"motors": {"rail": 0, "swing": 1, "bend": 2}},
    ],
)
def test_names_may_stand_in_groups(tmp_path: Path, names: Any) -> None:
    folder = write_lerobot(tmp_path / "picks", "v2.1", 1, names)
    assert inspect(read_folder(folder).bags[0]).topics[0].joints == NAMES


def test_names_that_are_not_there_are_numbers_and_may_be_given(tmp_path: Path) -> None:
    folder = write_lerobot(tmp_path / "picks", "v3.0", 1, None)
    (bag,) = read_folder(folder).bags
    assert inspect(bag).topics[0].joints == ("state_0", "state_1", "state_2")
    assert "it has state_0, state_1, state_2" in rejected(folder, joints=["rail"]).detail
    recording = read_recording(bag, joints=["bend"], columns=ColumnMap(joints=NAMES))
    np.testing.assert_array_equal(recording.positions[:, 0], motion()[1][:, 2].astype(np.float32))
    assert "names 2" in rejected(folder, ColumnMap(joints=("a", "b"))).detail


def test_degrees_are_said_by_the_task(tmp_path: Path) -> None:
    folder = write_lerobot(tmp_path / "picks", "v2.1", 1, scale=180 / np.pi)
    columns = ColumnMap(unit={"swing": "deg", "bend": "deg", "rail": "m"})
    recording = read_recording(read_folder(folder).bags[0], joints=NAMES, columns=columns)
    np.testing.assert_allclose(recording.positions[:, 1:], motion()[1][:, 1:], atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "reason", "said"),
    [
        ({"codebase_version": "v1.6"}, "not-read", "'v1.6'"),
        ({"codebase_version": 3}, "bad-metadata", "is not what LeRobot writes"),
        ({"fps": 0}, "bad-metadata", "fps 0"),
        ({"fps": "nan"}, "bad-metadata", "fps nan"),
        ({"features": {}}, "bad-metadata", "is not what LeRobot writes"),
        ({"features": {"observation.state": {"shape": [10**9], "names": []}}}, "bad-metadata", "1000000000 numbers"),
        ({"features": {"observation.state": {"shape": [4], "names": None}}}, "corrupt", "are not 4 numbers"),
        ({"total_episodes": 9}, "incomplete-bag", "states 9 episodes, and the files in data have 2"),
    ],
)
@pytest.mark.parametrize("version", VERSIONS)
def test_what_lerobot_states_is_checked(
    tmp_path: Path, version: str, changes: dict[str, Any], reason: str, said: str
) -> None:
    folder = write_lerobot(tmp_path / "picks", version, 2, **({"codebase_version": version} | changes))
    error = rejected(folder)
    assert (error.reason, said in error.detail) == (reason, True), error.detail


def test_where_files_are_is_not_what_the_dataset_says(tmp_path: Path) -> None:
    secret = tmp_path / "secret.parquet"
    secret.write_bytes(b"PAR1")
    folder = write_lerobot(tmp_path / "picks", "v3.0", data_path="../../secret.parquet")
    assert {bag.files[0].parent.name for bag in read_folder(folder).bags} == {"chunk-000"}


@pytest.mark.parametrize("version", VERSIONS)
def test_damaged_files_of_lerobot_are_one_sentence(tmp_path: Path, version: str) -> None:
    folder = write_lerobot(tmp_path / "picks", version, 1, episodes_in_a_file=1)
    (file,) = folder.rglob("*.parquet")
    content, rng, said = file.read_bytes(), np.random.default_rng(0), []
    for _ in range(5):
        data = bytearray(content)
        for at in rng.integers(len(data) - 3000, len(data), 4):
            data[at] = rng.integers(256)
        file.write_bytes(data)
        found = read_folder(folder)
        for bag in found.bags:
            try:
                read_recording(bag, joints=NAMES)
            except RecordingError as error:
                said.append(error.detail)
    assert all(said)
    file.write_bytes(content[:-100])
    assert rejected(folder).reason == "corrupt"


# HDF5

hdf5: Any = pytest.importorskip("h5py", reason="the extra `hdf5` is not installed")


@pytest.mark.parametrize("options", [{}, {"compression": "gzip", "shuffle": True}, {"compression": "lzf"}])
def test_each_demonstration_of_robomimic_is_a_recording(tmp_path: Path, options: dict[str, Any]) -> None:
    path = write_hdf5(tmp_path / "lift.hdf5", 12, **options)
    found = read_folder(tmp_path)
    assert {bag.name for bag in found.bags} == {f"lift_demo_{number}" for number in range(12)}
    times, positions = motion()
    columns = ColumnMap(joints=NAMES)
    for bag in found.bags:
        recording = read_recording(bag, joints=NAMES, columns=columns)
        np.testing.assert_array_equal(recording.time_ns, times - times[0])
        np.testing.assert_array_equal(recording.positions, positions + 0.01 * int(bag.entry.removeprefix("demo_")))
    assert recording.source == f"lift.hdf5: {bag.entry}"
    assert list(recording.hashes) == [path]
    assert inspect(bag).topics[0].joints == ("robot0_joint1", "robot0_joint2", "robot0_joint3")
    assert "List the joints in order" in rejected(tmp_path, joints=["rail"]).detail


def test_two_robots_and_people_of_robomimic(tmp_path: Path) -> None:
    def more(file: Any) -> None:
        file["data/demo_0/obs"].create_dataset("robot1_joint_pos", data=motion()[1] + 1)
        file["data/demo_0"].attrs["participant"] = "Ann"

    write_hdf5(tmp_path / "lift.h5", 1, more)
    (bag,) = read_folder(tmp_path).bags
    recording = read_recording(bag, joints=["robot1_joint3", "robot0_joint1"])
    np.testing.assert_array_equal(recording.positions[:, 0], motion()[1][:, 2] + 1)
    assert recording.metadata["demonstration"] == {"participant": "Ann"}


def _external_link(file: Any) -> None:
    del file["data/demo_0/obs/robot0_joint_pos"]
    file["data/demo_0/obs/robot0_joint_pos"] = hdf5.ExternalLink("/etc/passwd", "/x")


def _soft_link(file: Any) -> None:
    file.move("data/demo_0/obs/robot0_joint_pos", "elsewhere")
    file["data/demo_0/obs/robot0_joint_pos"] = hdf5.SoftLink("/elsewhere")


def _linked_group(file: Any) -> None:
    del file["data"]
    file["data"] = hdf5.ExternalLink("other.hdf5", "/data")


def _external_storage(file: Any) -> None:
    obs = file["data/demo_0/obs"]
    del obs["robot0_joint_pos"]
    obs.create_dataset("robot0_joint_pos", (10, 3), "f8", external=[("/etc/passwd", 0, 240)])


def _virtual(file: Any) -> None:
    obs = file["data/demo_0/obs"]
    del obs["robot0_joint_pos"]
    layout = hdf5.VirtualLayout((10, 3), "f8")
    layout[:] = hdf5.VirtualSource("/tmp/other.hdf5", "x", (10, 3))
    obs.create_virtual_dataset("robot0_joint_pos", layout)


def _replaced(**options: Any) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        obs = file["data/demo_0/obs"]
        del obs["robot0_joint_pos"]
        obs.create_dataset("robot0_joint_pos", **options)

    return change


def _attribute(**values: Any) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        for name, value in values.items():
            file["data"].attrs[name] = value

    return change


def _without(name: str) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        del file[name]

    return change


@pytest.mark.parametrize(
    ("change", "reason", "said"),
    [
        (_external_link, "corrupt", "a link 'robot0_joint_pos' to another place or file"),
        (_soft_link, "corrupt", "a link 'robot0_joint_pos' to another place or file"),
        (_linked_group, "corrupt", "a link 'data' to another place or file"),
        (_external_storage, "corrupt", "stored in another file"),
        (_virtual, "corrupt", "stored in another file"),
        (_replaced(shape=(10**12, 3), dtype="f8", chunks=(1000, 3)), "too-large", "has 1000000000000 rows"),
        (_replaced(shape=(10**6, 255), dtype="f8", chunks=(1000, 255)), "too-large", "joint positions"),
        (_replaced(shape=(10**6, 16), dtype="f8", chunks=(10**6, 16)), "too-large", "in chunks of more than"),
        (_replaced(data=np.array([["a", "b"]], dtype="S1")), "corrupt", "no table of numbers"),
        (_replaced(data=np.zeros(3)), "corrupt", "no table of numbers"),
        (_replaced(shape=(0, 3), dtype="f8"), "corrupt", "has no steps"),
        (_attribute(env_args="[1"), "bad-metadata", "env_args"),
        (_attribute(env_args="{}"), "not-read", "reading.rate_hz"),
        (_attribute(env_args=json.dumps({"env_kwargs": {"control_freq": -1}})), "not-read", "control_freq"),
        (_without("data/demo_0/obs"), "not-read", "only the simulator's states"),
        (_without("data/demo_0/obs/robot0_joint_pos"), "joints-missing", "reading.array"),
        (_without("data"), "not-read", "no group 'data'"),
    ],
)
def test_hdf5_that_leads_elsewhere_or_is_too_much_is_refused(
    tmp_path: Path, change: Callable[[Any], None], reason: str, said: str
) -> None:
    write_hdf5(tmp_path / "lift.hdf5", 1, change)
    error = rejected(tmp_path)
    assert (error.reason, said in error.detail) == (reason, True), error.detail


def test_a_rate_and_an_array_may_be_given(tmp_path: Path) -> None:
    write_hdf5(tmp_path / "lift.hdf5", 1, _attribute(env_args="{}"))
    columns = ColumnMap(rate_hz=10.0, array="robot0_joint_pos_cos", joints=NAMES)
    recording = read_recording(read_folder(tmp_path).bags[0], columns=columns)
    np.testing.assert_array_equal(np.diff(recording.time_ns), 100_000_000)
    np.testing.assert_array_equal(recording.positions, np.cos(motion()[1]))


def test_a_filter_that_h5py_has_not_built_in_is_not_loaded(tmp_path: Path) -> None:
    def change(file: Any) -> None:
        obs = file["data/demo_0/obs"]
        del obs["robot0_joint_pos"]
        plist = hdf5.h5p.create(hdf5.h5p.DATASET_CREATE)
        plist.set_chunk((10, 3))
        plist.set_filter(32015, hdf5.h5z.FLAG_OPTIONAL, (3,))  # zstd, a plug-in
        space = hdf5.h5s.create_simple((10, 3))
        hdf5.h5d.create(obs.id, b"robot0_joint_pos", hdf5.h5t.IEEE_F64LE, space, plist)

    write_hdf5(tmp_path / "lift.hdf5", 1, change)
    error = rejected(tmp_path)
    assert (error.reason, "filter 32015" in error.detail) == ("unsupported-compression", True)


def test_a_file_that_is_no_hdf5_and_a_missing_library_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_hdf5(tmp_path / "lift.hdf5", 1)
    content = path.read_bytes()
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    assert rejected(tmp_path).reason == "corrupt"
    path.write_bytes(content)

    def absent(name: str) -> Any:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("pipeline.formats.recordings.extras.import_module", absent)
    error = rejected(tmp_path)
    assert (error.reason, "`pip install 'lessbench[hdf5]'`" in error.detail) == ("not-read", True)


def test_a_long_file_is_not_opened(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "lift.hdf5", 1)
    (bag,) = read_folder(tmp_path).bags
    with pytest.raises(RecordingError, match="at most 100 are read"):
        read_recording(bag, limits=Limits(stored_bytes=100))
    assert path.stat().st_size > 100


def test_a_chunk_that_inflates_beyond_its_size_is_refused(tmp_path: Path) -> None:
    import zlib

    def change(file: Any) -> None:
        obs = file["data/demo_0/obs"]
        del obs["robot0_joint_pos"]
        dataset = obs.create_dataset("robot0_joint_pos", (10, 3), "f8", chunks=(10, 3), compression="gzip")
        dataset.id.write_direct_chunk((0, 0), zlib.compress(bytes(300_000)))

    write_hdf5(tmp_path / "lift.hdf5", 1, change)
    error = rejected(tmp_path)
    assert (error.reason, "inflates to more than its 244 bytes" in error.detail) == ("too-large", True)


def test_a_file_that_ends_the_library_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_hdf5(tmp_path / "lift.hdf5", 1)
    monkeypatch.setattr("pipeline.formats.recordings.hdf5._PROCESS", "pipeline.formats.recordings.columns")
    error = rejected(tmp_path)
    assert (error.reason, "the library gives up" in error.detail) == ("corrupt", True)


def test_damaged_hdf5_is_one_sentence(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "lift.hdf5", 1, compression="gzip")
    content, rng, reasons = path.read_bytes(), np.random.default_rng(3), set()
    for _ in range(8):
        data = bytearray(content)
        for at in rng.integers(8, 4000, 6):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        found = read_folder(tmp_path)
        reasons |= {one.reason for one in found.unused}
        for bag in found.bags:
            try:
                read_recording(bag)
            except RecordingError as error:
                reasons.add(error.reason)
    assert "corrupt" in reasons
