"""The graph in dvc.yaml lists the code of every stage, all of it and nothing else, and its tables' schemas."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[2]
# what finds files, reports and words, and so cannot change a result
NEUTRAL = {
    "pipeline/errors.py",
    "pipeline/params/__init__.py",
    "pipeline/params/reading.py",
    "pipeline/params/sections.py",
    "pipeline/workspace/compute/dask_executor.py",
    "pipeline/workspace/progress.py",
    "pipeline/workspace/project.py",
    "pipeline/formats/files/parent_process.py",
    "pipeline/formats/files/atomic.py",
    "schemas/__init__.py",
}


def stages() -> dict[str, dict[str, Any]]:
    document = YAML(typ="safe", pure=True).load((ROOT / "dvc.yaml").read_text())
    return {name: stage.get("do", stage) for name, stage in document["stages"].items()}


def module_of(command: str) -> str:
    """`lessbench infer TASK`, `lessbench study grid-world`: the stage's module."""
    words = command.split()[1:]
    name = words[1] if words[0] == "study" else words[0]
    return f"pipeline/stages/{name.replace('-', '_')}.py"


def imports(file: str) -> set[str]:
    """The project's files that a file imports, anywhere in it; packages stand for their folder."""
    found = set()
    for node in ast.walk(ast.parse((ROOT / file).read_text())):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            path = name.replace(".", "/")
            if (ROOT / f"{path}.py").is_file():
                found.add(f"{path}.py")
            elif name == "schemas" or (name.startswith("pipeline.") and (ROOT / path).is_dir()):
                found.add(path + "/__init__.py")
    return found


def closure(file: str) -> set[str]:
    seen, todo = set(), {file}
    while todo:
        file = todo.pop()
        seen.add(file)
        todo |= imports(file) - seen
    if "pipeline/choice/__init__.py" in seen:  # it collects the whole folder
        seen = {"pipeline/choice" if path.startswith("pipeline/choice/") else path for path in seen}
    return seen - NEUTRAL


@pytest.mark.parametrize("name", stages())
def test_a_stage_lists_its_code_exactly(name: str) -> None:
    stage = stages()[name]
    listed = {dep for dep in stage["deps"] if dep.startswith("pipeline/")}
    needed = {path for path in closure(module_of(stage["cmd"])) if not path.endswith("/__init__.py")}
    assert listed == needed


@pytest.mark.parametrize("name", stages())
def test_a_stage_lists_the_schemas_of_what_it_writes(name: str) -> None:
    stage = stages()[name]
    outputs = [next(iter(out)) if isinstance(out, dict) else out for out in stage["outs"]]
    tables = {Path(out).stem for out in outputs if out.endswith(".parquet")}
    listed = {Path(dep).stem for dep in stage["deps"] if dep.startswith("schemas/")}
    assert tables <= listed


def test_a_failing_stage_leaves_what_was_there() -> None:
    for name, stage in stages().items():
        for out in stage["outs"]:
            assert isinstance(out, dict), f"{name}: {out} would be removed before the stage runs"
            assert next(iter(out.values())) == {"persist": True}


def test_the_catalog_waits_for_every_table_of_every_task() -> None:
    document = YAML(typ="safe", pure=True).load((ROOT / "dvc.yaml").read_text())
    tasks = YAML(typ="safe", pure=True).load((ROOT / "params.yaml").read_text())["tasks"]
    waited_for = set(stages()["catalog"]["deps"])
    for name, stage in stages().items():
        if name == "catalog":
            continue
        for out in (next(iter(out)) for out in stage["outs"]):
            if out.endswith(".parquet"):
                keys = tasks if "foreach" in document["stages"][name] else [""]
                assert {out.replace("${key}", key) for key in keys} <= waited_for
