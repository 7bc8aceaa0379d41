"""Every stage opens each table that it reads once, and only the file that its path names."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.commands.verify import verify
from pipeline.commands.watch import session, setting
from pipeline.formats.parquet.checked import open_table
from pipeline.stages.registry import STAGES, table_makers
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]
TASK = "sweep"
CHOICES = [("control", "here", "here")] * 3 + [("control", "there", "there")] * 5
CHOICES += [("experimental", "near", "here")] * 4 + [("experimental", "far", "there")] * 5


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The files of tables that are opened from now on."""
    files: list[Path] = []
    plain = open_table._open

    def noted(path: Path) -> Any:
        files.append(path)
        return plain(path)

    monkeypatch.setattr(open_table, "_open", noted)
    return files


def with_choices(project: Project) -> None:
    lines = [f"{number},{trial},{choice},{group}" for number, (trial, choice, group) in enumerate(CHOICES)]
    (project.root / "choices.csv").write_text("\n".join(["participant,trial,choice,group", *lines]))


def test_every_stage_opens_the_tables_that_it_declares_once(
    make_project: Make, parameters: dict[str, Any], opened: list[Path]
) -> None:
    parameters["tasks"][TASK]["recordings"] = f"datasets/{TASK}/recordings"
    project = make_project(parameters)
    with_choices(project)
    makers = {place: table_makers(place).items() for place in (TASK, STUDIES)}
    every = {project.table(place, table) for place in makers for table, maker in makers[place] if maker in STAGES}
    for one in STAGES:
        opened.clear()
        one.run(project, TASK)
        declared = {project.table(TASK if one.per_task else STUDIES, table) for table in one.reads}
        assert Counter(opened) == Counter(every if one.name == "catalog" else declared), one.name


def test_verify_and_watch_open_each_table_once(
    make_project: Make, parameters: dict[str, Any], opened: list[Path]
) -> None:
    project = make_project(parameters)
    for one in STAGES:
        if one.name in ("ingest", "sample", "featurize", "density", "infer"):
            one.run(project, TASK)
    opened.clear()
    assert verify(project, TASK, 20).drift == []
    assert Counter(opened) == Counter(
        path for path in project.tables(TASK, table_makers(TASK)).values() if path.exists()
    )
    opened.clear()
    session.run(project, None, TASK, session.Until(demonstrations=2), None)
    assert Counter(opened) == Counter(project.tables(TASK, setting.TABLES).values())


@pytest.mark.parametrize("folder", ["set[1]", "a*b", "year=2020"])
def test_a_project_may_lie_in_a_folder_of_any_name(
    make_project: Make, parameters: dict[str, Any], tmp_path: Path, folder: str
) -> None:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5], "sets": 2}
    root = tmp_path / folder / "project"
    shutil.move(make_project(parameters).root, root)
    project = Project(root)
    for one in STAGES:
        if one.name in ("ingest", "sample", "featurize", "density", "infer", "figures", "inspect", "catalog"):
            one.run(project, TASK)
    assert verify(project, TASK, 5).drift == []
