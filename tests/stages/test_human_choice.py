"""The file of choices as people write it: numbers as labels, blanks, names that look alike, options nobody chose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import StageError, TableError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import human_choice
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]
ROWS = [
    *[("control", "1", "1")] * 3, *[("control", "2", "2")] * 5,
    *[("experimental", "01", "1")] * 4, *[("experimental", "2", "2")] * 3,
]  # fmt: skip


def lines(rows: list[tuple[str, str, str]] = ROWS) -> list[str]:
    return ["participant,trial,choice,group", *(f"{n},{','.join(row)}" for n, row in enumerate(rows))]


def analysed(project: Project, text: list[str]) -> Path:
    (project.root / "choices.csv").write_text("\n".join(text), encoding="utf-8")
    human_choice.run(project)
    return project.table(STUDIES, "human_choice_predictions")


def test_numbers_are_names(make_project: Make, parameters: dict[str, Any]) -> None:
    table = read_table(analysed(make_project(parameters), lines()), "human_choice_predictions")
    assert table.filter(comparison="options", model="less")["option"].to_list() == ["01", "2"]


def test_blanks_around_cells_mean_nothing(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    plain = analysed(project, lines()).read_bytes()
    rows = [" participant ,trial , choice,group\t", *(line.replace(",", " ,\t") + "  " for line in lines()[1:])]
    analysed(project, rows)
    again = read_table(project.table(STUDIES, "human_choice_predictions"), "human_choice_predictions")
    project.table(STUDIES, "human_choice_predictions").write_bytes(plain)
    assert again.equals(read_table(project.table(STUDIES, "human_choice_predictions"), "human_choice_predictions"))


def test_options_that_nobody_chose(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["studies"]["human_choice"]["options"] = {"1": ["01", "02"], "2": ["2"]}
    table = read_table(analysed(make_project(parameters), lines()), "human_choice_predictions")
    boltzmann = table.filter(comparison="options", model="boltzmann")
    assert boltzmann.select("option", "count").rows() == [("01", 4), ("02", 0), ("2", 3)]
    # rewards log 3/8 for both options of the first group and log 5/8 for the second's
    assert boltzmann["predicted"].to_list() == pytest.approx([3 / 11, 3 / 11, 5 / 11], rel=1e-12)
    less = table.filter(comparison="options", model="less")["predicted"].to_list()
    assert less == pytest.approx([3 / 16, 3 / 16, 5 / 8], rel=1e-12)


def test_a_choice_beside_the_options_is_refused(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["studies"]["human_choice"]["options"] = {"1": ["02"], "2": ["2"]}
    with pytest.raises(TableError, match=r"the choice '01' of the group '1' is not among the options on offer"):
        analysed(make_project(parameters), lines())


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("7,control,Left,left", "the column 'choice' has"),
        ("P1,control,2,2\np1,control,2,2", "the column 'participant' has 'P1' and 'p1', which differ only in case"),
        ("7,control,caf\u00e9,2\n8,control,cafe\u0301,2", "the column 'choice' has"),
        ("7,Control,2,2", "the column 'trial' has 'control' and 'Control'"),
    ],
)
def test_names_that_look_alike_are_refused(
    make_project: Make, parameters: dict[str, Any], row: str, message: str
) -> None:
    more = [("control", "left", "left")] if "Left" in row else []
    with pytest.raises(StageError, match=message):
        analysed(make_project(parameters), [*lines([*ROWS[:6], *more]), *row.split("\n")])


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        (["participant,trial,choice,choice ", "1,control,a,a"], StageError, "has the column 'choice' twice"),
        (["participant,trial,choice,group", "1,control,  ,a"], TableError, "no 'choice' in row 1"),
        (["participant;trial;choice;group", "1;control;a;a"], TableError, "lacks the column 'participant'"),
        (["participant,trial,choice,group", '1,control,"a'], StageError, "cannot be read as CSV"),
    ],
)
def test_a_file_that_is_not_as_asked(
    make_project: Make, parameters: dict[str, Any], text: list[str], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        analysed(make_project(parameters), text)
