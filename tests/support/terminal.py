"""A terminal of 100 columns, and what it is shown."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from pathlib import Path

import pytest

pty = pytest.importorskip("pty", reason="pseudo-terminals are a matter of Unix")


def on_a_terminal(folder: Path, *words: str, env: dict[str, str] | None = None, typed: bytes = b"") -> str:
    """What a terminal is shown by Python with these words, run in a folder, while something is typed."""
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "30", "PAGER": "cat"} | (env or {})
    process = subprocess.Popen(
        [sys.executable, *words], cwd=folder, env=environment, stdin=theirs, stdout=theirs, stderr=theirs
    )
    os.close(theirs)
    os.write(ours, typed)
    shown = b""
    while process.poll() is None or select.select([ours], [], [], 0)[0]:
        if select.select([ours], [], [], 0.1)[0]:
            try:
                shown += os.read(ours, 1 << 16)
            except OSError:  # Linux says so when the other side is closed
                break
    os.close(ours)
    assert process.wait(10) == 0, shown.decode()
    return shown.decode()
