"""`lessbench answer`: what people wanted in each task, how sure that is, and whether to trust it."""

from __future__ import annotations

from collections.abc import Sequence

import polars as pl

from pipeline.answers.tables import answer_lines
from pipeline.errors import StageError
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.stages.registry import parameters
from pipeline.terminal import note, say, say_json
from pipeline.workspace.choice_sets import choice_tables
from pipeline.workspace.project import Project
from pipeline.workspace.provenance import is_current

TABLE = "answers"


def run(project: Project, name: str | None, as_json: bool) -> None:
    """Say the answer of one task, or of all that have one.

    Raises:
        StageError: there is none yet.
    """
    tasks = list(project.params.tasks) if name is None else [name]
    for task in tasks:
        project.params.task(task)
    rows = {task: answer_of(project, task) for task in tasks if name or project.table(task, TABLE).exists()}
    if not rows:
        raise StageError("no task has an answer yet; run `dvc repro`, or `lessbench conclude TASK` for one task")
    if as_json:
        return say_json({task: record(table) for task, table in rows.items()})
    for number, table in enumerate(rows.values()):
        for line in ([""] if number else []) + answer_lines(table):
            say(line)
    return None


def after_inference(project: Project, task: str) -> None:
    """Say the answer that belongs to the posteriors just computed, or how to get it."""
    path = project.table(task, TABLE)
    if path.exists():
        with OpenTable(path, TABLE) as table:
            rested = table.provenance.get("inputs")
            there = {project.shown(one) for one in choice_tables(project, task).values()}
            known = isinstance(rested, dict) and there <= set(rested)
            current = known and is_current(project, parameters("answer", task), table)
            lines = answer_lines(table.read()) if current else []
    else:
        lines = []
    for line in lines:
        say(line)
    if not lines:
        note(f"what {task} comes to, and whether to trust it: lessbench conclude {task}")


def answer_of(project: Project, task: str) -> pl.DataFrame:
    """Rows of the table `answers` of a task.

    Raises:
        StageError: the task has no answer yet.
        TableError: the table is not what it should be.
    """
    path = project.table(task, TABLE)
    if not path.exists():
        raise StageError(
            f"{project.shown(path)}: there is no answer yet; run `dvc repro`, or `lessbench conclude {task}`"
        )
    with OpenTable(path, TABLE) as table:
        return table.read()


def record(rows: pl.DataFrame) -> dict[str, object]:
    """An answer as data: its sentence, whether to trust it, preferences and checks."""
    (head,) = rows.filter(kind="answer").iter_rows(named=True)
    return {
        "answer": head["statement"],
        "trust": head["trust"],
        "preferences": _lines(rows.filter(kind="preference"), ("line", "statement", "outcome", "number")),
        "checks": _lines(
            rows.filter(kind="check"),
            ("line", "statement", "outcome", "number", "least", "most", "gravest", "trust"),
        ),
    }


def _lines(rows: pl.DataFrame, columns: Sequence[str]) -> list[dict[str, object]]:
    # JSON has no NaN
    return rows.sort("place").select(columns).with_columns(pl.col("number").fill_nan(None)).to_dicts()
