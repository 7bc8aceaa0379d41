"""The forms in which recordings come, and by what a file or folder of each is known."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

Form = Literal["mcap", "sqlite", "ros1", "table", "lerobot", "hdf5"]
BAG_ENDINGS: dict[str, Form] = {".mcap": "mcap", ".db3": "sqlite", ".bag": "ros1"}
TABLE_ENDINGS = (".csv", ".tsv", ".parquet", ".npz")
HDF5_ENDINGS = (".h5", ".hdf5")
COMPRESSED = (".zstd", ".zst")  # of whole files of ROS 2 bags
INDEX = "metadata.yaml"  # what rosbag2 writes beside the files of a bag
INFO = "meta/info.json"  # what LeRobot writes into a dataset


def form_of_file(path: Path) -> Form | None:
    """Which form a file is in, by its ending, in capitals or not; None if in none."""
    ending = path.suffix.lower()
    if ending in COMPRESSED:
        inner = BAG_ENDINGS.get(Path(path.stem).suffix.lower())
        return inner if inner in ("mcap", "sqlite") else None
    if ending in TABLE_ENDINGS:
        return "table"
    return "hdf5" if ending in HDF5_ENDINGS else BAG_ENDINGS.get(ending)


def is_dataset(folder: Path) -> bool:
    """Whether a folder is a dataset of LeRobot."""
    return (folder / INFO).is_file()
