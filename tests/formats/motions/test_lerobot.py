"""Motions as a LeRobot dataset: field by field against the format, and read as LeRobot reads it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.formats.motions.lerobot import write_lerobot
from pipeline.formats.motions.named_motions import MotionSet, NamedMotion

SCALARS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
EPISODES = "meta/episodes/chunk-000/file-000.parquet"


def several(joints: int = 3) -> MotionSet:
    rng = np.random.default_rng(2)
    motions = tuple(
        NamedMotion(name, who, 0, np.arange(9) * 100_000_000, rng.normal(size=(9, joints)).cumsum(axis=0))
        for name, who in (("a", "ada"), ("b", "ben"), ("c", "ada"))
    )
    return MotionSet("pour tea", tuple(f"joint {n}" for n in range(joints)), (False,) * joints, motions)


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    write_lerobot(tmp_path, several(), rate_hz=20)
    return tmp_path


def test_info_has_every_field_of_the_format(dataset: Path) -> None:
    info = json.loads((dataset / "meta/info.json").read_text(encoding="utf-8"))
    features = info.pop("features")
    assert info == {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": 3,
        "total_frames": 51,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": 20,
        "splits": {"train": "0:3"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
    }
    names = ["joint 0", "joint 1", "joint 2"]
    assert features.pop("observation.state") == {"dtype": "float32", "shape": [3], "names": names}
    assert features.pop("action") == {"dtype": "float32", "shape": [3], "names": names}
    assert features == {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in SCALARS.items()}
    assert not any("/" in name for name in features)  # which LeRobot refuses


def test_frames_are_where_info_and_episodes_say(dataset: Path) -> None:
    info = json.loads((dataset / "meta/info.json").read_text(encoding="utf-8"))
    episodes = pd.read_parquet(dataset / EPISODES)
    file = dataset / info["data_path"].format(chunk_index=0, file_index=0)
    assert pq.read_metadata(file).num_row_groups == 3
    columns = pq.read_schema(file)
    assert columns.names == list(info["features"])
    for name, feature in info["features"].items():
        scalar = pa.type_for_alias(feature["dtype"])
        assert columns.field(name).type == (
            scalar if feature["shape"] == [1] else pa.list_(scalar, feature["shape"][0])
        )
    frames = pd.read_parquet(file)
    assert len(frames) == info["total_frames"]
    np.testing.assert_array_equal(frames["index"], np.arange(51))
    assert (frames["task_index"] == 0).all()
    for number, motion in enumerate(several().motions):
        row = episodes.loc[number]
        assert row["episode_index"] == number
        assert list(row["tasks"]) == ["pour tea"]
        assert (row["data/chunk_index"], row["data/file_index"]) == (0, 0)
        assert (row["meta/episodes/chunk_index"], row["meta/episodes/file_index"]) == (0, 0)
        assert (row["demonstration_id"], row["participant"]) == (motion.name, motion.participant)
        part = frames.iloc[row["dataset_from_index"] : row["dataset_to_index"]]
        assert len(part) == row["length"] == 17
        assert (part["episode_index"] == number).all()
        np.testing.assert_array_equal(part["frame_index"], np.arange(17))
        np.testing.assert_allclose(part["timestamp"], np.arange(17) / 20, rtol=0, atol=1e-4)  # LeRobot's tolerance
        state, action = (np.stack(part[name]) for name in ("observation.state", "action"))
        np.testing.assert_array_equal(state[::2], motion.positions.astype(np.float32))
        np.testing.assert_array_equal(action[:-1], state[1:])
        np.testing.assert_array_equal(action[-1], state[-1])


def test_tasks_are_read_as_lerobot_reads_them(dataset: Path) -> None:
    tasks = pd.read_parquet(dataset / "meta/tasks.parquet")
    assert tasks.index.name == "task"
    assert int(tasks.loc["pour tea"].task_index) == 0
    assert list(tasks.columns) == ["task_index"]


def test_statistics_are_those_of_the_frames(dataset: Path) -> None:
    frames = pd.read_parquet(dataset / "data/chunk-000/file-000.parquet")
    stats = json.loads((dataset / "meta/stats.json").read_text(encoding="utf-8"))
    assert set(stats) == {"observation.state", "action", *SCALARS}
    episodes = pd.read_parquet(dataset / EPISODES)
    for name, found in stats.items():
        values = np.stack(frames[name]).astype(float).reshape(len(frames), -1)
        expected = {
            "min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0), "count": [51],
            "q01": np.quantile(values, 0.01, axis=0), "q10": np.quantile(values, 0.1, axis=0),
            "q50": np.quantile(values, 0.5, axis=0), "q90": np.quantile(values, 0.9, axis=0),
            "q99": np.quantile(values, 0.99, axis=0),
        }  # fmt: skip
        assert set(found) == set(expected)
        for key, value in expected.items():
            np.testing.assert_allclose(found[key], value, rtol=1e-6, atol=1e-7, err_msg=f"{name} {key}")
        own = values[17:34]
        np.testing.assert_allclose(episodes.loc[1, f"stats/{name}/mean"], own.mean(0), rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(episodes.loc[1, f"stats/{name}/max"], own.max(0), rtol=1e-6, atol=1e-7)


def test_an_arm_of_one_joint_has_plain_columns_as_the_format_wants(tmp_path: Path) -> None:
    write_lerobot(tmp_path, several(joints=1))
    columns = pq.read_schema(tmp_path / "data/chunk-000/file-000.parquet")
    assert columns.field("action").type == pa.float32()
    known = json.loads(columns.metadata[b"huggingface"])["info"]["features"]
    assert known["action"] == {"dtype": "float32", "_type": "Value"}


def test_the_library_datasets_is_told_the_types(dataset: Path) -> None:
    columns = pq.read_schema(dataset / "data/chunk-000/file-000.parquet")
    known = json.loads(columns.metadata[b"huggingface"])["info"]["features"]
    assert known["observation.state"] == {
        "feature": {"dtype": "float32", "_type": "Value"}, "length": 3, "_type": "Sequence",
    }  # fmt: skip
    assert known["index"] == {"dtype": "int64", "_type": "Value"}
