"""`lessbench compare`: two versions of the results side by side: parameters, answers, posteriors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from pydantic import BaseModel

from pipeline.answers.tables import GROUP
from pipeline.choice import Posterior
from pipeline.commands.answer import TABLE, answer_of
from pipeline.errors import ParameterError, StageError
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.tables import read_table
from pipeline.terminal import cell, note, say, say_json, show
from pipeline.views.rerun.comparison import Compared, write_comparison
from pipeline.views.task_summary import theta_labels
from pipeline.views.task_view import shown_beliefs
from pipeline.vocabulary import ALL, LESS
from pipeline.workspace.project import Project
from pipeline.workspace.versions import version

NEEDED = (TABLE, "weights_summary", "demonstrations", "posteriors", "explored_posteriors", "scales")
RECORDING = ".lessbench/compare.rrd"
MOST_PARAMETERS = 40
QUESTION = "?"  # ends what a check asks
Row = tuple[str, str, str]


@dataclass(frozen=True)
class Wanted:
    """What is compared.

    Attributes:
        first, second: the versions, see `pipeline.workspace.versions.version`.
        task: the only task; None for all that both have.
        recording: whether the posteriors are written into RECORDING.
        as_json: for programs.
    """

    first: str
    second: str
    task: str | None = None
    recording: bool = True
    as_json: bool = False


def run(project: Project, wanted: Wanted) -> None:
    """Say what is different, and write the posteriors of both into one recording.

    Raises:
        StageError: a version cannot be read, or the two have no task in common.
        ParameterError: there is no such task in one of them.
    """
    with ExitStack() as stack:
        pair = [stack.enter_context(version(project, name, NEEDED)) for name in (wanted.first, wanted.second)]
        changed = list(changed_parameters(pair[0].params, pair[1].params))
        if pair[0].root == pair[1].root:
            note("both have the results of this folder, so only their parameters are compared")
        tasks = _tasks(pair, wanted.task) if pair[0].root != pair[1].root else []
        answers = {task: [_answer(one, task) for one in pair] for task in tasks}
        if wanted.as_json:
            say_json({"parameters": [list(row) for row in changed], "answers": answers})
        else:
            _show(wanted, "parameters", changed[:MOST_PARAMETERS])
            if len(changed) > MOST_PARAMETERS:
                say(f"and {len(changed) - MOST_PARAMETERS} more parameters; `--json` has all")
            for task, (one, other) in answers.items():
                _show(wanted, task, _rows(one, other))
        if wanted.recording:
            compared = [found for task in tasks if (found := _compared(pair, task, (wanted.first, wanted.second)))]
            if compared:
                file = project.root / RECORDING
                file.parent.mkdir(exist_ok=True)
                write_comparison(file, compared)
                note(f"{RECORDING}: the posteriors of both, in step; see it with `rerun {RECORDING}`")


def _rows(one: Mapping[str, str], other: Mapping[str, str]) -> list[Row]:
    """The lines of two answers; of the checks those that differ."""
    rows = [(key, one.get(key, ""), other.get(key, "")) for key in {**one, **other}]
    shown = [row for row in rows if not row[0].endswith(QUESTION) or row[1] != row[2]]
    same = len(rows) - len(shown)
    return [*shown, (f"{same} checks", "the same", "the same")] if same else shown


def changed_parameters(one: Any, other: Any, place: str = "") -> Iterator[Row]:
    """Where parameters differ, with the value in each; empty where it has none."""
    one, other = _fields(one), _fields(other)
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in {**one, **other}:
            yield from changed_parameters(one.get(key), other.get(key), f"{place}.{key}" if place else str(key))
    elif one != other:
        yield place, _said(one, "..."), _said(other, "...")


def _fields(value: Any) -> Any:
    if not isinstance(value, BaseModel):
        return value
    return {field.alias or name: getattr(value, name) for name, field in type(value).model_fields.items()}


def _said(value: Any, mapping: str | None = None) -> str:
    if value is None:
        return ""
    value = _fields(value)
    if isinstance(value, Mapping):
        return mapping or "{" + ", ".join(f"{key}: {_said(inner)}" for key, inner in value.items()) + "}"
    return f"[{', '.join(map(_said, value))}]" if isinstance(value, list | tuple) else str(value)


def _tasks(pair: list[Project], only: str | None) -> list[str]:
    for one in pair:
        if only is not None:
            one.params.task(only)
    both = [only] if only else [task for task in pair[0].params.tasks if task in pair[1].params.tasks]
    if not both:
        names = [", ".join(one.params.tasks) for one in pair]
        raise ParameterError(f"the two have no task in common; the first has {names[0]}, the second {names[1]}")
    found = [task for task in both if all(one.table(task, TABLE).exists() for one in pair)]
    if not found:
        raise StageError(
            f"no task has an answer in both, of {', '.join(both)}; run `dvc repro` in each, and commit dvc.lock with "
            "what is to be compared by revision"
        )
    return found


def _answer(project: Project, task: str) -> dict[str, str]:
    """An answer in short lines, by what they are about."""
    rows = answer_of(project, task).sort("place")
    (head,) = rows.filter(kind="answer").iter_rows(named=True)
    lines = {"answer": head["statement"], "verdict": head["trust"]}
    summary = project.table(task, "weights_summary")
    if summary.exists():
        weights = read_table(summary, "weights_summary").filter(
            kind=GROUP, participant=ALL, model=LESS, quantity="weight"
        )
        for row in weights.iter_rows(named=True):
            lines[f"weight of {row['feature']}"] = f"{row['mean']:+.1f} ({row['low']:+.1f} to {row['high']:+.1f})"
    for row in rows.filter(pl.col("kind") == "check").iter_rows(named=True):
        question, _, outcome = row["statement"].partition(QUESTION)
        lines[question + QUESTION] = outcome.strip()
    return lines


def _show(wanted: Wanted, title: str, rows: list[Row]) -> None:
    from rich.table import Table

    table = Table(title=cell(title, "bold"), title_justify="left")
    for name in ("", wanted.first, wanted.second):
        table.add_column(cell(name), overflow="fold")
    for row in rows:
        style = "" if row[1] == row[2] else "bold"
        table.add_row(cell(row[0]), cell(row[1], style), cell(row[2], style))
    if not rows:
        table.add_row(cell("no difference"), cell(""), cell(""))
    show(table)


def _compared(pair: list[Project], task: str, names: tuple[str, str]) -> Compared | None:
    """The posteriors of a task in both, if both have them over the same hypotheses."""
    beliefs = [_beliefs(one, task) for one in pair]
    shared = [model for model in beliefs[0] if model in beliefs[1]]
    first = [found[shared[0]][0] for found in beliefs] if shared else []
    if not first or not np.array_equal(first[0].thetas, first[1].thetas):
        note(f"{task}: the two are over other hypotheses or models, so their posteriors are not shown together")
        return None
    features = tuple(read_table(pair[0].table(task, "scales"), "scales")["feature"].unique(maintain_order=True))
    return Compared(
        task,
        theta_labels(first[0].thetas, features),
        names if names[0] != names[1] else (f"{names[0]} ", names[1]),
        {model: _of_theta(beliefs[0][model], beliefs[1][model]) for model in shared},
    )


def _of_theta(one: list[Posterior], other: list[Posterior]) -> tuple[Any, Any]:
    first, second = (np.stack([belief.marginal_theta for belief in steps]) for steps in (one, other))
    return first, second


def _beliefs(project: Project, task: str) -> dict[str, list[Posterior]]:
    for name in ("demonstrations", "posteriors", "scales"):
        if not project.table(task, name).exists():
            return {}
    ids = tuple(read_table(project.table(task, "demonstrations"), "demonstrations")["demonstration_id"])
    with OpenTable(project.table(task, "posteriors"), "posteriors") as posteriors:
        return shown_beliefs(posteriors, project.table(task, "explored_posteriors"), ids)
