"""ARCHITECTURE.md says what is there, and its way to add a stage is the way that works."""

from __future__ import annotations

import json
import re
import runpy
import shutil
from pathlib import Path

import polars as pl
import pytest

from pipeline.stages.registry import STAGES, table_makers
from tests.support.kills import Undisturbed
from tests.support.small_project import ROOT, TASK, run

PAGE = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
SCHEMA = """\
version = 1
row = "a demonstration"
key = ["demonstration_id"]

[[columns]]
name = "demonstration_id"
type = "string"
description = "as in demonstrations"

[[columns]]
name = "length_rad"
type = "double"
unit = "rad"
description = "of its path in the space of joints"
"""
STAGE = '''\
"""Stage: how long the path of each demonstration is."""

from __future__ import annotations

import numpy as np
import polars as pl

from pipeline.formats.parquet.tables import read_table, write_table
from pipeline.stages.registry import parameters
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance


def run(project: Project, name: str) -> None:
    """Write lengths.parquet of the task `name`."""
    with recorded_run(project, "lengths", name):
        source = project.table(name, "demonstrations")
        people = read_table(source, "demonstrations")
        steps = np.diff(people["waypoints"].to_numpy(), axis=1)
        length = pl.Series(np.linalg.norm(steps, axis=2).sum(axis=1))
        table = people.select("demonstration_id", length_rad=length)
        stated = provenance(project, parameters("lengths", name), [source])
        write_table(project.table(name, "lengths"), "lengths", table, stated)
'''
ENTRY = """\
    Stage(
        "lengths", Scope.TASK, "lengths", "pipeline.stages.lengths",
        parameters=("ingest.waypoints",),
        reads=("demonstrations",),
        makes=("lengths",),
    ),
"""
COMMAND = '''

@commands.command(rich_help_panel=STAGES)
def lengths(task: TaskName) -> None:
    """Measure the demonstrations' paths into lengths.parquet.

    Example: `lessbench lengths table`.
    """
    from pipeline.stages.lengths import run

    run(this_project(), task)
'''


def test_the_way_of_the_data_is_that_of_the_registry() -> None:
    make = runpy.run_path(str(ROOT / "docs" / "make_architecture.py"))
    assert make["page"](PAGE) == PAGE, "run `python docs/make_architecture.py`"
    assert max(len(line) for line in PAGE.splitlines() if not line.startswith("|")) <= 120
    assert len(PAGE.splitlines()) <= 120


def test_the_tree_names_every_folder_of_the_package_and_no_other() -> None:
    tree = PAGE.split("```text\n")[1].split("```")[0]
    named = re.findall(r"(?m)^  (\w+)/", tree)
    there = {path.name for path in (ROOT / "pipeline").iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert sorted(named) == sorted(there)
    for name in re.findall(r"(?m)^([\w.]+)/", tree):
        assert (ROOT / name).is_dir(), name
    for name in re.findall(r"`((?:pipeline|docs|schemas)/[\w/]+\.\w+)`", PAGE):
        assert (ROOT / name).is_file(), name


def walk(what: str) -> set[str]:
    """The files that the page names for adding something."""
    (row,) = [line for line in PAGE.splitlines() if line.startswith(f"| {what} |")]
    return set(re.findall(r"`((?:pipeline|schemas)/[\w/<>]+\.\w+)`", row))


def insert(file: Path, before: str, text: str) -> None:
    content = file.read_text(encoding="utf-8")
    assert content.count(before) == 1
    file.write_text(content.replace(before, text + before), encoding="utf-8")


@pytest.mark.timeout(900)
def test_a_stage_with_its_table_is_added_by_touching_the_files_that_are_named(
    undisturbed: Undisturbed, tmp_path: Path
) -> None:
    root = tmp_path / "project"
    shutil.copytree(undisturbed.root, root)
    assert walk("a stage with its table") == {
        "schemas/<table>.toml", "pipeline/stages/<stage>.py", "pipeline/stages/registry.py", "pipeline/cli/stages.py"
    }  # fmt: skip
    (root / "schemas" / "lengths.toml").write_text(SCHEMA)
    (root / "pipeline" / "stages" / "lengths.py").write_text(STAGE)
    insert(root / "pipeline" / "stages" / "registry.py", '    Stage(\n        "sample", ', ENTRY)
    with (root / "pipeline" / "cli" / "stages.py").open("a") as stream:
        stream.write(COMMAND)
    run(root, "python", "-m", "pipeline.stages.dvc_yaml")
    said = run(root, "dvc", "repro", f"lengths@{TASK}").stdout
    assert [line for line in said.splitlines() if line.startswith("Running")] == [f"Running stage 'lengths@{TASK}':"]
    table = root / "datasets" / TASK / "tables" / "lengths.parquet"
    assert pl.read_parquet(table)["length_rad"].min() > 0.5  # type: ignore[operator]
    stated = json.loads(pl.read_parquet_metadata(table)["lessbench.provenance"])  # whose schema this process lacks
    assert list(stated["inputs"]) == [f"datasets/{TASK}/tables/demonstrations.parquet"]
    expected = sum(maker in STAGES for maker in table_makers(TASK).values()) + 1  # that of the new stage
    assert (
        f"{TASK}: {expected} tables as they were made" in run(root, "lessbench", "verify", TASK, "--sample", "1").stdout
    )
    run(root, "dvc", "repro", "catalog")
    answer = run(root, "lessbench", "sql", "select count(*) from lengths", "--format", "csv").stdout
    assert answer.split() == ["count_star()", "3"]
