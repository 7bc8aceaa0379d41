"""`lessbench new-task` adds a task to params.yaml, and to the stages of dvc.yaml that wait for every task."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.commands.new_task import add_task
from pipeline.stages.dvc_yaml import dvc_yaml
from pipeline.workspace.project import Project


@pytest.fixture
def project(make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any]) -> Project:
    made = make_project(parameters)
    (made.root / "dvc.yaml").write_text(dvc_yaml(made.params))
    return made


def added(project: Project, name: str) -> str:
    return "\n".join(add_task(project, name, project.root / "gantry.xml", project.root / "mine", None))


def test_dvc_yaml_is_then_as_the_registry_writes_it(project: Project) -> None:
    file = project.root / "dvc.yaml"
    before = file.read_text()
    assert "dvc repro inspect@pour" in added(project, "pour").splitlines()[-1]
    after = file.read_text()
    assert after == dvc_yaml(Project(project.root).params)
    assert "datasets/pour/tables" in after
    assert "datasets/pour/figures/posterior.svg" in after
    start = before.index("  catalog:")
    assert after[:start] == before[:start]


def test_stages_of_ones_own_stay(project: Project) -> None:
    file = project.root / "dvc.yaml"
    file.write_text(file.read_text().replace("stages:\n", "stages:\n  mine:\n    cmd: echo\n"))
    added(project, "pour")
    assert file.read_text() == dvc_yaml(Project(project.root).params).replace(
        "stages:\n", "stages:\n  mine:\n    cmd: echo\n"
    )


def test_a_catalog_changed_by_hand_is_left_alone_and_said(project: Project) -> None:
    file = project.root / "dvc.yaml"
    mine = file.read_text().replace("datasets/sweep/tables, ", "")
    file.write_text(mine)
    assert "write it anew with that command, or add the task to its last stages by hand" in added(project, "pour")
    assert file.read_text() == mine
    assert "pour" in Project(project.root).params.tasks


def test_without_dvc_there_is_nothing_to_say(project: Project) -> None:
    (project.root / "dvc.yaml").unlink()
    assert "dvc.yaml" not in added(project, "pour")
    assert not Path(project.root / "dvc.yaml").exists()
