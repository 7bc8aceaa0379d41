"""A stage that DVC started ends when DVC ends: what is left of a killed run must not write into the next one."""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress

from pipeline.errors import StageError
from pipeline.terminal import say

BY_DVC = "DVC_STAGE" in os.environ
_SHELLS = {"sh", "bash", "dash", "zsh", "fish", "ksh"}
_LOOK_S = 0.5


def _lineage() -> tuple[object, ...]:
    """The parent process, and its own parent if it is the shell that DVC starts a command with.

    A process is equal to another if it has the same number and began at the same time.
    """
    import psutil

    parent = psutil.Process().parent()
    with suppress(psutil.Error):  # the parent has just ended, or its name is a secret
        if parent is not None and parent.name() in _SHELLS:
            return parent, parent.parent()
    return (parent,)


_STARTED_BY = _lineage() if BY_DVC else ()


def require_parent() -> None:
    """Go on only if the run that this process belongs to still exists.

    Raises:
        StageError: DVC started this stage and has ended.
    """
    if _orphaned():
        raise StageError("the `dvc repro` that started this stage has ended, so nothing was written; run it again")


def end_with_parent() -> None:
    """From now on, end this process as soon as the DVC that started it is gone. Files appear whole: nothing is torn."""
    if BY_DVC:
        threading.Thread(target=_watch, name="end-with-parent", daemon=True).start()


def _watch() -> None:
    while not _orphaned():
        time.sleep(_LOOK_S)
    say("lessbench: the `dvc repro` that started this stage has ended; so does the stage", error=True)
    os._exit(1)


def _orphaned() -> bool:
    return BY_DVC and _lineage() != _STARTED_BY
