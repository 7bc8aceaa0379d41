"""The commands that docs/recordings.md shows run, on a smaller project."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.stages import density, featurize, infer, ingest, sample
from pipeline.workspace.project import Project

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"(?ms)^```sh\n(.*?)^```$", PAGE)
COMMANDS = [line.split("#")[0].strip() for block in BLOCKS for line in block.splitlines()]
ENDS = {"watch": ["--idle-s", "1"], "view": [], "inspect": [], "infer": []}


@pytest.fixture
def project(make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any]) -> Project:
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")
    return project


def test_every_command_of_the_page_runs(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(project.root)
    opened: list[Path] = []
    monkeypatch.setattr("pipeline.views.rerun.recording.open_viewer", opened.append)
    monkeypatch.setattr("pipeline.views.rerun.server.has_display", lambda: False)
    for name in ("datasets/sweep/recordings", "my_recordings"):
        (project.root / name).parent.mkdir(exist_ok=True)
        (project.root / name).symlink_to(project.root / "mine")
    assert len(COMMANDS) == 6
    for command in COMMANDS:
        words = shlex.split(command.replace("table", "sweep"))
        live = ["--port", "0"] if "--live" in words else []
        answer = CliRunner().invoke(app, [*words[1:], *live, *ENDS[words[1]]])
        assert answer.exit_code == 0, (command, answer.output, answer.exception)
    assert opened == [project.datasets / "sweep" / "inspect.rrd"]
    assert (project.datasets / "sweep" / "watch" / "posteriors.parquet").is_file()


def test_options_that_the_page_names_are_there() -> None:
    for command in ("inspect", "infer", "watch"):
        answer = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"})
        assert answer.exit_code == 0
        assert {"--live", "--port", "--bind"} <= set(re.findall(r"--[\w-]+", answer.output))
        assert ("--stay" in answer.output) == (command != "watch")
        assert ("--idle-s" in answer.output) == (command == "watch")
