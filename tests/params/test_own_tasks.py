"""Tasks in files of their own, `tasks/NAME.yaml`: read as those of params.yaml are, and followed by DVC."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.commands.inspect_project import inspect_project
from pipeline.commands.new_task import Wishes, add_task
from pipeline.commands.remove_task import remove_task
from pipeline.errors import ParameterError
from pipeline.params import load
from pipeline.stages.dvc_yaml import dvc_yaml
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]


@pytest.fixture
def project(make_project: Make, parameters: dict[str, Any]) -> Project:
    made = make_project(parameters)
    (made.root / "dvc.yaml").write_text(dvc_yaml(made.params))
    return made


def added(project: Project) -> Project:
    wishes = Wishes("pour", project.root / "gantry.xml", project.root / "mine", own_file=True)
    said = "\n".join(add_task(project, wishes))
    assert "task 'pour' is in tasks/pour.yaml." in said
    assert "dvc.yaml is not" not in said
    return Project(project.root)


def test_in_and_out_again(project: Project) -> None:
    before = {name: (project.root / name).read_bytes() for name in ("params.yaml", "dvc.yaml")}
    mine = added(project)
    assert (mine.root / "params.yaml").read_bytes() == before["params.yaml"]
    assert list(mine.params.tasks) == ["sweep", "pour"]
    assert (mine.root / "dvc.yaml").read_text() == dvc_yaml(mine.params, mine.own_tasks)
    assert not [one for one in inspect_project(mine.root).findings if "dvc.yaml" in str(one)]
    add_task(mine, Wishes("scoop", project.root / "gantry.xml", project.root / "mine"))
    both = Project(project.root)
    assert (mine.root / "dvc.yaml").read_text() == dvc_yaml(both.params, both.own_tasks)
    remove_task(both, "pour")
    assert not (mine.root / "tasks").exists()
    remove_task(Project(project.root), "scoop")
    assert {name: (project.root / name).read_bytes() for name in before} == before


def test_dvc_finds_every_parameter_where_it_stands(project: Project) -> None:
    from dvc.dependency.param import ParamsDependency
    from dvc.repo import Repo

    mine = added(project)
    (mine.root / ".dvc").mkdir()
    (mine.root / ".dvc" / "config").write_text("[core]\n    no_scm = true\n    analytics = false\n")
    places: dict[str, set[str]] = {}
    for stage in Repo(str(mine.root)).index.stages:
        for one in stage.deps:
            if isinstance(one, ParamsDependency) and "simulate" not in stage.addressing:
                task = stage.addressing.rpartition("@")[2]
                own = {path for path in one.params if path.startswith("tasks.")}
                assert own <= set(one.read_params()), stage.addressing
                assert all(path.split(".")[1] == task for path in own)
                places.setdefault(task, set()).update({Path(one.fs_path).name} if own else set())
    assert places["pour"] == {"pour.yaml"}
    assert places["sweep"] == {"params.yaml"}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("pour", "pour: {}\n", r"tasks/pour\.yaml: must hold `tasks:` and in it the one task 'pour'"),
        ("pour", "tasks: {scoop: {}}\n", "the one task 'pour', as the file is called"),
        ("pour", "tasks: {pour: {}}\nseed: 1\n", "must hold `tasks:` and in it"),
        ("sweep", "tasks: {sweep: {}}\n", r"the task 'sweep' is in params\.yaml, too"),
        ("pour", "tasks: {pour: {colour: red}}\n", r"there is no parameter 'tasks\.pour\.colour'"),
        ("a b", "tasks: {a b: {}}\n", "params.yaml"),
    ],
)
def test_files_that_are_no_tasks(project: Project, name: str, text: str, message: str) -> None:
    (project.root / "tasks").mkdir()
    (project.root / "tasks" / f"{name}.yaml").write_text(text)
    with pytest.raises(ParameterError, match=message):
        load(project.root / "params.yaml")


def test_simulated_tasks_stand_in_params(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["simulate"]["weights"]["pour"] = {"effort": 1.0}
    project = make_project(parameters)
    (project.root / "tasks").mkdir()
    (project.root / "tasks" / "pour.yaml").write_text("tasks: {pour: {}}\n")
    with pytest.raises(ParameterError, match=r"simulate\.weights names 'pour'; a simulated task must stand in params"):
        load(project.root / "params.yaml")
