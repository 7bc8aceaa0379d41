"""One process at a time: a lock that the system lets go when its holder ends, however it ends."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import StageError
from pipeline.formats.files.atomic import cannot_write
from pipeline.formats.files.links import leads_out

_PATIENCE_S, _LOOK_S = 5.0, 0.1  # a stage left behind by its run notices that within half a second
_WIDTH = 10  # of the number of a process, so that one covers another


@contextmanager
def held(path: Path, what: str, root: Path) -> Iterator[None]:
    """Hold the lock `path`, a file that names the process that holds it or held it last.

    The file is neither cut nor replaced, nor reached through a link: a project from elsewhere may have brought it.

    Args:
        path: the file; it is made if it is missing, and stays.
        what: what is being run, for the message.
        root: the folder of the project, which the path must not leave.

    Raises:
        StageError: another process has held the lock for longer than a stage takes to notice that its run has ended;
            or the path leads through a link; or the file cannot be written.
    """
    from filelock import FileLock, Timeout

    if leads_out(root, path):
        raise StageError(f"{path}: a link leads from here out of the project; remove the link and run it again")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, timeout=_PATIENCE_S, poll_interval=_LOOK_S, on_acquired=_sign).acquire()
    except Timeout:
        raise StageError(f"{what}: is being run by {_holder(path)}, and run it again") from None
    except OSError as error:
        raise cannot_write(path, error) from None
    with lock:
        yield


def _sign(descriptor: int) -> None:
    """Put the number of this process into a lock that it holds."""
    if os.fstat(descriptor).st_nlink > 1:
        raise OSError(errno.EMLINK, os.strerror(errno.EMLINK))
    os.pwrite(descriptor, f"{os.getpid():<{_WIDTH}}\n".encode(), 0)


def _holder(path: Path) -> str:
    """Who holds the lock, and what to do about it."""
    with path.open("rb") as stream:
        number = stream.read(_WIDTH).decode("ascii", "replace").strip()
    if not number.isdigit():
        return "another process already; wait until that has ended"
    return f"the process {number} already; wait until that has ended, or end it with `kill {number}`"
