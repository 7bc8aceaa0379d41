"""A full disk, a folder that is read-only, a limit on files: one sentence, exit status 1, and all is as it was."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.kills import Undisturbed
from tests.support.small_project import environment, outputs, run

STAGES = (
    "simulate table",
    "sample table",
    "figures table",
    "inspect table",
    "catalog",
)  # each with a writer of its own
needs_mounts = pytest.mark.skipif(
    not sys.platform.startswith("linux")
    or os.geteuid() != 0
    or subprocess.run(["unshare", "-m", "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True).returncode != 0,
    reason="a disk of its own can be mounted by root only, where the system allows it",
)
FULL = """
set -e
mount -t tmpfs -o size=512m tmpfs "$1"; cp -r "$2/." "$1"; cd "$1"
set +e
head -c 512m /dev/zero > filler 2>/dev/null
for stage in {stages}; do
    echo "@@ $stage"; eval lessbench $(echo "$stage" | tr _ ' ') 2>&1; echo "status $?"
done
rm filler; cp -r datasets "$3"
"""
READ_ONLY = """
set -e
mount --bind "$1/datasets" "$1/datasets"; mount -o remount,ro,bind "$1/datasets"; cd "$1"
set +e
for stage in {stages}; do
    echo "@@ $stage"; eval lessbench $(echo "$stage" | tr _ ' ') 2>&1; echo "status $?"
done
"""


def _said(script: str, root: Path, *arguments: Path) -> dict[str, list[str]]:
    """What each stage said in a mount namespace of its own."""
    script = script.format(stages=" ".join(stage.replace(" ", "_") for stage in STAGES))
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", script, "sh", *arguments],
        env=environment(root) | {"COLUMNS": "1000"}, capture_output=True, text=True, timeout=800,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    parts = done.stdout.split("@@ ")[1:]
    return {part.splitlines()[0]: part.splitlines()[1:] for part in parts}


def _expect_one_sentence(said: dict[str, list[str]], why: str) -> None:
    assert len(said) == len(STAGES)
    for stage, lines in said.items():
        *sentences, status = [line for line in lines if line.startswith(("lessbench: ", "status ", "Traceback"))]
        assert status == "status 1", (stage, lines)
        assert len(sentences) == 1, (stage, lines)
        assert why in sentences[0], (stage, lines)
        assert "what was there before is unchanged" in sentences[0], (stage, lines)


@needs_mounts
@pytest.mark.timeout(900)
def test_a_full_disk(undisturbed: Undisturbed, tmp_path: Path) -> None:
    root, disk = undisturbed.root, tmp_path / "disk"
    disk.mkdir()
    said = _said(FULL, disk, disk, root, tmp_path)
    _expect_one_sentence(said, "no space left on device")
    before = {name: digest for name, digest in undisturbed.outputs.items() if name.startswith("datasets")}
    after = outputs(tmp_path)
    assert {name: after.get(name) for name in before} == before
    assert not [name for name in after if "/." in name], "something half-written was left"


@needs_mounts
@pytest.mark.timeout(900)
def test_a_read_only_folder(undisturbed: Undisturbed) -> None:
    said = _said(READ_ONLY, undisturbed.root, undisturbed.root)
    _expect_one_sentence(said, "read-only file system")
    assert outputs(undisturbed.root) == undisturbed.outputs


def test_a_limit_on_the_size_of_a_file(undisturbed: Undisturbed) -> None:
    root = undisturbed.root
    done = subprocess.run(
        [Path(sys.executable).parent / "lessbench", "sample", "table"],
        cwd=root, env=environment(root), capture_output=True, text=True, timeout=200,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000)),
    )  # fmt: skip
    assert done.returncode == 1
    assert "alternatives.parquet: cannot be written (file too large); raise the limit" in done.stderr
    assert outputs(root) == undisturbed.outputs


def test_a_lost_cache_loses_nothing(undisturbed: Undisturbed, tmp_path: Path) -> None:
    root, lost = undisturbed.root, (".dvc/cache", ".dvc/tmp", ".dvc/site", ".lessbench")
    for place, name in enumerate(lost):
        (root / name).rename(tmp_path / str(place))
    (root / "datasets" / "table" / "tables" / "scales.parquet").unlink()
    said = run(root, "dvc", "repro", "--single-item", "density@table").stdout
    assert "density@table" in said
    assert outputs(root) == undisturbed.outputs
    for place, name in enumerate(lost):
        shutil.rmtree(root / name, ignore_errors=True)
        (tmp_path / str(place)).rename(root / name)
