"""Files and folders that appear whole or not at all: written beside, synced, renamed.

Whatever keeps one from being written, a full disk or a folder without permission, ends in one sentence, and what was
there before stays.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from pipeline.errors import StageError
from pipeline.formats.files.links import require_inside
from pipeline.formats.files.parent_process import require_parent

_REMEDIES = {
    errno.ENOSPC: "free some space and run it again",
    errno.EDQUOT: "free some of your quota and run it again",
    errno.EFBIG: "raise the limit on the size of a file (`ulimit -f`) and run it again",
    errno.EACCES: "get the permission to write there and run it again",
    errno.EPERM: "get the permission to write there and run it again",
    errno.ELOOP: "remove the link and run it again",
    errno.EMLINK: "remove it, for it is also a file of another name, and run it again",
    errno.EROFS: "make it writable, or copy the project to where you can write, and run it again",
}


@contextmanager
def written_whole(path: Path) -> Iterator[IO[bytes]]:
    """A binary file that takes the place of `path` only once it is complete.

    Raises:
        StageError: it cannot be written; what was at `path` is unchanged.
    """
    with path_written_whole(path) as partial, partial.open("wb") as stream:
        yield stream


@contextmanager
def path_written_whole(path: Path) -> Iterator[Path]:
    """The path of a new file, which takes the place of `path` only once it is complete; for libraries that open files.

    Raises:
        StageError: it cannot be written; what was at `path` is unchanged.
    """
    require_inside(path)
    partial = path.with_name(f".{path.name}.partial")
    with _one_sentence(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        try:
            yield partial
            _sync(partial)
            require_parent()
            partial.replace(path)
            _sync(path.parent)
        finally:
            partial.unlink(missing_ok=True)


@contextmanager
def folder_written_whole(path: Path) -> Iterator[Path]:
    """A new folder that takes the place of `path`, with all that was in it, only once it is complete.

    Raises:
        StageError: it cannot be written; what was at `path` is unchanged.
    """
    require_inside(path)
    partial, former = (path.with_name(f".{path.name}.{word}") for word in ("partial", "former"))
    with _one_sentence(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if former.exists() and not path.exists():  # killed between the two renames below
            former.replace(path)
        for left in (partial, former):
            _remove(left)
        partial.mkdir()
        try:
            yield partial
            for written in (*partial.rglob("*"), partial):
                _sync(written)
            require_parent()
            if path.exists():
                path.replace(former)
            partial.replace(path)
            _sync(path.parent)
        finally:
            if former.exists() and not path.exists():
                former.replace(path)
            for left in (partial, former):
                _remove(left)


def require_space(path: Path, size: int) -> None:
    """Refuse to write `path` where `size` bytes do not fit; for libraries that do not notice a full disk.

    Raises:
        StageError: there is less space.
    """
    if shutil.disk_usage(path.parent).free < size:
        raise cannot_write(path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))


def cannot_write(path: Path, error: OSError) -> StageError:
    """What to say of an error of the system while writing `path`."""
    remedy = _REMEDIES.get(error.errno or 0, "correct that and run it again")
    reason = (error.strerror or str(error)).lower()
    return StageError(f"{path}: cannot be written ({reason}); {remedy}; what was there before is unchanged")


@contextmanager
def _one_sentence(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from None


def _remove(path: Path) -> None:
    """Remove a folder, or the link that stands for one, but not what it leads to."""
    if path.is_symlink():
        path.unlink()
    else:
        shutil.rmtree(path, ignore_errors=True)


def _sync(path: Path) -> None:
    """Bring a file, or the names in a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some file systems cannot sync folders
            raise
    finally:
        os.close(descriptor)
