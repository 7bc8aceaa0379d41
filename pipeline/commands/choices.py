"""`lessbench study human-choice --choices FILE`: what a file of choices tells, on the terminal; no table is changed."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from pipeline.stages.human_choice import read_choices
from pipeline.studies.human_choice import analyse_choices, counted
from pipeline.studies.model_evidence import evidence
from pipeline.vocabulary import BOLTZMANN, LESS, model_name

NAMES = {model: model_name(model) for model in (BOLTZMANN, LESS)}
ALPHA, POWER = 0.05, 0.8


def told(source: Path) -> list[str]:
    """The lines to print.

    Raises:
        StageError: the file is missing or is no CSV.
        TableError: the choices are not as `analyse_choices` wants them.
    """
    choices = read_choices(source)
    study = analyse_choices(choices)
    left_out = choices.height - counted(choices).height
    control, n = int(study.control["count"].sum()), int(study.tests["n"][0])
    lines = [
        f"{control} people in the control trial, {n} in the experimental one"
        + (f"; {left_out} more failed the attention test and are left out" if left_out else "")
    ]
    options = study.predictions.filter(pl.col("comparison") == "options")
    boltzmann, less = (options.filter(pl.col("model") == model) for model in NAMES)
    for row, other in zip(less.iter_rows(named=True), boltzmann["predicted"], strict=True):
        lines.append(
            f"  {row['option']} ({row['group']}): chosen by {row['count']} = {row['observed']:.3f}; "
            f"Boltzmann predicts {other:.3f}, LESS {row['predicted']:.3f}"
        )
    for test in study.tests.iter_rows(named=True):
        lines.append(
            f"{NAMES[test['model']]}, {test['comparison']}: chi-square({test['degrees_of_freedom']}, "
            f"N = {test['n']}) = {test['chi_square']:.2f}, {_p(test['p_value'])}; Wellek's least epsilon "
            f"{test['minimum_epsilon']:.2f}"
        )
    found = evidence(study, ALPHA, POWER)
    for model, name in NAMES.items():
        more = found.more_people[model]
        people = "no number of people up to a million tells" if more is None else f"{more} more people would show it"
        lines.append(
            f"{name}: posterior probability {found.posterior[model]:.3f}; if it is right, {people} "
            f"(power {POWER:g}, level {ALPHA:g})"
        )
    return lines


def _p(p: float) -> str:
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
