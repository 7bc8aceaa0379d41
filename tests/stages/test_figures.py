"""Figures and recording of a small project: drawn from its own tables, whole, the same again."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rerun as rr
from rerun.chunk import RrdReader

from pipeline.commands import serve
from pipeline.errors import TableError
from pipeline.stages import (
    density,
    featurize,
    figures,
    figures_studies,
    grid_world,
    human_choice,
    infer,
    ingest,
    inspect_studies,
    sample,
)
from pipeline.views.rerun.server import claim
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project, recorded_runs
from tests.support.live_viewer import not_blank, pictures

Make = Callable[[dict[str, Any]], Project]
STUDY_FIGURES = [
    "grid_world_density",
    "grid_world_overall",
    "grid_world_sets",
    "grid_world_true_posterior",
    "human_choice",
]
TASK_FIGURES = ["densities", "density_map", "held_out", "posterior", "scene"]
KINDS = ("pdf", "png", "svg", "txt")


@pytest.fixture
def studied(make_project: Make, parameters: dict[str, Any]) -> Project:
    """The small project with its studies done, the human choice study on choices of its own."""
    project = make_project(parameters)
    rows = [("control", "here", "here")] * 3 + [("control", "there", "there")] * 5
    rows += [("experimental", "near", "here")] * 4 + [("experimental", "far", "there")] * 3
    rows += [("experimental", "farther", "there")] * 2
    lines = [f"{number},{trial},{choice},{group}" for number, (trial, choice, group) in enumerate(rows)]
    (project.root / "choices.csv").write_text("\n".join(["participant,trial,choice,group", *lines]))
    human_choice.run(project)
    grid_world.run(project)
    return project


def written(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


def test_the_studies_figures_are_whole_and_the_same_again(studied: Project) -> None:
    folder = studied.datasets / STUDIES / "figures"
    folder.mkdir()
    (folder / "of_an_older_version.svg").write_text("gone")
    figures_studies.run(studied)
    first = written(folder)
    assert list(first) == [f"{name}.{kind}" for name in STUDY_FIGURES for kind in KINDS]
    figures_studies.run(studied)
    assert written(folder) == first
    assert sorted(path.name for path in folder.parent.iterdir()) == ["figures", "metrics.json", "tables"]
    numbers = json.loads((folder.parent / "metrics.json").read_text())
    assert 0 < numbers["human_choice"]["groups"]["less"]["p_value"] < 1
    assert recorded_runs(studied)[-1]["produced"] == "5 figures"


def test_a_task_has_its_figures(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["sample"] |= {"sampler": "deformation", "sets": 1, "sizes": [5]}
    parameters["infer"]["models"] = ["boltzmann", "less", "attribute-rule"]
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, infer, figures):
        stage.run(project, "sweep")
    folder = project.datasets / "sweep" / "figures"
    first = written(folder)
    assert list(first) == [f"{name}.{kind}" for name in TASK_FIGURES for kind in KINDS]
    numbers = (project.datasets / "sweep" / "metrics.json").read_bytes()
    assert json.loads(numbers)["recordings"] == {"used": 3, "rejected": 0}
    assert list(json.loads(numbers))[1:] == ["boltzmann", "less", "attribute-rule"]
    figures.run(project, "sweep")
    assert written(folder) == first
    assert (project.datasets / "sweep" / "metrics.json").read_bytes() == numbers


def test_one_demonstration_has_no_held_out_figure(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["sample"] |= {"sampler": "deformation", "sets": 1, "sizes": [5]}
    project = make_project(parameters)
    for number in (1, 2):
        (project.root / "mine" / f"demo-{number}.mcap").unlink()
    for stage in (ingest, sample, featurize, density, infer, figures):
        stage.run(project, "sweep")
    assert not (project.datasets / "sweep" / "figures" / "held_out.svg").exists()


def test_without_its_tables_nothing_is_drawn(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    with pytest.raises(TableError, match=r"grid_world_summary\.parquet"):
        figures_studies.run(project)
    assert not (project.datasets / STUDIES / "figures").exists()


def test_the_studies_recording(
    studied: Project, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RERUN_STRICT", "1")
    inspect_studies.run(studied)
    path = studied.datasets / STUDIES / "inspect.rrd"
    entities = {chunk.entity_path for chunk in RrdReader(path).stream()}
    people = ("less", "boltzmann", "less-hidden", "less-hidden-own-bandwidth")
    expected = {"/human_choice/less/bars", "/human_choice/boltzmann/observed", "/map/density", "/summary"}
    expected |= {f"/true_posterior/{name}/path-size/bars" for name in people}
    expected |= {f"/sets/{name}/grid/demonstrations" for name in ("Xi_L", "Xi_B")}
    expected |= {f"/sets/{name}/posterior/boltzmann/bars" for name in ("Xi_L", "Xi_B")}
    assert expected <= {entity.replace("\\", "") for entity in entities}, entities
    serve.serve(studied, STUDIES, address := claim(port=0), stay=False)
    assert f"serving the recording of studies at {address.uri}\n" in capsys.readouterr().out
    with pictures().headless_viewer(path) as viewer:
        time.sleep(1.0)
        state = viewer.get_state()
        # those behind a tab are not shown
        assert len(state.views) >= 8
        assert [view.reports for view in state.views if view.reports] == []
        viewer.save_screenshot(str(studied.root / "studies.png"))
    not_blank(studied.root / "studies.png")


@pytest.fixture(autouse=True)
def _as_before() -> Any:
    strict = rr.strict_mode()
    yield
    rr.set_strict_mode(strict)
