"""`lessbench calibrate`: what as many demonstrations as these could tell, from these alternatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.answers.calibration import LEVEL, Calibration, calibrate
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.models import Model
from pipeline.errors import StageError
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.registry import parameters
from pipeline.terminal import say
from pipeline.trajectories.random_streams import child_rng
from pipeline.vocabulary import TASK_ANCHOR, model_name
from pipeline.workspace.choice_sets import choice_tables, read_choices
from pipeline.workspace.project import Project

ODDS = 10
APART_DEG = 45.0


@dataclass(frozen=True)
class Wanted:
    """What to simulate.

    Attributes:
        demonstrations: in each repetition; None: as many as the task has.
        repetitions: for each model that people may choose by.
    """

    demonstrations: int | None
    repetitions: int


def run(project: Project, name: str, wanted: Wanted) -> None:
    """Simulate people on the task's own alternatives, infer them back, and say how well that went.

    Raises:
        StageError: each demonstration has alternatives of its own.
        TableError: a table is missing or not what it should be.
    """
    task = project.params.task(name)
    if task.anchor != TASK_ANCHOR:
        raise StageError(
            f"tasks.{name}.anchor is {task.anchor}: each demonstration has alternatives of its own, and people are "
            "simulated on alternatives that all share; set it to task"
        )
    with TaskTables(choice_tables(project, name)) as tables:
        tables.check()
        chosen = read_choices(tables, project, parameters("explore", name))
    count = wanted.demonstrations or len(chosen.people)
    rng = child_rng(project.params.seed, "calibrate", count)
    own = chosen.sets[TASK_ANCHOR]
    models: dict[str, Model] = {LESS.name: LESS(own.bandwidth), Boltzmann.name: Boltzmann()}
    found = calibrate(rng, models, own.raw / chosen.scale, count, wanted.repetitions)
    for line in lines(name, found, count, f"who choose from {len(own.raw):,} sampled alternatives"):
        say(line)


def lines(name: str, found: Calibration, demonstrations: int, what: str) -> list[str]:
    """What a calibration says, in words.

    Args:
        name: of the task.
        found: the calibration.
        demonstrations: of each repetition.
        what: people choose from.
    """
    labels = list(dict.fromkeys(chosen_by for chosen_by, _ in found.recoveries))
    repetitions = len(found.recoveries[labels[0], labels[0]].angle)
    counted = f"{demonstrations} demonstration" + ("s" if demonstrations != 1 else "")
    said = [
        f"{name}: {repetitions} simulated people for each model, {what}; {counted} each, weights drawn from the prior"
    ]
    for label, other in zip(labels, reversed(labels), strict=True):
        told, own = found.comparison(label, other), found.recoveries[label, label]
        narrow = float((np.degrees(own.cap) <= APART_DEG).mean())
        said += [
            f"if people choose by {model_name(label)}:",
            f"  {model_name(label)} is favoured in {_percent(told.favoured)} of the repetitions, by {ODDS} to 1 or "
            f"more in {_percent(told.told(ODDS))}; {model_name(other)} is wrongly favoured by {ODDS} to 1 or more in "
            f"{_percent(told.misled(ODDS))}",
            f"  the direction found is {np.degrees(np.median(own.angle)):.0f} degrees from the true one (median); the "
            f"angle that should hold it with probability {LEVEL:g} is {np.degrees(np.median(own.cap)):.0f}, and holds "
            f"it in {_percent(own.coverage())}",
            f"  weights {APART_DEG:.0f} degrees apart can be told from each other in {_percent(narrow)}",
            f"  if {model_name(other)} infers, the angle holds it in "
            f"{_percent(found.recoveries[label, other].coverage())}",
        ]
    verdict = min(found.comparison(label, other).told(ODDS) for label, other in zip(labels, labels[::-1], strict=True))
    can = "would" if verdict >= 0.5 else "would rarely" if verdict < 0.25 else "would sometimes"
    said.append(f"so {counted} {can} tell {' from '.join(map(model_name, labels))}")
    return said


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
