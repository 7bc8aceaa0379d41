"""Two runs at once, and a stage that its run has left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.kills import Undisturbed
from tests.support.small_project import environment, outputs, run

DVC = Path(sys.executable).parent / "dvc"
STAGE, OUTPUT = "density table", "datasets/table/tables/scales.parquet"

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds a stage's process in /proc")


def _start(root: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [DVC, "repro"], cwd=root, env=environment(root), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
    )  # fmt: skip


@pytest.mark.timeout(900)
def test_of_two_runs_at_once_one_waits_or_refuses_and_nothing_is_corrupted(undisturbed: Undisturbed) -> None:
    root = undisturbed.root
    for name in ("scales", "posteriors", "robustness"):
        (root / "datasets" / "table" / "tables" / f"{name}.parquet").unlink()
    both = [_start(root) for _ in range(2)]
    said = [process.communicate(timeout=400)[0] for process in both]
    assert 0 in [process.returncode for process in both], said
    for process, text in zip(both, said, strict=True):
        assert process.returncode == 0 or "lock" in text or "busy" in text or "being run by the process" in text, text
        assert "Traceback" not in text
    run(root, "dvc", "repro")
    assert outputs(root) == undisturbed.outputs


@linux
@pytest.mark.timeout(900)
def test_a_stage_left_behind_writes_nothing_and_holds_back_the_next_run(undisturbed: Undisturbed) -> None:
    root = undisturbed.root
    (root / OUTPUT).unlink()
    process = _start(root)
    orphan = _stage_of(process, root)
    os.kill(orphan, signal.SIGSTOP)
    try:
        process.kill()  # only DVC itself
        process.wait()
        refused = run(root, "lessbench", *STAGE.split(), check=False)
        assert refused.returncode == 1
        assert f"density table: is being run by the process {orphan} already; wait" in refused.stderr
        assert not (root / OUTPUT).exists()
    finally:
        os.kill(orphan, signal.SIGCONT)
    said = process.communicate(timeout=60)[0]  # the orphan has the other end of the pipe: until it has ended
    assert "the `dvc repro` that started this stage has ended" in said
    assert not (root / OUTPUT).exists()
    assert not list((root / "datasets").rglob(".*partial*"))
    run(root, "lessbench", "recover")
    run(root, "dvc", "repro")
    assert outputs(root) == undisturbed.outputs


def _stage_of(process: subprocess.Popen[str], root: Path) -> int:
    """The process of the stage, once it holds its lock."""
    lock = root / ".lessbench" / "locks" / "density@table"
    before = lock.read_text() if lock.exists() else ""
    end = time.monotonic() + 120
    while time.monotonic() < end:
        holder = lock.read_text() if lock.exists() else ""
        if holder not in {"", before}:
            return int(holder)
        time.sleep(0.002)
    raise AssertionError(f"the stage did not begin: {process.poll()}")
