"""What the columns of a table mean, as a task says it or as they are called."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import pi
from types import MappingProxyType

UNITS = {"rad": 1.0, "deg": pi / 180, "m": 1.0, "mm": 1e-3}
"""What a unit of positions is in rad or m."""
TIME_UNITS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""What a unit of time is in ns."""


@dataclass(frozen=True)
class ColumnMap:
    """What a task says of the columns of its tables and datasets; None and nothing where it says nothing.

    Attributes:
        time: the column that says when.
        time_unit: of its numbers, a key of `TIME_UNITS`.
        rate_hz: rows per second, of tables without such a column and of HDF5 files.
        joints: the columns that have positions, in order; of an array, what its columns are called.
        unit: of all positions, a key of `UNITS`, or by joint.
        array: the column (Parquet) or array (npz, HDF5) with all positions of a row.
        id: the column that says which recording a row belongs to.
        participant: the column that says whose it is.
    """

    time: str | None = None
    time_unit: str | None = None
    rate_hz: float | None = None
    joints: tuple[str, ...] = ()
    unit: str | Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    array: str | None = None
    id: str | None = None
    participant: str | None = None

    def scale(self, joint: str) -> float:
        """What one unit of a joint's numbers is in rad or m."""
        unit = self.unit if isinstance(self.unit, str) else self.unit.get(joint, "rad")
        return UNITS[unit]
