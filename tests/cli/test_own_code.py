"""What runs is what DVC records: a project's own code, or nothing, wherever `lessbench` was installed from."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from tests.support.small_project import ROOT, TASK, environment, make_small_project

OUTPUT = Path("datasets") / TASK / "scene.json"


def set_mark(root: Path, mark: str) -> None:
    """Let the project's own code say in scene.json who wrote it."""
    file = root / "pipeline" / "stages" / "scene.py"
    text = (ROOT / "pipeline" / "stages" / "scene.py").read_text(encoding="utf-8")
    file.write_text(text.replace("        about = {\n", f'        about = {{\n            "mark": "{mark}",\n'))


def mark(root: Path) -> object:
    return json.loads((root / OUTPUT).read_text(encoding="utf-8")).get("mark")


def run(root: Path, *command: str, check: bool = True, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run a command in the project with the code of this repository installed, and no settings but the folder's own."""
    own = environment(root) | {
        "PYTHONPATH": str(ROOT),
        "GIT_CONFIG_GLOBAL": os.devnull,
        "GIT_CONFIG_SYSTEM": os.devnull,
    }
    for who in ("AUTHOR", "COMMITTER"):
        own |= {f"GIT_{who}_NAME": "someone", f"GIT_{who}_EMAIL": "someone@here"}
    for place in ("GLOBAL", "SYSTEM"):
        own[f"DVC_{place}_CONFIG_DIR"] = str(root / ".dvc" / "none")
    program = shutil.which(command[0], path=own["PATH"])
    done = subprocess.run(
        [str(program), *command[1:]],
        cwd=root,
        env=own | changes,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert not check or done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture
def received(tmp_path: Path) -> Path:
    """A project with code of its own, whose one stage is `scene`, as a git repository."""
    root = tmp_path / "a project"
    make_small_project(root)
    set_mark(root, "committed")
    text = (root / "dvc.yaml").read_text(encoding="utf-8")
    (root / "dvc.yaml").write_text(text[: text.index("  simulate:")], encoding="utf-8")
    for name in (".gitignore", ".dvc/.gitignore"):
        shutil.copy(ROOT / name, root / name)
    config = (root / ".dvc" / "config").read_text()
    (root / ".dvc" / "config").write_text(config.replace("no_scm = true", "autostage = false"))
    run(root, "git", "init", "-q")
    run(root, "git", "add", "-A")
    run(root, "git", "commit", "-qm", "small")
    return root


def test_dvc_runs_the_code_that_it_records(received: Path) -> None:
    run(received, "dvc", "repro")
    assert mark(received) == "committed"


def test_at_a_prompt_it_is_refused_and_what_is_said_works(received: Path) -> None:
    (received / "pipeline" / "__init__.py").write_text("open('ran', 'w')\n")
    for name in ({}, {"DVC_ROOT": str(received.parent)}, {"DVC_ROOT": "/elsewhere"}):
        refused = run(received, "lessbench", "scene", TASK, check=False, **name)
        assert refused.returncode == 1
        assert refused.stderr.count("\n") == 1
        assert f"{received} has a pipeline/ of its own" in refused.stderr
        assert f"runs that of {ROOT}" in refused.stderr
        assert not (received / OUTPUT).exists()
        assert not (received / "ran").exists()
    (told,) = re.findall("`(.+)`", refused.stderr)
    run(received, "sh", "-c", told)
    assert mark(received) == "committed"


def test_it_does_not_begin_anew_for_ever(received: Path) -> None:
    said = run(
        received, "lessbench", "scene", TASK, check=False, DVC_ROOT=str(received), LESSBENCH_SWITCHED=str(received)
    )
    assert said.returncode == 1
    assert "has a pipeline/ of its own" in said.stderr


def test_the_project_it_was_installed_from_and_one_without_code(received: Path, tmp_path: Path) -> None:
    set_mark(received, "own")
    run(received, "lessbench", "scene", TASK, PYTHONPATH=str(received))
    assert mark(received) == "own"
    shutil.rmtree(received / "pipeline")
    run(received, "lessbench", "scene", TASK)
    assert mark(received) is None


@pytest.mark.timeout(600)
def test_experiments_run_the_code_that_was_queued(received: Path) -> None:
    run(received, "dvc", "repro")
    run(received, "git", "add", "dvc.lock")
    run(received, "git", "commit", "-qm", "computed")
    set_mark(received, "tried apart")
    run(received, "dvc", "exp", "run", "--temp", "-n", "apart")
    set_mark(received, "queued")
    run(received, "dvc", "exp", "run", "--queue", "-n", "later")
    run(received, "git", "checkout", "-q", "pipeline")
    run(received, "dvc", "queue", "start")
    try:
        end = time.monotonic() + 150
        while "Success" not in (said := run(received, "dvc", "queue", "status").stdout):
            assert "Failed" not in said, run(received, "dvc", "queue", "logs", "later", check=False).stdout
            assert time.monotonic() < end, said
            time.sleep(1)
    finally:
        run(received, "dvc", "queue", "stop", "--kill", check=False)
    assert mark(received) == "committed"
    for name, expected in (("apart", "tried apart"), ("later", "queued")):
        run(received, "dvc", "exp", "apply", name)
        assert mark(received) == expected
