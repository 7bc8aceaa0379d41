"""The commands that docs/bring-your-own.md shows run, in its order, from files to a posterior and back."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.params.paths import value_at
from pipeline.stages.dvc_yaml import FOREACH
from pipeline.stages.registry import STAGES, Scope
from pipeline.workspace.project import Project

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "bring-your-own.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"(?ms)^```sh\n(.*?)^```$", PAGE)
COMMANDS = [line.split("#")[0].strip() for block in BLOCKS for line in block.splitlines()]
URDF = """<robot name="gantry"><link name="base"/><link name="carriage"/><link name="upper"/><link name="fore"/>
<link name="tip"/>{}<joint name="fixed" type="fixed"><parent link="fore"/><child link="tip"/>
<origin xyz="0.3 0 0"/></joint></robot>"""
JOINT = """<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="{}"/><axis xyz="{}"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>"""
JOINTS = (
    ("rail", "prismatic", "base", "carriage", "0 0 0.5", "1 0 0"),
    ("swing", "continuous", "carriage", "upper", "0 0 0", "0 0 1"),
    ("bend", "revolute", "upper", "fore", "0.4 0 0", "0 1 0"),
)


@pytest.fixture
def project(make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any]) -> Project:
    """The small project, with the files that the page speaks of."""
    made = make_project(parameters)
    (made.root / "mine").rename(made.root / "my_recordings")
    shutil.copy(made.root / "gantry.xml", made.root / "my_scene.xml")
    (made.root / "my_arm.urdf").write_text(URDF.format("".join(JOINT.format(*one) for one in JOINTS)))
    return made


def repro(project: Project, name: str, task: str) -> None:
    """What `dvc repro NAME@TASK` runs: the stages of the task up to this one that make what it reads."""
    fresh, wanted = Project(project.root), {name}
    for one in reversed(STAGES):
        if one.name in wanted and one.scope is Scope.TASK:
            wanted |= {other.name for other in STAGES if set(other.makes) & set(one.reads)} | {"scene"}
            assert value_at(fresh.params, FOREACH[one.scope].strip("${}"))[task]
    for one in STAGES:
        if one.name in wanted and one.scope is Scope.TASK:
            one.run(fresh, task)


def test_every_command_of_the_page_runs(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(project.root)
    opened: list[Path] = []
    monkeypatch.setattr("pipeline.views.rerun.recording.open_viewer", opened.append)
    assert len(COMMANDS) == 13
    for command in COMMANDS:
        program, *words = shlex.split(command)
        if program == "dvc":
            assert words[0] == "repro"
            repro(project, *words[1].split("@"))
            continue
        files = [str(path) for word in words for path in sorted(project.root.glob(word)) if "*" in word]
        answer = CliRunner().invoke(app, [word for word in words if "*" not in word] + files)
        assert answer.exit_code == 0, (command, answer.output, answer.exception)
        if words[:2] == ["new-task", "pour"]:
            assert entry((project.root / "params.yaml").read_text()) == entry(PAGE)
        if words[0] == "sql":
            assert "2 rows" in answer.output
            assert "less" in answer.output
    assert opened == [project.datasets / "pour" / "inspect.rrd"]
    assert list(Project(project.root).params.tasks) == ["sweep", "wipe"]
    assert not (project.datasets / "pour").exists()


def entry(text: str) -> str:
    found = re.search(r"(?m)^  pour:\n(?:    .*\n)+", text)
    assert found is not None
    return found[0]


def test_the_sentences_of_the_page_are_those_of_the_command() -> None:
    source = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "pipeline" / "commands").glob("*.py"))
    for begin in (
        "Joints of the arm: ",
        "Left out, and kept at home: ",
        "The recordings call them otherwise: ",
        "Anchor: ",
    ):
        assert begin in PAGE
        assert begin in source
