"""Reading 100,000 poses of a seven-joint arm from each form that is read: `python -m benchmarks.readers`.

Beside the MCAP file of `benchmarks.ingest`. Bags are written by rosbags, HDF5 by h5py, tables by polars and NumPy; the
dataset of LeRobot has ten episodes in one file. Each is read whole, from listing the folder to checked poses, and
gives the same positions.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from benchmarks.explained import explain
from benchmarks.measuring import measured, record, show, timed
from pipeline.formats.mcap.joint_states import write_joint_states
from pipeline.formats.recordings.columns import ColumnMap
from pipeline.formats.recordings.folders import read_folder
from pipeline.formats.recordings.readers import read_recording

POSES = 100_000
EPISODES = 10
NAMES = tuple(f"j2s7s300_joint_{i}" for i in range(1, 8))
COLUMNS = ColumnMap(joints=NAMES)
SECOND = 1_000_000_000


def motion() -> tuple[np.ndarray, np.ndarray]:
    """Times (M,) ns, 100 a second, and positions (M, 7)."""
    rng = np.random.default_rng(0)
    time_ns = 1_700_000_000 * SECOND + 10_000_000 * np.arange(POSES)
    return time_ns, np.cumsum(rng.normal(scale=0.01, size=(POSES, len(NAMES))), axis=0)


def mcap(folder: Path) -> None:
    write_joint_states(folder / "a.mcap", motion()[0], NAMES, motion()[1], topic="/joint_states", metadata={})


def _joint_state(store: Any, time_ns: int, row: np.ndarray, **more: int) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=int(time_ns // SECOND), nanosec=int(time_ns % SECOND))
    header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **more)
    none = np.empty(0)
    return store.types["sensor_msgs/msg/JointState"](
        header=header, name=list(NAMES), position=row, velocity=none, effort=none
    )


def ros2(folder: Path, mode: str | None = None) -> None:
    store, kind = get_typestore(Stores.ROS2_JAZZY), "sensor_msgs/msg/JointState"
    writer = rosbag2.Writer(folder / "a", version=9)
    if mode is not None:
        writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for time, row in zip(*motion(), strict=True):
            writer.write(connection, int(time), store.serialize_cdr(_joint_state(store, time, row), kind))


def ros2_by_message(folder: Path) -> None:
    ros2(folder, "MESSAGE")


def ros1(folder: Path) -> None:
    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/JointState"
    writer = rosbag1.Writer(folder / "a.bag")
    writer.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
    with writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for time, row in zip(*motion(), strict=True):
            writer.write(connection, int(time), store.serialize_ros1(_joint_state(store, time, row, seq=0), kind))


def plan(folder: Path) -> None:
    """JointTrajectory messages of 100 points each."""
    store, kind = get_typestore(Stores.ROS2_JAZZY), "trajectory_msgs/msg/JointTrajectory"
    duration, none = store.types["builtin_interfaces/msg/Duration"], np.empty(0)
    with rosbag2.Writer(folder / "a", version=9) as writer:
        connection = writer.add_connection("/plan", kind, typestore=store)
        times, positions = motion()
        for start in range(0, POSES, 100):
            stamp = store.types["builtin_interfaces/msg/Time"](
                sec=int(times[start] // SECOND), nanosec=int(times[start] % SECOND)
            )
            header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="base")
            points = [
                store.types["trajectory_msgs/msg/JointTrajectoryPoint"](
                    positions=row, velocities=none, accelerations=none, effort=none,
                    time_from_start=duration(sec=0, nanosec=10_000_000 * number),
                )
                for number, row in enumerate(positions[start : start + 100])
            ]  # fmt: skip
            message = store.types[kind](header=header, joint_names=list(NAMES), points=points)
            writer.write(connection, int(times[start]), store.serialize_cdr(message, kind))


def in_json(folder: Path) -> None:
    with (folder / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/joint_states", "json", 0)
        for time, row in zip(*motion(), strict=True):
            stamp = {"sec": int(time // SECOND), "nanosec": int(time % SECOND)}
            message = {"header": {"stamp": stamp}, "name": NAMES, "position": row.tolist()}
            writer.add_message(channel, int(time), json.dumps(message).encode(), int(time))
        writer.finish()


def in_protobuf(folder: Path) -> None:
    file = descriptor_pb2.FileDescriptorProto(
        name="arm.proto", package="arm", syntax="proto3", dependency=["google/protobuf/timestamp.proto"]
    )
    joints = file.message_type.add(name="Joints")
    joints.field.add(name="timestamp", number=1, label=1, type=11, type_name=".google.protobuf.Timestamp")
    joints.field.add(name="name", number=2, label=3, type=9)
    joints.field.add(name="position", number=3, label=3, type=1)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("arm.Joints"))
    with (folder / "a.mcap").open("wb") as stream, ProtobufWriter(stream) as writer:
        for time, row in zip(*motion(), strict=True):
            message = kind(name=NAMES, position=row)
            message.timestamp.seconds, message.timestamp.nanos = divmod(int(time), SECOND)
            writer.write_message("/joint_states", message, int(time), int(time))


def _table() -> dict[str, np.ndarray]:
    times, positions = motion()
    return {"time_ns": times} | {name: positions[:, place] for place, name in enumerate(NAMES)}


def csv(folder: Path) -> None:
    pl.DataFrame(_table()).write_csv(folder / "a.csv")


def parquet(folder: Path) -> None:
    pl.DataFrame(_table()).write_parquet(folder / "a.parquet")


def npz(folder: Path) -> None:
    np.savez_compressed(folder / "a.npz", **_table())


def lerobot(folder: Path) -> None:
    dataset = folder / "picks"
    (dataset / "data" / "chunk-000").mkdir(parents=True)
    (dataset / "meta").mkdir()
    state = {"dtype": "float64", "shape": [len(NAMES)], "names": list(NAMES)}
    info = {
        "codebase_version": "v3.0",
        "fps": 100,
        "total_episodes": EPISODES,
        "features": {"observation.state": state},
    }
    (dataset / "meta" / "info.json").write_text(json.dumps(info))
    each = POSES // EPISODES
    table = pa.table(
        {
            "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(motion()[1].ravel()), len(NAMES)),
            "timestamp": np.tile(np.arange(each) / 100, EPISODES),
            "episode_index": np.repeat(np.arange(EPISODES), each),
        }
    )
    pq.write_table(table, dataset / "data" / "chunk-000" / "file-000.parquet")


def hdf5(folder: Path) -> None:
    with h5py.File(folder / "a.hdf5", "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_kwargs": {"control_freq": 100}})
        data.create_dataset("demo_0/obs/robot0_joint_pos", data=motion()[1], compression="gzip")


FORMS: dict[str, Callable[[Path], None]] = {
    "MCAP, JointState in CDR": mcap,
    "ROS 2 in SQLite": ros2,
    "ROS 2 in SQLite, each message compressed": ros2_by_message,
    "ROS 1 bag, lz4": ros1,
    "JointTrajectory, 100 points each": plan,
    "MCAP, JSON": in_json,
    "MCAP, Protobuf": in_protobuf,
    "CSV": csv,
    "Parquet": parquet,
    "npz": npz,
    "LeRobot 3.0, ten episodes": lerobot,
    "HDF5 of robomimic": hdf5,
}


def read(folder: Path) -> tuple[float, np.ndarray]:
    """Seconds, and positions of all recordings in a folder one after another."""

    def all_of_them() -> np.ndarray:
        bags = read_folder(folder, COLUMNS).bags
        return np.concatenate([read_recording(bag, joints=NAMES, columns=COLUMNS).positions for bag in bags])

    return timed(all_of_them)


def main() -> None:
    rows, costs = [], {}
    expected = motion()[1]
    for name, write in FORMS.items():
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            write(folder)
            size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
            run = measured(read, folder)  # once: what is kept of a file makes a second time faster
        assert np.array_equal(run.result, expected), name
        rows.append(
            (
                name,
                f"{size / 1e6:.1f} MB",
                f"{run.seconds:.2f} s",
                f"{POSES / run.seconds:,.0f}",
                f"{run.memory / 1e6:,.0f} MB",
            )
        )
        costs[f"read {name}, us per pose"] = run.seconds / POSES * 1e6
    show(
        f"Reading {POSES:,} poses of {len(NAMES)} joints, the same values",
        ("form", "size", "time", "poses a second", "peak memory"),
        rows,
    )
    record("readers", costs)


if __name__ == "__main__":
    explain(__doc__)
    main()
