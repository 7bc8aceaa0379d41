"""Tables for the jobs of a fold, which may run on another machine: opened once in each process that reads them."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import TableError
from pipeline.formats.parquet.checked.open_table import OpenTable

OPEN_AT_ONCE = 8  # tables that a process keeps open for jobs; of more, those that were used longest ago are let go of


@dataclass(frozen=True)
class TableFile:
    """Which table a job reads: a small record that is the same on every machine.

    Attributes:
        path: of the file.
        name: of its schema.
        digest: of the file as the stage opened it.
    """

    path: Path
    name: str
    digest: str

    def table(self) -> OpenTable:
        """The open table: that of the stage in its own process; on a worker, the one that is opened there once.

        Raises:
            TableError: the file is missing, is no such table, or is not the one that the stage opened.
        """
        with _lock:
            if self not in _open:
                table = OpenTable(self.path, self.name)
                if table.digest != self.digest:
                    raise TableError(f"{self.path}: has changed since the stage began to read it; run the stage again")
                _open[self] = table
            _open.move_to_end(self)
            while len(_open) > OPEN_AT_ONCE:
                _open.popitem(last=False)  # its file is closed when the last job that reads it is done
            return _open[self]


def share(table: OpenTable) -> TableFile:
    """Let jobs in this process read a table that is open, until `unshare`."""
    file = TableFile(table.path, table.contract.name, table.digest)
    with _lock:
        _open[file] = table
    return file


def unshare(file: TableFile) -> None:
    """Let go of a table before it is closed."""
    with _lock:
        _open.pop(file, None)


_open = OrderedDict[TableFile, OpenTable]()
_lock = threading.Lock()
