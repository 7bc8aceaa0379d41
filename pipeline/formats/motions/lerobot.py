"""Motions as a LeRobot dataset of format v3.0: an episode each, without pictures.

Source of the format: LeRobot's `datasets/utils.py`, `dataset_metadata.py` and `compute_stats.py`, at version v3.0.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.motions.named_motions import MotionSet, NamedMotion

if TYPE_CHECKING:
    import pyarrow as pa

VERSION, RATE_HZ = "v3.0", 30
STATE, ACTION = "observation.state", "action"
DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
Numbers = NDArray[Any]  # float32 or int64
_COUNTS = ("frame_index", "episode_index", "index", "task_index")


def write_lerobot(folder: Path, motions: MotionSet, rate_hz: int = RATE_HZ) -> None:
    """Write data/, meta/info.json, meta/stats.json, meta/tasks.parquet and meta/episodes/.

    `observation.state` is the position of the joints, and `action` that of the next frame, at the end the same.

    Args:
        folder: where to.
        motions: of any times; they are sampled at the rate.
        rate_hz: frames per second, which are an integer in this format.

    Raises:
        ArgumentError: there would be too many frames.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    sampled = motions.sampled(rate_hz)
    for place in (DATA, EPISODES):
        (folder / place).parent.mkdir(parents=True)
    features = features_of(motions)
    hugging_face = {b"huggingface": json.dumps({"info": {"features": _hugging_face(features)}}).encode()}
    columns = pa.schema([(name, _arrow(feature)) for name, feature in features.items()], hugging_face)
    rows, at = [], 0
    everything: dict[str, list[Numbers]] = {name: [] for name in features}
    with pq.ParquetWriter(folder / DATA, columns, compression="snappy") as writer:
        for episode, motion in enumerate(sampled.motions):
            frames = _frames(motion, episode, at, rate_hz)
            writer.write_table(_as_table(frames, columns))  # one row group for each episode
            rows.append(_episode(motion, episode, at, motions.task, frames))
            for name, values in frames.items():
                everything[name].append(values)
            at += len(motion.time_ns)
    pq.write_table(pa.Table.from_pylist(rows), folder / EPISODES, compression="snappy")
    pq.write_table(_tasks(motions.task), folder / "meta/tasks.parquet", compression="snappy")
    stats = {name: statistics(np.concatenate(parts)) for name, parts in everything.items()}
    _write_json(folder / "meta/stats.json", stats)
    _write_json(folder / "meta/info.json", _info(features, len(rows), at, rate_hz))


def features_of(motions: MotionSet) -> dict[str, dict[str, Any]]:
    """The features of info.json: state and action, named by the joints, and those that every dataset has."""
    joints = {"dtype": "float32", "shape": [len(motions.joints)], "names": list(motions.joints)}
    single = {"shape": [1], "names": None}
    return {
        STATE: dict(joints),
        ACTION: dict(joints),
        "timestamp": {"dtype": "float32", **single},
        **{name: {"dtype": "int64", **single} for name in _COUNTS},
    }


def statistics(values: Numbers) -> dict[str, list[Any]]:
    """Minimum, maximum, mean, standard deviation, quantiles and count of (N, D) or (N,), lists of D or one number."""
    columns = values.reshape(len(values), -1)
    wide = columns.astype(np.float64)
    return {
        "min": columns.min(axis=0).tolist(),
        "max": columns.max(axis=0).tolist(),
        "mean": wide.mean(axis=0).tolist(),
        "std": wide.std(axis=0).tolist(),
        "count": [len(columns)],
        **{name: np.quantile(wide, share, axis=0).tolist() for name, share in QUANTILES.items()},
    }


def _frames(motion: NamedMotion, episode: int, first: int, rate_hz: int) -> dict[str, Numbers]:
    count = len(motion.time_ns)
    state = motion.positions.astype(np.float32)
    numbers = np.arange(count)
    return {
        STATE: state,
        ACTION: state[np.minimum(numbers + 1, count - 1)],
        "timestamp": (numbers / rate_hz).astype(np.float32),
        "frame_index": numbers,
        "episode_index": np.full(count, episode),
        "index": first + numbers,
        "task_index": np.zeros(count, np.int64),
    }


def _episode(motion: NamedMotion, episode: int, first: int, task: str, frames: Mapping[str, Numbers]) -> dict[str, Any]:
    count = len(motion.time_ns)
    return {
        "episode_index": episode,
        "tasks": [task],
        "length": count,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": first,
        "dataset_to_index": first + count,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        "demonstration_id": motion.name,
        "participant": motion.participant,
        **{f"stats/{name}/{key}": one for name, values in frames.items() for key, one in statistics(values).items()},
    }


def _info(features: Mapping[str, Any], episodes: int, frames: int, rate_hz: int) -> dict[str, Any]:
    return {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate_hz,
        "splits": {"train": f"0:{episodes}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }


def _arrow(feature: Mapping[str, Any]) -> pa.DataType:
    """A list of fixed length, or a plain column of what has one number."""
    import pyarrow as pa

    scalar = pa.type_for_alias(feature["dtype"])
    (length,) = feature["shape"]
    return scalar if length == 1 else pa.list_(scalar, length)


def _hugging_face(features: Mapping[str, Any]) -> dict[str, Any]:
    """How the library `datasets` calls these types."""
    found = {}
    for name, feature in features.items():
        value = {"dtype": feature["dtype"], "_type": "Value"}
        (length,) = feature["shape"]
        found[name] = value if length == 1 else {"feature": value, "length": length, "_type": "Sequence"}
    return found


def _as_table(frames: Mapping[str, Numbers], columns: pa.Schema) -> pa.Table:
    import pyarrow as pa

    arrays = []
    for column in columns:
        flat = pa.array(frames[column.name].reshape(-1))
        listed = pa.types.is_fixed_size_list(column.type)
        arrays.append(pa.FixedSizeListArray.from_arrays(flat, type=column.type) if listed else flat)
    return pa.Table.from_arrays(arrays, schema=columns)


def _tasks(task: str) -> pa.Table:
    """The numbers of the tasks, of which the names are the index when pandas reads the file, as LeRobot does."""
    import pyarrow as pa

    index = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    number = {
        "name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64",
        "metadata": None,
    }  # fmt: skip
    about = {"index_columns": ["task"], "column_indexes": [], "columns": [number, index], "creator": {}}
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": pa.array([task], pa.string())})
    return table.replace_schema_metadata({b"pandas": json.dumps(about).encode()})


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False), encoding="utf-8")
