"""Each stage declares the parameters that it reads, all of them and no others, as measured while it runs."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from fnmatch import fnmatch
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from pipeline.stages import registry
from pipeline.stages.registry import STAGES, UNDECLARED, Stage
from pipeline.workspace.project import Project
from pipeline.workspace.provenance import is_current, provenance
from tests.support.recording_params import leaves, recording

TASK = "sweep"
CHOICES = Path(__file__).resolve().parents[2] / "datasets" / "studies" / "human_choice" / "choices.csv"
# leaves that are declared as parts of a section and not read, with the reason
UNREAD = {
    "robustness.samplers.*.kind": "it must agree with the setting beside it, which is read, and cannot change alone",
}


def declared(stage: Stage, all_leaves: set[str]) -> set[str]:
    """The leaves that a stage declares; one that reads the whole of params.yaml, as the report does, declares all."""
    if "params.yaml" in stage.inputs:
        return all_leaves
    paths = registry.parameters(stage.name, TASK)
    return {leaf for leaf in all_leaves if any(leaf == path or leaf.startswith(f"{path}.") for path in paths)}


def test_stages_declare_the_parameters_that_they_read(
    make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters["ingest"] |= {"salvage": False, "on_rejected": "continue"}
    parameters["compute"]["partition"] = 10  # so that some sets go through whole and others part by part
    parameters["sample"]["working_set"] = 200  # more than are drawn
    root = make_project(parameters).root
    (root / "mine" / "broken.mcap").write_text("no recording")
    shutil.copy(CHOICES, root / "choices.csv")
    all_leaves = set(leaves(parameters))
    free = {path.format(task=TASK) for path in UNDECLARED}
    too_few: dict[str, set[str]] = {}
    too_many: dict[str, list[str]] = {}
    # whether an input is up to date is no result, and DVC looks at what the input depends on
    monkeypatch.setattr(
        "pipeline.workspace.choice_sets.is_current", lambda _, paths, table: is_current(Project(root), paths, table)
    )
    for stage in STAGES:
        module = import_module(stage.module)
        if hasattr(module, "provenance"):  # what a table records of its stage's parameters is not used by the stage
            monkeypatch.setattr(module, "provenance", partial(_provenance, Project(root)))
        project, read = Project(root), set[str]()
        project.__dict__["params"] = recording(project.params, read)
        stage.run(project, TASK)
        mine = declared(stage, all_leaves)
        too_few[stage.name] = (read & all_leaves) - mine - free
        if "params.yaml" not in stage.inputs:
            too_many[stage.name] = [leaf for leaf in mine - read if not any(fnmatch(leaf, rule) for rule in UNREAD)]
    assert {name: found for name, found in too_few.items() if found} == {}
    assert {name: found for name, found in too_many.items() if found} == {}


def _provenance(unwatched: Project, _: Project, *arguments: Any, **settings: Any) -> dict[str, object]:
    return provenance(unwatched, *arguments, **settings)


def test_a_leaf_that_is_read_is_noted(parameters: dict[str, Any], make_project: Any) -> None:
    read: set[str] = set()
    params = recording(make_project(parameters).params, read)
    assert "sweep" in params.tasks
    assert list(params.robustness.samplers) == sorted(parameters["robustness"]["samplers"])
    assert params.task("sweep").features["vase"]["radius_m"] == 0.5
    assert read == {"tasks.sweep.features.vase.radius_m"}
    assert params.sample.via_point.reach_rad == 0.4
    params.studies.grid_world.model_dump()
    assert "sample.via-point.reach_rad" in read
    assert {f"studies.grid_world.{name}" for name in parameters["studies"]["grid_world"]} <= read
