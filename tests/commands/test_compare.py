"""`lessbench compare`: what differs between two versions, and no more; versions that cannot be read are said."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from pipeline.commands.compare import RECORDING, Wanted, changed_parameters, run
from pipeline.errors import ParameterError, StageError
from pipeline.views.rerun.comparison import Compared, write_comparison
from pipeline.workspace.project import Project
from pipeline.workspace.versions import version
from tests.support.kills import Undisturbed
from tests.support.small_project import ROOT, TASK, environment

GIT = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]


def change(root: Path) -> None:
    """Another grid of beta, and what follows from it."""
    yaml = YAML(typ="safe", pure=True)
    params = yaml.load((root / "params.yaml").read_text())
    params["infer"]["betas"] = [0.3, 1, 3]
    with (root / "params.yaml").open("w") as stream:
        yaml.dump(params, stream)
    for stage in ("infer", "explore", "conclude"):
        command = [sys.executable, "-m", "pipeline", "--quiet", stage, TASK]
        subprocess.run(command, cwd=root, env=environment(root), check=True, capture_output=True, timeout=200)


@pytest.fixture(scope="module")
def changed(undisturbed: Undisturbed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in git whose parameters and results have changed since the last commit."""
    root = tmp_path_factory.mktemp("compare") / "project"
    shutil.copytree(undisturbed.root, root, ignore=shutil.ignore_patterns("recordings"))
    shutil.copy(ROOT / ".gitignore", root)
    (root / ".dvc" / "config").write_text("[core]\n    analytics = false\n    check_update = false\n")
    for words in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "before"]):
        subprocess.run([*GIT, *words], cwd=root, check=True)
    change(root)
    return root


@pytest.mark.timeout(900)
def test_a_commit_and_what_is_here_now(
    changed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DVC_SITE_CACHE_DIR", str(changed / ".dvc" / "site"))
    run(Project(changed), Wanted("HEAD", ".", as_json=True))
    said = json.loads(capsys.readouterr().out)
    assert said["parameters"] == [["infer.betas", "[0.3, 3.0, 30.0]", "[0.3, 1.0, 3.0]"]]
    before, now = said["answers"][TASK]
    assert set(before) == set(now)
    assert {"answer", "verdict", "weight of efficiency"} <= set(before)
    run(Project(changed), Wanted("HEAD", "."))
    shown = capsys.readouterr()
    assert "infer.betas" in shown.out
    assert "the same" in shown.out
    assert RECORDING in shown.err
    assert (changed / RECORDING).stat().st_size > 10_000


def test_two_folders_and_two_files(undisturbed: Undisturbed, changed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here = Project(changed)
    run(here, Wanted(str(undisturbed.root), str(changed), TASK, recording=False))
    assert "infer.betas" in capsys.readouterr().out
    (changed / "a.yaml").write_text("ingest: {waypoints: 12}\n")
    run(here, Wanted(str(changed / "a.yaml"), str(changed), recording=False))
    shown = capsys.readouterr()
    assert "ingest.waypoints" in shown.out
    assert "verdict" not in shown.out
    assert "only their parameters are compared" in shown.err


@pytest.mark.parametrize("named", ["no-such-revision", "../..", "HEAD~7", "-x"])
def test_what_is_no_version_is_said(changed: Path, named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(changed)
    with pytest.raises(StageError, match=r"is no (project|folder)"), version(Project(changed), named, ()):
        pass


def test_a_task_that_is_not_there(changed: Path, undisturbed: Undisturbed) -> None:
    with pytest.raises(ParameterError, match="nowhere"):
        run(Project(changed), Wanted(str(undisturbed.root), str(changed), "nowhere"))


def test_differences_of_documents() -> None:
    one, other = {"a": {"b": 1, "c": [1, 2]}, "d": None}, {"a": {"b": 1, "c": [1, 3]}, "e": {"f": 1}}
    assert list(changed_parameters(one, other)) == [("a.c", "[1, 2]", "[1, 3]"), ("e", "", "...")]
    assert list(changed_parameters(one, one)) == []


def test_both_posteriors_are_in_step(tmp_path: Path) -> None:
    """Each step of the timeline has the bars of both versions, the shorter one its last."""
    steps = np.array([[0.5, 0.5], [0.8, 0.2], [0.9, 0.1]])
    compared = Compared("t", ("one", "other"), ("before", "now"), {"less": (steps, steps[:2, ::-1])})
    path = tmp_path / "c.rrd"
    write_comparison(path, [compared])
    command = [Path(sys.executable).with_name("rerun"), "rrd", "print", "-v", path]
    printed = subprocess.run(
        command, check=True, capture_output=True, text=True, env=os.environ | {"CI": "true"}
    ).stdout
    for entity in ("/t/less/before/bars", "/t/less/now/bars", "/t/less/before/other", "/t/less/now/other"):
        assert re.search(rf"with 3 rows \([^)]*\) - {entity} ", printed), entity
