"""What DVC itself calls out of date, in a small project that is up to date, once something has changed."""

from __future__ import annotations

import os
import py_compile
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from dvc.repo import Repo
from ruamel.yaml import YAML

from pipeline.stages.registry import STAGES, Scope, parameters
from tests.support.kills import Undisturbed
from tests.support.recording_params import leaves
from tests.support.small_project import TASK, run

YAML_12 = YAML(typ="safe", pure=True)
LITTER = (
    "pipeline/choice/.models.py.swp", "pipeline/choice/models.py~", "pipeline/.idea/x.xml", "pipeline/.vscode/x.json",
    "pipeline/choice/.DS_Store", "pipeline/choice/.ipynb_checkpoints/models.py", "schemas/#features.toml#",
    "datasets/robots/.#jaco2.xml", "datasets/scenes/parts/Thumbs.db",
    "datasets/table/tables/.posteriors.parquet.partial",
    "datasets/table/recordings/.DS_Store",
)  # fmt: skip


@pytest.fixture(scope="module")
def root(undisturbed: Undisturbed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the small project to change at will; nothing in it is out of date."""
    copy = tmp_path_factory.mktemp("stale") / "project"
    shutil.copytree(undisturbed.root, copy)
    return copy


@pytest.fixture
def stale(root: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], dict[str, Any]]:
    """What DVC calls out of date, by stage."""
    monkeypatch.setenv("DVC_SITE_CACHE_DIR", str(root / ".dvc" / "site"))
    monkeypatch.setenv("DVC_NO_ANALYTICS", "1")
    monkeypatch.chdir(root)

    def status() -> dict[str, Any]:
        with Repo(str(root)) as repo:
            return dict(repo.status())

    return status


def other(value: Any) -> Any:
    """A value of the same kind."""
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, list):
        return [*value, 7] if value else [7]
    return value + ("-other" if isinstance(value, str) else 1)


def changed(document: dict[str, Any], leaf: str) -> dict[str, Any]:
    """The document with another value at a dotted path."""
    key, _, rest = leaf.partition(".")
    return document | {key: changed(document[key], rest) if rest else other(document[key])}


def users(leaf: str) -> set[str]:
    """The stages that declare a leaf of params.yaml; the report prints the file as it is."""
    return {
        f"{one.name}@{TASK}" if one.per_task else one.name
        for one in STAGES
        if "params.yaml" in one.inputs
        or any(leaf == path or leaf.startswith(f"{path}.") for path in parameters(one.name, TASK))
    }


@pytest.mark.timeout(900)
def test_of_every_parameter_exactly_the_stages_that_use_it_go_stale(root: Path, stale: Any) -> None:
    file = root / "params.yaml"
    text = file.read_text(encoding="utf-8")
    document = YAML_12.load(text)
    assert stale() == {}
    wrong = {}
    for leaf in leaves(document):
        with file.open("w", encoding="utf-8") as stream:
            YAML_12.dump(changed(document, leaf), stream)
        found = set(stale())
        if found != users(leaf):
            wrong[leaf] = {"too many": found - users(leaf), "too few": users(leaf) - found}
    file.write_text(text, encoding="utf-8")
    assert wrong == {}
    assert stale() == {}


def bytecode(root: Path) -> Iterator[Path]:
    return (path for path in root.rglob("*.pyc") if ".dvc" not in path.parts)


@pytest.mark.timeout(900)
def test_bytecode_and_litter_make_nothing_stale(root: Path, stale: Any) -> None:
    for path in bytecode(root):
        path.unlink()
    assert stale() == {}
    sources = [path for folder in ("pipeline", "schemas") for path in (root / folder).rglob("*.py")]
    for path in sources:
        py_compile.compile(str(path), doraise=True)
    assert len(list(bytecode(root))) == len(sources) > 100
    for name in LITTER:
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text("litter")
    assert stale() == {}
    for path in [*bytecode(root), *(root / name for name in LITTER)]:
        path.unlink()
    for folder in root.rglob("__pycache__"):
        folder.rmdir()
    assert stale() == {}


@pytest.mark.timeout(900)
def test_a_robot_more_re_runs_the_look_at_the_scene_and_a_changed_part_what_uses_it(root: Path, stale: Any) -> None:
    (root / "datasets" / "robots" / "another.xml").write_text('<mujoco model="another"/>')
    with (root / "datasets" / "scenes" / "parts" / "human.xml").open("a") as stream:
        stream.write("<!-- of another task's scene -->")
    assert set(stale()) == {f"scene@{TASK}"}
    said = run(root, "dvc", "repro").stdout
    assert [line for line in said.splitlines() if line.startswith("Running")] == [f"Running stage 'scene@{TASK}':"]
    assert stale() == {}
    part = root / "datasets" / "scenes" / "parts" / "room.xml"
    whole = part.read_text(encoding="utf-8")
    part.write_text(whole.replace("<mujoco", "<!-- as it was -->\n<mujoco", 1), encoding="utf-8")
    run(root, "dvc", "repro", f"scene@{TASK}")
    loads = {f"{one.name}@{TASK}" for one in STAGES if "datasets/{task}/scene.json" in one.inputs}
    assert set(stale()) == loads
    assert {one.name for one in STAGES if one.scope is Scope.SIMULATED} == {"simulate"}
    assert f"simulate@{TASK}" in loads
    part.write_text(whole, encoding="utf-8")
    run(root, "dvc", "repro", f"scene@{TASK}")
    assert stale() == {}


@pytest.mark.timeout(900)
def test_the_catalog_waits_for_a_table_of_any_task(root: Path, stale: Any) -> None:
    table = root / "datasets" / TASK / "tables" / "sampling.parquet"
    whole, times = table.read_bytes(), table.stat()
    table.unlink()
    table.write_bytes(whole + b"x")
    assert set(stale()) == {f"sample@{TASK}", f"figures@{TASK}", f"inspect@{TASK}", "catalog"}
    table.unlink()
    table.write_bytes(whole)
    os.utime(table, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert stale() == {}
