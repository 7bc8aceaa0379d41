"""Recordings written in every form that is read, by the libraries that write them for others."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SECOND = 10**9
START = 1_700_000_000 * SECOND
NAMES = ("rail", "swing", "bend")
TOPIC = "/joint_states"


def motion(count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Times (M,) ns and positions (M, 3)."""
    share = np.linspace(0, 1, count)[:, None]
    positions = np.array([-0.3, -0.6, 0.1]) + share * np.array([0.6, 1.5, -0.3]) + 0.01 * np.sin(9 * share)
    return START + np.arange(count) * (SECOND // 50), positions


def _store(ros: int) -> Any:
    typesys = pytest.importorskip("rosbags.typesys", reason="the extra `ros` is not installed")
    return typesys.get_typestore(typesys.Stores.ROS1_NOETIC if ros == 1 else typesys.Stores.ROS2_JAZZY)


def _header(store: Any, ros: int, time_ns: int) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](sec=int(time_ns // SECOND), nanosec=int(time_ns % SECOND))
    more = {"seq": 0} if ros == 1 else {}
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id="base", **more)


def joint_state(store: Any, ros: int, time_ns: int, names: Sequence[str], positions: np.ndarray) -> Any:
    """A message of sensor_msgs/msg/JointState."""
    empty = np.empty(0)
    return store.types["sensor_msgs/msg/JointState"](
        header=_header(store, ros, time_ns), name=list(names), position=np.asarray(positions, np.float64),
        velocity=empty, effort=empty,
    )  # fmt: skip


def joint_trajectory(
    store: Any, ros: int, time_ns: int, names: Sequence[str], after_ns: Sequence[int], positions: np.ndarray
) -> Any:
    """A message of trajectory_msgs/msg/JointTrajectory."""
    empty = np.empty(0)
    kind, duration = "trajectory_msgs/msg/JointTrajectoryPoint", store.types["builtin_interfaces/msg/Duration"]
    points = [
        store.types[kind](
            positions=np.asarray(row, np.float64), velocities=empty, accelerations=empty, effort=empty,
            time_from_start=duration(sec=int(after // SECOND), nanosec=int(after % SECOND)),
        )
        for after, row in zip(after_ns, positions, strict=True)
    ]  # fmt: skip
    return store.types["trajectory_msgs/msg/JointTrajectory"](
        header=_header(store, ros, time_ns), joint_names=list(names), points=points
    )


Message = tuple[str, int, str, Any]
"""Topic, log time, type, message."""


def states(store: Any, ros: int, names: Sequence[str] = NAMES) -> list[Message]:
    """The motion as joint states."""
    kind = "sensor_msgs/msg/JointState"
    return [
        (TOPIC, int(time) + 1000, kind, joint_state(store, ros, time, names, row))
        for time, row in zip(*motion(), strict=True)
    ]


def write_ros2(
    folder: Path,
    messages: Callable[[Any], list[Message]],
    storage: str = "SQLITE3",
    compression: str | None = None,
    version: int = 9,
    custom: dict[str, str] | None = None,
) -> Path:
    """A bag of ROS 2 by rosbags: `storage` SQLITE3 or MCAP, `compression` FILE, MESSAGE, STORAGE or None."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="the extra `ros` is not installed")
    store = _store(2)
    writer = rosbag2.Writer(folder, version=version, storage_plugin=rosbag2.StoragePlugin[storage])
    if compression is not None:
        writer.set_compression(rosbag2.CompressionMode[compression], rosbag2.CompressionFormat.ZSTD)
    with writer:
        for key, value in (custom or {}).items():
            writer.set_custom_data(key, value)
        connections: dict[str, Any] = {}
        for topic, time, kind, message in messages(store):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, store.serialize_cdr(message, kind))
    return folder


def write_ros1(path: Path, messages: Callable[[Any], list[Message]], compression: str | None = None) -> Path:
    """A bag of ROS 1 by rosbags: `compression` BZ2, LZ4 or None."""
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="the extra `ros` is not installed")
    store = _store(1)
    writer = rosbag1.Writer(path)
    if compression is not None:
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    with writer:
        connections: dict[str, Any] = {}
        for topic, time, kind, message in messages(store):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, store.serialize_ros1(message, kind))
    return path


def write_json(path: Path, message_of: Callable[[int, np.ndarray], Any], topic: str = TOPIC) -> Path:
    """An MCAP file with a JSON channel, of a message for each pose of the motion."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("joints", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel(topic, "json", schema)
        for time, row in zip(*motion(), strict=True):
            message = message_of(int(time), row)
            data = message if isinstance(message, bytes) else json.dumps(message).encode()
            writer.add_message(channel, int(time) + 1000, data, int(time) + 1000)
        writer.finish()
    return path


def write_lerobot(
    folder: Path,
    version: str,
    episodes: int = 3,
    names: Any = NAMES,
    scale: float = 1.0,
    episodes_in_a_file: int = 2,
    **changes: Any,
) -> Path:
    """A dataset as LeRobot describes its formats 2.1 and 3.0, without videos."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    times, positions = motion()
    fps = 50
    new = version.startswith("v3")
    info = {
        "codebase_version": version, "robot_type": "gantry", "total_episodes": episodes,
        "total_frames": episodes * len(times), "total_tasks": 1, "chunks_size": 1000, "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet" if new
        else "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": None,
        "features": {
            "observation.state": {
                "dtype": "float32", "shape": [positions.shape[1]],
                "names": list(names) if isinstance(names, tuple) else names,
            },
            "action": {"dtype": "float32", "shape": [3], "names": None},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            "frame_index": {"dtype": "int64", "shape": [1], "names": None},
            "episode_index": {"dtype": "int64", "shape": [1], "names": None},
            "index": {"dtype": "int64", "shape": [1], "names": None},
            "task_index": {"dtype": "int64", "shape": [1], "names": None},
        },
    } | changes  # fmt: skip
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    tables = []
    for episode in range(episodes):
        rows = ((positions + 0.01 * episode) * scale).astype(np.float32)
        frames = np.arange(len(times))
        tables.append(
            pa.table(
                {
                    "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), positions.shape[1]),
                    "action": pa.array(rows.tolist(), pa.list_(pa.float32())),
                    "timestamp": pa.array((frames / fps).astype(np.float32)),
                    "frame_index": frames,
                    "episode_index": np.full(len(frames), episode),
                    "index": frames + episode * len(frames),
                    "task_index": np.zeros(len(frames), np.int64),
                }
            )
        )
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    if new:
        for number, start in enumerate(range(0, episodes, episodes_in_a_file)):
            together = pa.concat_tables(tables[start : start + episodes_in_a_file])
            pq.write_table(together, data / f"file-{number:03d}.parquet")
        (folder / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    else:
        for number, table in enumerate(tables):
            pq.write_table(table, data / f"episode_{number:06d}.parquet")
        lines = [json.dumps({"episode_index": e, "tasks": ["sweep"], "length": len(times)}) for e in range(episodes)]
        (folder / "meta" / "episodes.jsonl").write_text("\n".join(lines) + "\n")
    return folder


def write_hdf5(
    path: Path, demonstrations: int = 2, change: Callable[[Any], None] | None = None, **options: Any
) -> Path:
    """A file as robomimic writes it."""
    h5py = pytest.importorskip("h5py", reason="the extra `hdf5` is not installed")
    _, positions = motion()
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 50}})
        data.attrs["total"] = demonstrations * len(positions)
        for number in range(demonstrations):
            demo = data.create_group(f"demo_{number}")
            demo.attrs["num_samples"] = len(positions)
            demo.create_dataset("actions", data=np.zeros((len(positions), 7)))
            demo.create_dataset("states", data=np.zeros((len(positions), 32)))
            demo.create_dataset("obs/robot0_joint_pos", data=positions + 0.01 * number, **options)
            demo.create_dataset("obs/robot0_joint_pos_cos", data=np.cos(positions))
        if change is not None:
            change(file)
    return path


def write_table(path: Path, columns: dict[str, Any]) -> Path:
    """A table by polars or NumPy, by the ending of its file."""
    import polars as pl

    if path.suffix == ".npz":
        np.savez_compressed(path, **columns)
    elif path.suffix == ".parquet":
        pl.DataFrame(columns).write_parquet(path)
    else:
        pl.DataFrame(columns).write_csv(path, separator="\t" if path.suffix == ".tsv" else ",")
    return path
