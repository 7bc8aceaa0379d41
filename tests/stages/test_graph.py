"""Every stage is declared once, in the registry: dvc.yaml, the modules, the schemas and the commands agree with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import grimp
import pytest
import typer.main
from ruamel.yaml import YAML

import schemas
from pipeline.cli import app
from pipeline.params import load, value_at
from pipeline.stages.dvc_yaml import FOREACH, MOST, NEUTRAL, WIDTH, code_of, dvc_yaml
from pipeline.stages.registry import (
    BY_COMMAND,
    OPTIONAL,
    STAGES,
    UNDECLARED,
    Scope,
    Stage,
    parameters,
    stage,
    table_makers,
)
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import table_path

ROOT = Path(__file__).resolve().parents[2]
PARAMS = load(ROOT / "params.yaml")
TEXT = (ROOT / "dvc.yaml").read_text(encoding="utf-8")
DOCUMENT: dict[str, Any] = YAML(typ="safe").load(TEXT)
each_stage = pytest.mark.parametrize("one", STAGES, ids=lambda one: one.name)


def written(one: Stage) -> dict[str, Any]:
    """The stage in dvc.yaml."""
    found: dict[str, Any] = DOCUMENT["stages"][one.name]
    return found.get("do", found)


def test_dvc_yaml_is_that_of_the_registry_and_can_be_read() -> None:
    assert dvc_yaml(PARAMS) == TEXT, "run `python -m pipeline.stages.dvc_yaml`"
    lines = TEXT.splitlines()
    assert len(lines) < 250
    assert max(map(len, lines)) <= WIDTH
    assert list(DOCUMENT["stages"]) == [one.name for one in STAGES]


def test_every_module_is_of_one_stage_and_every_table_is_made_by_one() -> None:
    modules = {f"pipeline.stages.{path.stem}" for path in (ROOT / "pipeline" / "stages").glob("*.py")}
    helpers = {f"pipeline.stages.{name}" for name in ("__init__", "registry", "dvc_yaml")}
    every = (*STAGES, *BY_COMMAND)
    found = [one.module for one in every if one.module.startswith("pipeline.stages.")]
    assert sorted(found) == sorted(modules - helpers)
    made = [table for one in every for table in one.makes]
    assert sorted(made) == sorted(schemas.names())
    assert sorted([*table_makers("a task"), *table_makers(STUDIES)]) == sorted(made)


def test_stages_come_in_an_order_in_which_they_can_run() -> None:
    there: set[str] = set()
    later = {path for one in STAGES for path in (*one.makes, *one.outputs, *one.metrics)}
    for one in STAGES:
        needed = {path for path in (*one.reads, *one.inputs) if path in later}
        assert needed <= there, one.name
        there.update(one.makes, one.outputs, one.metrics)


@each_stage
def test_a_command_of_the_same_name_runs_it(one: Stage) -> None:
    command = one.command.split()[0]
    assert command in typer.main.get_command(app).commands  # type: ignore[attr-defined]
    cmd = f"lessbench {one.command}" + (" ${key}" if one.per_task else "")
    assert written(one)["cmd"] == cmd
    assert DOCUMENT["stages"][one.name].get("foreach") == FOREACH.get(one.scope)


@each_stage
def test_it_lists_parameters_that_there_are(one: Stage) -> None:
    paths = parameters(one.name, "${key}")
    listed = written(one).get("params", [])
    optional = {path.format(task="${key}") for path in OPTIONAL}
    for path in paths:  # by itself, or in what holds it
        assert path in listed or any(path.startswith(f"{whole}.") for whole in listed)
    if not optional & set(paths):
        assert listed == list(paths)
    for path in parameters(one.name, "table"):
        value_at(PARAMS, path)
    for path in one.named:
        assert any(path == declared or path.startswith(f"{declared}.") for declared in one.parameters)


@each_stage
def test_it_lists_what_it_reads_and_the_schemas_of_what_it_makes(one: Stage) -> None:
    key = "${key}" if one.per_task else STUDIES
    deps = written(one)["deps"]
    for table in one.reads:
        path = table_path(key, table)
        assert path in deps or str(Path(path).parent) in deps
    assert "schemas" in deps or {f"schemas/{table}.toml" for table in one.makes} <= set(deps)
    places = list(PARAMS.tasks) if one.scope is Scope.PROJECT else [key]
    assert {path.format(task=place) for path in one.inputs for place in places} <= set(deps)
    assert len(deps) == len(set(deps))


@each_stage
def test_a_failing_stage_leaves_what_was_there(one: Stage) -> None:
    key = "${key}" if one.per_task else STUDIES
    listed = [*written(one)["outs"], *written(one).get("metrics", [])]
    made = [*(table_path(key, table) for table in one.makes), *(path.format(task=key) for path in one.outputs)]
    made += [path.format(task=key) for path in one.metrics]
    assert listed == [{path: {"persist": True}} for path in made]


GRAPH = grimp.build_graph("pipeline", cache_dir=None)
PACKAGES = {module for module in GRAPH.modules if GRAPH.find_children(module)}
for file in NEUTRAL:
    GRAPH.remove_module(file.removesuffix(".py").replace("/", "."))


@each_stage
def test_it_lists_the_code_it_imports(one: Stage) -> None:
    """The code as another program finds it: all that is imported is listed, and little else, and nothing neutral."""
    listed = code_of(one.module)
    assert written(one)["deps"][-len(listed) :] == listed
    imported = {one.module, *GRAPH.find_upstream_modules(one.module)}
    packages = imported & PACKAGES
    files = {f"{module.replace('.', '/')}.py" for module in imported - packages}
    covered = {file for file in files if any(file == path or file.startswith(f"{path}/") for path in listed)}
    assert covered == files
    whole = {f"{module.replace('.', '/')}" for module in packages if GRAPH.find_modules_directly_imported_by(module)}
    for path in listed:
        if path.endswith(".py"):
            assert path in files
        elif path not in whole:
            inside = {file.relative_to(ROOT).as_posix() for file in (ROOT / path).rglob("*.py")}
            inside = {file for file in inside if not file.endswith("/__init__.py")}
            assert len(inside & files) >= MOST * len(inside)
            assert not inside & NEUTRAL


def test_what_is_neutral_is_there() -> None:
    assert [file for file in NEUTRAL if not (ROOT / file).is_file()] == []
    assert [path for path in UNDECLARED if value_at(PARAMS, path.format(task="table")) is Ellipsis] == []


def test_a_given_file_is_watched_once_it_is_named() -> None:
    sampled = PARAMS.sample.model_copy(update={"given": "mine.parquet"})
    document = YAML(typ="safe").load(dvc_yaml(PARAMS.model_copy(update={"sample": sampled})))
    assert "${sample.given}" in document["stages"]["sample"]["do"]["deps"]
    assert stage("sample").named == ("sample.given",)
