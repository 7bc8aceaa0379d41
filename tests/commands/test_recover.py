"""A dvc.lock that is cut off anywhere is put back, and one that is whole is left alone."""

from __future__ import annotations

import fcntl
import shutil
import subprocess
from pathlib import Path

import pytest

from pipeline.commands.recover import recover
from pipeline.errors import StageError
from pipeline.workspace.project import Project
from tests.support.kills import Undisturbed
from tests.support.small_project import ROOT, environment, run

LOCK = """schema: '2.0'
stages:
  a:
    cmd: echo x > a
    outs:
    - path: a
      hash: md5
      md5: 401b30e3b8b5d629635a5c613cdb7919
      size: 2
"""


@pytest.fixture
def project(tmp_path: Path) -> Project:
    (tmp_path / ".dvc" / "tmp").mkdir(parents=True)
    (tmp_path / ".git").mkdir()
    (tmp_path / ".lessbench").mkdir()
    (tmp_path / "dvc.lock").write_text(LOCK)
    return Project(tmp_path)


@pytest.mark.parametrize("link", ["tmp", "tmp/lock"])
def test_nothing_is_opened_through_a_link_out_of_the_project(tmp_path: Path, link: str) -> None:
    root, outside = tmp_path / "received", tmp_path / "outside"
    outside.mkdir()
    (root / ".dvc" / link).parent.mkdir(parents=True)
    (root / ".dvc" / link).symlink_to(outside if link == "tmp" else outside / "lock")
    with pytest.raises(StageError, match="a link leads from here out of the project"):
        recover(Project(root))
    assert not list(outside.iterdir())


def test_what_is_whole_is_left_alone(project: Project) -> None:
    (project.root / ".dvc" / "tmp" / "rwlock").write_text("{}")
    assert recover(project) == []
    assert (project.root / "dvc.lock").read_text() == LOCK
    assert (project.root / ".dvc" / "tmp" / "rwlock").exists()


@pytest.mark.parametrize("length", [0, 5, 30, 60, 100])
def test_a_cut_lock_is_put_back_or_removed(project: Project, length: int) -> None:
    lock, kept = project.root / "dvc.lock", project.root / ".lessbench" / "dvc.lock"
    lock.write_text(LOCK[:length])
    kept.write_text(LOCK)
    assert recover(project) == ["dvc.lock was cut off; the last whole one is back, and what ran since then runs again"]
    assert lock.read_text() == LOCK
    lock.write_text(LOCK[:length])
    assert recover(project) == ["dvc.lock was cut off and is removed; every stage runs again"]
    assert not lock.exists()


def test_a_cut_list_of_users_is_removed(project: Project) -> None:
    users = project.root / ".dvc" / "tmp" / "rwlock"
    users.write_text('{"read": {')
    assert recover(project) == [".dvc/tmp/rwlock was cut off and is removed"]
    assert not users.exists()


def test_nothing_is_touched_while_dvc_is_at_work(project: Project) -> None:
    (project.root / "dvc.lock").write_text("")
    with (project.root / ".dvc" / "tmp" / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(StageError, match="dvc is at work here"):
            recover(project)
    assert (project.root / "dvc.lock").read_text() == ""


@pytest.mark.timeout(900)
def test_a_project_from_an_archive_says_what_to_type_and_works(undisturbed: Undisturbed, tmp_path: Path) -> None:
    root = tmp_path / "unpacked"
    shutil.copytree(undisturbed.root, root)
    config = root / ".dvc" / "config"
    config.write_text(config.read_text().replace("    no_scm = true\n", ""))
    refused = run(root, "dvc", "repro", check=False)
    assert refused.returncode != 0
    assert "is not a git repository" in refused.stderr  # DVC's own words, which the README explains
    assert "`is not a git repository`: `lessbench recover`" in (ROOT / "README.md").read_text()
    shutil.copy(ROOT / "Makefile", root)
    made = subprocess.run(
        ["make", "-o", ".venv/installed", "repro"],
        cwd=root, env=environment(root), capture_output=True, text=True, timeout=400, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stdout + made.stderr
    assert "this folder is in no git repository, and dvc now works without one" in made.stdout
    assert run(root, "dvc", "status").stdout.strip() == "Data and pipelines are up to date."
    assert recover(Project(root)) == []
    assert not config.read_text().count("no_scm")


def test_a_folder_without_dvc_is_left_alone(tmp_path: Path) -> None:
    assert recover(Project(tmp_path)) == []
    assert not (tmp_path / ".dvc").exists()
