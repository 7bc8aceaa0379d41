"""Recordings that appear in a folder while it is watched: seen once they are whole, and again when they change."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.formats.mcap.container import is_recording

MAGIC = b"\x89MCAP0\r\n"
PATIENCE = 20
"""How many looks a file that is not closed may stay the same until that is worth a word."""

Signature = tuple[int, int, int]


@dataclass(frozen=True)
class News:
    """What a look at the folder found.

    Attributes:
        whole: recordings that are new or changed, and complete, in the order of their names.
        gone: recordings that were seen before and are no longer there.
        waiting: recordings that have stopped growing without being closed; each is told once until it changes.
    """

    whole: tuple[Path, ...]
    gone: tuple[Path, ...]
    waiting: tuple[Path, ...]


@dataclass
class Arrivals:
    """The recordings of a folder.

    A file is whole when its size and time are those of the look before, and it ends as a closed MCAP file does. What
    does not begin as one is no recording, will never end as one, and is not waited for.

    Attributes:
        folder: what is watched; it may appear later.
    """

    folder: Path
    _taken: dict[Path, Signature] = field(default_factory=dict)
    _before: dict[Path, Signature] = field(default_factory=dict)
    _same: dict[Path, int] = field(default_factory=dict)

    @property
    def open(self) -> tuple[Path, ...]:
        """Recordings that were there at the last look and are not whole yet."""
        return tuple(path for path in sorted(self._before) if self._taken.get(path) != self._before[path])

    def look(self) -> News:
        """Look at the folder once."""
        there = sorted(filter(is_recording, self.folder.iterdir())) if self.folder.is_dir() else []
        now = {path: signature for path in there if (signature := _signature(path))}
        whole, waiting = [], []
        for path, signature in now.items():
            if self._taken.get(path) == signature:
                continue
            self._same[path] = self._same.get(path, 0) + 1 if self._before.get(path) == signature else 0
            if self._same[path] == 0:
                continue
            if _complete(path):
                self._taken[path] = signature
                whole.append(path)
            elif self._same[path] == PATIENCE:
                waiting.append(path)
        gone = tuple(path for path in self._taken if path not in now)
        for path in gone:
            del self._taken[path]
        self._before = now
        return News(tuple(whole), gone, tuple(waiting))


def _signature(path: Path) -> Signature | None:
    try:
        found = path.stat()
    except OSError:  # gone between the listing and now
        return None
    return found.st_size, found.st_mtime_ns, found.st_ino


def _complete(path: Path) -> bool:
    """Whether nothing more is to come: it is closed, or it is no MCAP file."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            return True
        with path.open("rb") as stream:
            if not MAGIC.startswith(stream.read(len(MAGIC))):
                return True
            size = stream.seek(0, os.SEEK_END)
            if size < 2 * len(MAGIC):
                return False
            stream.seek(-len(MAGIC), os.SEEK_END)
            return stream.read() == MAGIC
    except OSError:
        return True
