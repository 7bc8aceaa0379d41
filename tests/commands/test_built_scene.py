"""`lessbench new-task --arm`: a scene around an arm, with the keyframes of the recordings, and a task for it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.commands.new_task import Wishes, add_task
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene
from tests.support.gantry_project import GANTRY, record


@pytest.fixture
def project(make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any]) -> Project:
    made = make_project(parameters)
    alone = GANTRY.partition("<keyframe>")[0] + "</mujoco>"
    floor = '<site name="floor" type="box" size="2 2 0.01" pos="0 0 -0.5"/>'
    (made.root / "arm.xml").write_text(alone.replace(floor, ""))
    return made


def lessbench(project: Project, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pipeline", "new-task", "pour", "--arm", "arm.xml", "--recordings", "mine", *words]
    return subprocess.run(command, cwd=project.root, capture_output=True, text=True, timeout=120)


def built(project: Project) -> Path:
    return project.datasets / "scenes" / "pour.xml"


def test_a_table_an_object_and_keyframes(project: Project) -> None:
    done = lessbench(project, "--table", "--object", "cup:0.5,0.1,0.2")
    assert done.returncode == 0, done.stderr
    assert "Scene: datasets/scenes/pour.xml, arm.xml with a table with the site table_top, cup" in done.stdout
    fresh = Project(project.root)
    task = fresh.params.task("pour")
    assert (task.surface, task.anchor, task.end_effector) == ("table_top", "task", "tip")
    assert task.features["cup"] == {"kind": "proximity", "object": "cup", "radius_m": 0.4}
    scene = load_task_scene(fresh, task)
    assert scene.start is not None
    np.testing.assert_allclose(scene.start, (-0.3, -0.6, 0.1), atol=0.02)
    again = lessbench(project)
    assert again.stderr.startswith("lessbench: there is a task 'pour' already")


def test_recordings_with_ends_of_their_own(project: Project) -> None:
    record(project.root / "mine" / "demo-1.mcap", goal=(-0.9, 0.9, 1.2))
    done = lessbench(project)
    assert "It has no keyframes, as the recordings start or end in different places." in done.stdout
    assert Project(project.root).params.task("pour").anchor == "demonstration"


def test_a_scene_without_keyframes_can_have_those_of_the_recordings(project: Project) -> None:
    """With --scene that is said, and doing so works."""
    done = lessbench(project, "--arm", "arm.xml")
    told = add_task(Project(project.root), Wishes("scoop", project.root / "arm.xml", project.root / "mine"))
    (hint,) = [line for line in told if line.startswith("But all recordings start and end in the same places")]
    assert "name the file with --arm in place of --scene" in hint
    assert "Anchor: task, as 3 of 3" in done.stdout
    assert "later changes of arm.xml do not reach it" in done.stdout
    record(project.root / "mine" / "demo-1.mcap", goal=(-0.9, 0.9, 1.2))
    told = add_task(Project(project.root), Wishes("stir", project.root / "arm.xml", project.root / "mine"))
    assert not any(line.startswith("But all recordings") for line in told)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--object", "cup:0.5,0.1"], "write NAME:X,Y,Z in metres"),
        (["--object", "cup:0.5,0.1,inf"], "less than 100 m away"),
        (["--scene", "gantry.xml"], "name either --scene, or --arm"),
        (["--end-effector", "nose"], "no body or site named 'nose'"),
    ],
)
def test_mistakes_leave_nothing_behind(project: Project, words: list[str], message: str) -> None:
    before = (project.root / "params.yaml").read_bytes()
    done = lessbench(project, *words)
    assert done.returncode == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not built(project).exists()
    assert (project.root / "params.yaml").read_bytes() == before
