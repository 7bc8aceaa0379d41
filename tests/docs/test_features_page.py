"""What docs/features.md shows is done, on a small project: its parameters, its file, its commands."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline import plug_ins
from pipeline.cli import app
from pipeline.formats.parquet.tables import read_table
from pipeline.replay.kinds import own
from pipeline.replay.kinds.register import KINDS
from pipeline.stages import catalog, density, dvc_yaml, featurize, infer, ingest, sample, scene
from pipeline.workspace.project import Project
from tests.support.gantry_project import GANTRY

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "features.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[str]:
    return [text for found, text in BLOCKS if found == language]


@pytest.fixture(autouse=True)
def apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A configuration of its own, and no kinds that stay."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    before = dict(KINDS)
    yield
    KINDS.clear()
    KINDS.update(before)
    own._registered.clear()


def test_all_blocks_are_done_here() -> None:
    assert [language for language, _ in BLOCKS] == ["yaml", "yaml", "yaml", "sh", "py", "yaml", "sh", "toml"]
    entry = tomllib.loads(blocks("toml")[0])["project"]["entry-points"]
    assert list(entry) == [plug_ins.FEATURES]


def test_the_page_from_its_kinds_to_its_question(
    make_project: Callable[[dict[str, Any]], Project],
    parameters: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A task with the page's features, its thetas and its file; the commands in the page's order, `dvc repro` as the
    stages that it would run.
    """
    task = parameters["tasks"]["sweep"] | {"end_effector": "mug", "surface": "table_top"}
    first, _, thetas, second = (YAML(typ="safe").load(text) for text in blocks("yaml"))
    task |= thetas | second | {"features": first["features"] | second["features"]}
    root = make_project(parameters | {"tasks": {"sweep": task}}).root
    (root / "gantry.xml").write_text(GANTRY.replace('"tip"', '"mug"').replace('"floor"', '"table_top"'))
    (root / "my_features.py").write_text(blocks("py")[0])
    project = Project(root)
    monkeypatch.chdir(root)
    question, compute = (text.splitlines() for text in blocks("sh"))
    for command in (*compute, *question):
        words = shlex.split(command)
        if words[:2] == ["dvc", "repro"]:
            for stage in (scene, ingest, sample, featurize, density, infer):
                stage.run(project, "sweep")
            catalog.run(project)
        elif words[0] == "lessbench":
            app(words[1:], standalone_mode=False)
        else:
            assert words == ["python", "-m", "pipeline.stages.dvc_yaml"]
            dvc_yaml.main()
    assert "my_features.py may run as it is now" in capsys.readouterr().out
    values = read_table(project.table("sweep", "features"), "features")
    assert values["swing"].max() > 1  # the arm turns by 1.5 rad
    assert values["cup"].is_between(0, 3.15).all()
    height = read_table(project.table("sweep", "scales"), "scales")["feature"].to_list().index("height")
    thetas = read_table(project.table("sweep", "posteriors"), "posteriors")["theta"].to_numpy()[:, height]
    assert thetas.min() < 0 < thetas.max()  # it may be a cost or a wish


def test_the_table_of_kinds_is_complete_and_true() -> None:
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in PAGE.splitlines() if line[:3] == "| `"]
    found = {row[0].strip("`"): row for row in rows}
    assert set(found) == set(KINDS)
    wanted = {"little": "cost", "much": "wish", "either": "either"}
    for name, row in found.items():
        assert (wanted[row[4]], row[5]) == (KINDS[name].direction, KINDS[name].over_time), name
        unit = KINDS[name].unit
        assert not isinstance(unit, str) or row[3] == unit, name
