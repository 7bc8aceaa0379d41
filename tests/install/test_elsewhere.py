"""The pipeline in another place, time zone and locale, for one user only, without a network: the same files.

`.ci/install_checks` does the same with whole installations, and with other versions of Python.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.kills import Undisturbed
from tests.support.small_project import environment, make_small_project, outputs

SHELL = """
umask 077
cd "$1" && dvc repro catalog figures@table study-figures
"""


def _without_network() -> list[str]:
    command = ["unshare", "-n"]
    try:
        return command if subprocess.run([*command, "true"], capture_output=True).returncode == 0 else []
    except FileNotFoundError:
        return []


@pytest.mark.timeout(900)
def test_the_same_files_come_out(undisturbed: Undisturbed, tmp_path: Path) -> None:
    root = tmp_path / "Eigene Dateien ä" / "less bench"
    root.parent.mkdir()
    make_small_project(root)
    done = subprocess.run(
        [*_without_network(), "sh", "-c", SHELL, "sh", root],
        env=environment(root) | {"LC_ALL": "C", "LANG": "tr_TR.UTF-8", "TZ": "Pacific/Chatham"},
        capture_output=True, text=True, timeout=800,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    found = outputs(root)
    compared = [name for name in found if name.startswith("datasets/") or name == "catalog"]
    assert len(compared) > 60
    assert {name: found[name] for name in compared} == {name: undisturbed.outputs[name] for name in compared}
    mode = (root / "datasets" / "table" / "tables" / "posteriors.parquet").stat().st_mode
    assert mode & 0o077 == 0
    assert sys.platform != "linux" or os.geteuid() != 0 or _without_network(), "no network namespace for root"
