"""The files of databases, whatever their folders are called and whatever lies beside them.

DuckDB takes what follows a `?` anywhere in a path for options. And it reads `NAME.wal` beside the file `NAME` as a part
of it: one that another program left behind keeps the database from being opened, or adds to what is in it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pipeline.formats.files.atomic import path_written_whole

_ASIDE = "lessbench-"  # begins the name of a temporary folder


@contextmanager
def new_database(path: Path) -> Iterator[Path]:
    """Where to create a database that takes the place of `path` once it is complete, no log of changes beside it.

    Raises:
        StageError: it cannot be written; what was at `path` is unchanged.
    """
    with path_written_whole(path) as partial:
        if "?" in str(partial.resolve()):
            with TemporaryDirectory(prefix=_ASIDE) as folder:
                yield Path(folder) / path.name
                shutil.copyfile(Path(folder) / path.name, partial)
        else:
            try:
                yield partial
            finally:
                _log(partial).unlink(missing_ok=True)
        _log(path).unlink(missing_ok=True)


@contextmanager
def readable_database(path: Path) -> Iterator[Path]:
    """Where the database at `path` can be opened for reading, no log of changes beside it."""
    path = path.resolve()
    if "?" not in str(path) and not _log(path).exists():
        yield path
        return
    with TemporaryDirectory(prefix=_ASIDE) as folder:
        aside = Path(folder) / path.name
        try:
            os.link(path, aside)
        except OSError:  # another disk, or somebody else's file
            shutil.copyfile(path, aside)
        yield aside


def _log(path: Path) -> Path:
    return path.with_name(f"{path.name}.wal")
