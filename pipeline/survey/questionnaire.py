"""What a study asks: its trials and their options, from a YAML file of plain data.

An option is a path through a grid, written as moves (U, D, L, R for one cell up, down, left, right), or a trajectory
of a task, named by its row in the task's alternatives. Options of one trial are drawn alike.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from pipeline.errors import SurveyError
from pipeline.yaml_text import YamlError, plain_yaml

LARGEST_BYTES = 1_000_000
MOST_OPTIONS, MOST_TRIALS, MOST_MOVES, MOST_CELLS = 12, 200, 500, 40
PAPER = Path(__file__).with_name("paper.yaml")
MOVES: Mapping[str, tuple[int, int]] = {"U": (0, 1), "D": (0, -1), "L": (-1, 0), "R": (1, 0)}
TURNED = str.maketrans("UDLR", "RLDU")  # mirrored at the diagonal through the start

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,60}$")]
Cell = tuple[Annotated[int, Field(ge=0, lt=MOST_CELLS)], Annotated[int, Field(ge=0, lt=MOST_CELLS)]]
Side = Annotated[int, Field(ge=2, le=MOST_CELLS)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Grid(_Part):
    """A grid of cells, column and row counted from the lower left; obstacles are filled."""

    columns: Side
    rows: Side
    start: Cell
    goal: Cell
    obstacles: list[Cell] = []

    def mirrored(self) -> Grid:
        """The same, with columns and rows exchanged."""

        def turn(cell: Cell) -> Cell:
            return cell[1], cell[0]

        return Grid(
            columns=self.rows, rows=self.columns, start=turn(self.start), goal=turn(self.goal),
            obstacles=[turn(cell) for cell in self.obstacles],
        )  # fmt: skip


class Option(_Part):
    """One thing to choose.

    `group` is what it resembles, for the analysis; the option's own name unless stated. Whoever chooses an option with
    `attention: true` has not followed the instructions; their choice is kept and not counted.
    """

    moves: Annotated[str, Field(pattern=r"^[UDLR]+$", max_length=MOST_MOVES)] | None = None
    alternative: Annotated[str, Field(max_length=200)] | None = None
    group: Name | None = None
    attention: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> Option:
        if (self.moves is None) == (self.alternative is None):
            raise ValueError("an option has either `moves` or `alternative`")
        return self


class Trial(_Part):
    """One question: options in a grid, or trajectories of a task."""

    grid: Grid | None = None
    task: Name | None = None
    options: Annotated[dict[Name, Option], Field(min_length=2, max_length=MOST_OPTIONS)]

    @model_validator(mode="after")
    def _fits(self) -> Trial:
        if (self.grid is None) == (self.task is None):
            raise ValueError("a trial has either a `grid` or a `task`")
        for name, option in self.options.items():
            if (option.moves is None) != (self.grid is None):
                raise ValueError(f"option {name}: moves need a `grid`, an alternative needs a `task`")
            if self.grid is not None and option.moves is not None:
                _check_path(self.grid, option.moves, name)
        if all(option.attention for option in self.options.values()):
            raise ValueError("every option is marked `attention`, so no choice would count")
        return self


class Questionnaire(_Part):
    """A study. `show: one` asks each person one of the trials, balanced over people; `all` asks every trial."""

    title: Annotated[str, Field(min_length=1, max_length=200)]
    show: Literal["one", "all"] = "one"
    mirror: bool = False
    minutes: Annotated[int, Field(ge=1, le=240)] = 2
    contact: Annotated[str, Field(max_length=300)] | None = None
    trials: Annotated[dict[Name, Trial], Field(min_length=1, max_length=MOST_TRIALS)]

    @model_validator(mode="after")
    def _mirrors_grids_alone(self) -> Questionnaire:
        if self.mirror and any(trial.task for trial in self.trials.values()):
            raise ValueError("`mirror` exchanges the sides of grids; a task has none, so leave it out")
        return self


def read_questionnaire(path: Path) -> Questionnaire:
    """The study in a YAML file.

    Raises:
        SurveyError: it is missing, is no YAML, or something in it is not as described above.
    """
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise SurveyError(f"{path}: is larger than {LARGEST_BYTES:,} bytes; a study is a page of text")
        document = plain_yaml(path.read_text(encoding="utf-8"))
        return Questionnaire.model_validate(document)
    except OSError as error:
        raise SurveyError(f"{path}: cannot be read ({(error.strerror or str(error)).lower()})") from None
    except UnicodeDecodeError:
        raise SurveyError(f"{path}: is no text in UTF-8") from None
    except YamlError as error:
        raise SurveyError(f"{path}: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        raise SurveyError(f"{path}: {place}: {re.sub('^Value error, ', '', first['msg'])}") from None


def cells_of(grid: Grid, moves: str) -> list[Cell]:
    """The cells that a path goes through, the start first."""
    column, row = grid.start
    cells = [(column, row)]
    for move in moves:
        right, up = MOVES[move]
        column, row = column + right, row + up
        cells.append((column, row))
    return cells


def _check_path(grid: Grid, moves: str, name: str) -> None:
    cells = cells_of(grid, moves)
    if any(not (0 <= column < grid.columns and 0 <= row < grid.rows) for column, row in cells):
        raise ValueError(f"option {name}: the path leaves the grid")
    if cells[-1] != tuple(grid.goal):
        raise ValueError(f"option {name}: the path ends at {cells[-1]} and not at the goal {tuple(grid.goal)}")
