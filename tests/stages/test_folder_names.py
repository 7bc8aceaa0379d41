"""Where a project lies changes nothing: folders whose names look like patterns, partitions or options are folders."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.commands.run import run_task
from pipeline.commands.verify import verify
from pipeline.formats.duckdb.questions import ask
from pipeline.stages import catalog, human_choice, report
from pipeline.workspace.project import Project

ODD = Path("beta=10") / "model=less" / "participant=p07" / "task=other" / "run[1]" / "a?b" / "*" / "{x,y}" / "it's"
CHOICES = Path(__file__).resolve().parents[2] / "datasets" / "studies" / "human_choice" / "choices.csv"


def make_all(project: Project) -> Project:
    """Run everything that reads or writes tables."""
    run_task(project, "sweep")
    human_choice.run(project)
    catalog.run(project)
    report.run(project)
    return project


def tables(project: Project) -> dict[str, bytes]:
    return {file.relative_to(project.root).as_posix(): file.read_bytes() for file in project.root.rglob("*.parquet")}


def contents(project: Project) -> dict[str, pl.DataFrame]:
    """Every table and view of the catalog."""
    names = ask(project.catalog, "select table_name from duckdb_columns() where not internal group by all order by all")
    return {name: ask(project.catalog, f"from {name} order by all") for name in names.to_series()}


@pytest.mark.timeout(600)
def test_a_project_below_odd_folders_makes_the_same(
    make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any], tmp_path: Path
) -> None:
    project = make_project(parameters)
    shutil.copy(CHOICES, project.root / "choices.csv")
    odd = tmp_path / ODD
    shutil.copytree(project.root, odd)
    make_all(project)
    beside = make_all(Project(odd))
    assert tables(beside) == tables(project)
    expected, found = contents(project), contents(beside)
    assert len(expected) > 30
    assert found.keys() == expected.keys()
    for name, rows in expected.items():  # sums in views differ in their last digits from one question to the next
        assert_frame_equal(found[name], rows, rel_tol=1e-12, abs_tol=1e-12)
    assert not verify(beside, "sweep", 5).drift
    assert {path.relative_to(odd) for path in odd.rglob("*")} == {
        path.relative_to(project.root) for path in project.root.rglob("*")
    }
