"""Columns of tables that this process read lately, up to so many bytes for all tables together."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import polars as pl

KEPT_BYTES = 128 << 20
Key = tuple[object, int, str]  # whose table, which part, which column


class KeptColumns:
    """Columns by their keys; beyond the bound, those that were used longest ago are forgotten. Threads may share it."""

    def __init__(self) -> None:
        self._columns = OrderedDict[Key, "pl.Series"]()
        self._bytes = 0.0
        self._lock = threading.RLock()  # a table may be let go of, and forgotten, while this thread holds it

    def get(self, key: Key) -> pl.Series | None:
        """The column, if it is kept."""
        with self._lock:
            if key not in self._columns:
                return None
            self._columns.move_to_end(key)
            return self._columns[key]

    def keep(self, key: Key, column: pl.Series) -> None:
        """Keep a column that was read."""
        with self._lock:
            if key in self._columns:
                return
            self._columns[key] = column
            self._bytes += column.estimated_size()
            while self._bytes > KEPT_BYTES:
                self._bytes -= self._columns.popitem(last=False)[1].estimated_size()

    def forget(self, owner: object) -> None:
        """Forget all columns of a table."""
        with self._lock:
            for key in [key for key in list(self._columns) if key[0] is owner]:
                self._bytes -= self._columns.pop(key).estimated_size()


kept = KeptColumns()
