"""Answers over the explored space, the working set and each other sampler's alternatives, against the true weights of
simulated people: `python -m benchmarks.answer_over_space [TASK ...]`, from the tables of a finished run.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.explained import explain
from benchmarks.measuring import show
from pipeline.answers.assessment import Case, choices_from
from pipeline.answers.words import stated_signs
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.metrics import angle_to
from pipeline.choice.weights import Choices, sample_group
from pipeline.choice.weights.choices import SeparateChoices
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.answer import case_of
from pipeline.stages.registry import parameters
from pipeline.workspace.choice_sets import choice_tables, read_choices
from pipeline.workspace.project import find_project


def main() -> None:
    project = find_project(Path.cwd())
    for name in sys.argv[1:] or list(project.params.tasks):
        with TaskTables(choice_tables(project, name)) as tables:
            case = case_of(read_choices(tables, project, parameters("explore", name)))
        if case.truth is None or case.space is None:
            print(f"{name}: its people's true weights are not known, or its choice space is not explored")
            continue
        mean = case.truth.mean(axis=0)
        rows = []
        for label, choices in ways(case):
            parts = [choices.subset(own) for own in case.groups().values()]
            found = sample_group(np.random.default_rng(1), parts, count=512).group
            signs, angle = stated_signs(found), angle_to(found.direction, mean)
            wrong = int((np.sign(mean) * signs < 0).sum())
            stated = f"{int(np.abs(signs).sum())} ({wrong})"
            rows.append((label, f"{np.degrees(angle):.0f}", f"{np.degrees(found.cap(0.9)):.0f}", stated))
        show(name, ("alternatives", "degrees to the truth", "said to hold 0.9", "stated signs (wrong)"), rows)


def ways(case: Case) -> Iterator[tuple[str, Choices | SeparateChoices]]:
    """What people may be taken to have chosen from, and what they chose."""
    assert case.space is not None
    yield "explored space, LESS", case.considered(LESS(case.sigma))
    yield "explored space, Boltzmann", case.considered(Boltzmann())
    yield "working set, LESS", choices_from(LESS(case.sigma), case.chosen, case.rows)
    yield "working set, Boltzmann", choices_from(Boltzmann(), case.chosen, case.rows)
    for number, sets in enumerate(case.others):
        yield f"sampler {number}, LESS", choices_from(LESS(), case.chosen, sets)


if __name__ == "__main__":
    explain(__doc__)
    main()
