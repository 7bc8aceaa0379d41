"""Files and folders that appear whole or not at all: written beside, synced, renamed.

Whatever keeps one from being written, a full disk or a folder without permission, ends in one sentence, and what was
there before stays.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

from pipeline.errors import StageError
from pipeline.formats.files.parent_process import require_parent

_PATIENCE_S, _LOOK_S = 5.0, 0.1
_REMEDIES = {
    errno.ENOSPC: "free some space and run it again",
    errno.EDQUOT: "free some of your quota and run it again",
    errno.EFBIG: "raise the limit on the size of a file (`ulimit -f`) and run it again",
    errno.EACCES: "get the permission to write there and run it again",
    errno.EPERM: "get the permission to write there and run it again",
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
    partial, former = (path.with_name(f".{path.name}.{word}") for word in ("partial", "former"))
    with _one_sentence(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if former.exists() and not path.exists():  # killed between the two renames below
            former.replace(path)
        for left in (partial, former):
            shutil.rmtree(left, ignore_errors=True)
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
                shutil.rmtree(left, ignore_errors=True)


@contextmanager
def held(path: Path, what: str) -> Iterator[None]:
    """Hold the lock `path`, which the system lets go when this process ends, however it ends.

    Args:
        path: a file that holds the process id of its last holder.
        what: what is being run, for the message.

    Raises:
        StageError: another process has held it for longer than a stage takes to notice that its run has ended.
    """
    with ExitStack() as stack:
        with _one_sentence(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            lock = stack.enter_context(path.open("a+b", buffering=0))
            _lock(lock, what)
        yield


def _lock(lock: IO[bytes], what: str) -> None:
    for _ in range(int(_PATIENCE_S / _LOOK_S)):
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_LOOK_S)
        else:
            lock.truncate(0)
            lock.write(str(os.getpid()).encode())
            return
    lock.seek(0)
    holder = lock.read().decode() or "unknown"
    raise StageError(
        f"{what}: is being run by the process {holder} already; wait until that has ended, or end it with "
        f"`kill {holder}`, and run it again"
    )


def require_space(path: Path, size: int) -> None:
    """Refuse to write `path` where `size` bytes do not fit; for libraries that do not notice a full disk.

    Raises:
        StageError: there is less space.
    """
    if shutil.disk_usage(path.parent).free < size:
        raise cannot_write(path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))


def cannot_write(path: Path, error: OSError) -> StageError:
    """What to say of an error of the system while writing `path`."""
    remedy = _REMEDIES.get(error.errno or 0, "mend that and run it again")
    reason = (error.strerror or str(error)).lower()
    return StageError(f"{path}: cannot be written ({reason}); {remedy}; what was there before is unchanged")


@contextmanager
def _one_sentence(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from None


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
