"""`lessbench new-task --view`: the recordings in their scene, before anything is computed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.commands.scene_view import VIEW, view_scene
from pipeline.workspace.project import Project


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    found: list[Path] = []
    monkeypatch.setattr("pipeline.commands.scene_view.open_viewer", found.append)
    return found


def test_the_new_task_is_shown(
    make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch,
    opened: list[Path],
) -> None:  # fmt: skip
    project = make_project(parameters)
    monkeypatch.chdir(project.root)
    words = ["new-task", "pour", "--scene", "gantry.xml", "--recordings", "mine", "--view"]
    answer = CliRunner().invoke(app, words)
    assert answer.exit_code == 0, answer.output
    assert opened == [project.root / VIEW]
    assert opened[0].stat().st_size > 10_000


def test_without_recordings_the_arm_goes_from_start_to_goal(
    make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any], opened: list[Path]
) -> None:
    parameters["tasks"]["sweep"]["recordings"] = "nowhere"
    project = make_project(parameters)
    view_scene(project, "sweep")
    assert opened[0].stat().st_size > 5_000
