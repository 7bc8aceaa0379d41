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
from pipeline.formats.recordings.described_states import NAMES, NANOSECONDS, POSITIONS, SECONDS, STAMPS
from pipeline.formats.recordings.forms import BAG_ENDINGS, COMPRESSED, HDF5_ENDINGS, INDEX, INFO, TABLE_ENDINGS
from pipeline.params import Reading
from pipeline.stages import density, featurize, infer, ingest, sample
from pipeline.workspace.project import Project
from pipeline.yaml_text import plain_yaml

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"(?ms)^```sh\n(.*?)^```$", PAGE)
COMMANDS = [line.split("#")[0].strip() for block in BLOCKS for line in block.splitlines()]
ENDS = {"watch": ["--idle-s", "1"], "view": [], "inspect": [], "infer": [], "check": []}
FORMS = re.findall(r"(?m)^\| ([^|]+) \| [^|]+ \| [^|]+ \| [^|]+ \| `(tests/[\w/.]+)::(\w+)` \|$", PAGE)


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
    assert len(COMMANDS) == 9
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


def test_every_row_of_what_is_read_has_its_test() -> None:
    (table,) = re.findall(r"(?ms)^\| what \| known by .*?\n\n", PAGE)
    assert len(FORMS) == table.count("\n") - 3  # but for the heading, the rule and the empty line
    for form, file, test in FORMS:
        assert re.search(rf"(?m)^def {test}\(", (ROOT / file).read_text(encoding="utf-8")), form


def test_every_form_that_is_known_by_its_ending_is_on_the_page() -> None:
    for ending in (*BAG_ENDINGS, *TABLE_ENDINGS, *HDF5_ENDINGS, *(f".db3{one}" for one in COMPRESSED[:1]), INFO, INDEX):
        assert f"`{ending}`" in PAGE
    for words in (NAMES, POSITIONS, STAMPS, SECONDS, NANOSECONDS):
        assert all(f"`{word}`" in PAGE for word in words)


def test_the_example_of_reading_is_one() -> None:
    (block,) = re.findall(r"(?ms)^```yaml\n(.*?)^```$", PAGE)
    found = plain_yaml(block)
    assert isinstance(found, dict)
    assert set(found["reading"]) == set(Reading.model_fields)
    without = {key: value for key, value in found["reading"].items() if key != "rate_hz"}
    assert Reading.model_validate(without).file_name == "{participant}_*"
