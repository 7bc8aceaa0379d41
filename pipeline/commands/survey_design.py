"""`lessbench survey design` and `weigh`: choose what to ask people about, and say what their choices tell."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import SurveyError
from pipeline.formats.files.atomic import written_whole
from pipeline.studies.choice_design import (
    Design,
    candidate_sets,
    design,
    log_evidence,
    people_to_tell,
)
from pipeline.studies.model_evidence import people_needed
from pipeline.survey.choices_file import COLUMNS, MOST_BYTES
from pipeline.survey.grid_design import GridDesign, grid_design
from pipeline.survey.questionnaire import PAPER, Option, Questionnaire, Trial, read_questionnaire
from pipeline.survey.task_options import TaskOptions
from pipeline.terminal import say
from pipeline.trajectories.random_streams import child_rng
from pipeline.vocabulary import model_name
from pipeline.workspace.project import Project

LEVEL, POWER = 0.05, 0.8
TURNS = 3  # of the paths of the paper's study


def design_task(
    project: Project, task: str, *, trials: int, options: int, candidates: int, theta_share: float, out: Path
) -> None:
    """Write a study of a task's motions on which the models disagree most, and say how many people decide it.

    Args:
        project: of the task.
        task: its name.
        trials: how many sets each person is asked about.
        options: motions of each set.
        candidates: how many sets are looked at.
        theta_share: how much information about theta counts beside that about the model, from 0 to 1.
        out: YAML file, which must not be there.

    Raises:
        SurveyError: the file is there, or the task has not the tables.
        ArgumentError: a number is out of range.
    """
    _require_new(out)
    known = TaskOptions.of(project, task)
    anchor = max(known.ids, key=lambda name: len(known.ids[name]))
    rng = child_rng(project.params.seed, "survey design", trials, options, candidates)
    sets = candidate_sets(known.features[anchor], options, candidates, rng)
    made = design([known.probabilities(anchor, rows) for rows in sets], trials, theta_share)
    asked = {}
    for number, index in enumerate(made.sets, 1):
        order = rng.permutation(len(sets[index]))  # near ones do not stand together
        rows = [sets[index][place] for place in order]
        named = zip("abcdefghijkl", rows, strict=False)
        asked[f"set-{number}"] = Trial(
            task=task, options={name: Option(alternative=known.ids[anchor][row]) for name, row in named}
        )
    questionnaire = Questionnaire(
        title="Which motion would you want?", show="all", minutes=max(trials // 2, 2), trials=asked
    )
    said = [f"{trials} sets of {options} motions of {task}, picked from {len(sets):,}", *_told(known, made)]
    _write(out, questionnaire, said)
    for line in said:
        say(line)
    say(f"written to {out}; serve it with `lessbench survey --study {out} --choices choices.csv`")


def design_grid(project: Project, *, options: int, out: Path) -> None:
    """Write a study of section 3 with the numbers of paths on which the models disagree most.

    Raises:
        SurveyError: the file is there, or the grid has too few paths.
    """
    _require_new(out)
    paper = read_questionnaire(PAPER).trials["control"]
    test = next(option.moves for option in paper.options.values() if option.attention)
    assert paper.grid is not None
    assert test is not None
    made = grid_design(paper.grid, test, options, TURNS, child_rng(project.params.seed, "survey design", "grid"))
    said = _of_grid(made)
    _write(out, made.questionnaire, said)
    for line in said:
        say(line)
    say(f"written to {out}; serve it with `lessbench survey --study {out} --choices choices.csv`")


def weigh(project: Project, study: Path, choices: Path) -> None:
    """Say how probable the models of a task's study are after the choices in a file.

    Raises:
        SurveyError: a file is not what it should be, or the study is not about motions of one task.
    """
    questionnaire = read_questionnaire(study)
    tasks = {trial.task for trial in questionnaire.trials.values()}
    task = tasks.pop()
    if tasks or task is None:
        raise SurveyError(
            f"{study}: is not a study of the motions of one task; `lessbench study human-choice --choices "
            f"{choices}` reads studies of grids"
        )
    known = TaskOptions.of(project, task)
    trials = list(questionnaire.trials)
    options = {name: list(trial.options) for name, trial in questionnaire.trials.items()}
    tables = [
        known.of_ids([str(option.alternative) for option in trial.options.values()])
        for trial in questionnaire.trials.values()
    ]
    people = _answers(choices, options)
    answers = [[(trials.index(trial), options[trial].index(choice)) for trial, choice in one] for one in people]
    evidence = log_evidence(tables, answers)
    posterior = np.exp(evidence - evidence.max())
    posterior /= posterior.sum()
    say(f"{sum(map(len, answers))} choices of {len(answers)} people in {len(trials)} sets")
    for model, log_e, p in zip(known.models, evidence, posterior, strict=True):
        say(f"{model_name(model)}: log evidence {log_e:.2f} nats, posterior probability {p:.3f}")
    say("Each person has a theta and a beta of their own, from the values in params.yaml, equally probable beforehand.")


def _answers(path: Path, options: dict[str, list[str]]) -> list[list[tuple[str, str]]]:
    """Trial and choice of each person's choices that count.

    Raises:
        SurveyError: the file is none of a survey, or has a trial or an option that the study has not.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise SurveyError(f"{path}: is larger than {MOST_BYTES:,} bytes")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SurveyError(f"{path}: cannot be read ({(error.strerror or str(error)).lower()})") from None
    except UnicodeDecodeError:
        raise SurveyError(f"{path}: is no text in UTF-8") from None
    try:
        rows = list(csv.DictReader(io.StringIO(text)))
    except csv.Error as error:
        raise SurveyError(f"{path}: cannot be read as CSV ({error})") from None
    people: dict[str, dict[str, str]] = {}
    for number, row in enumerate(rows, 2):
        values: dict[str, Any] = {name: row.get(name) for name in COLUMNS[:5]}
        if not all(isinstance(value, str) for value in values.values()):
            raise SurveyError(f"{path}: line {number} has not all of {', '.join(COLUMNS[:5])}")
        trial, choice = values["trial"], values["choice"]
        if trial not in options:
            raise SurveyError(f"{path}: line {number} has the trial {trial!r}; the study has {', '.join(options)}")
        if choice not in options[trial]:
            raise SurveyError(
                f"{path}: line {number} has the choice {choice!r} in {trial}; it has {', '.join(options[trial])}"
            )
        given = people.setdefault(values["participant"], {})
        if trial in given:
            raise SurveyError(f"{path}: line {number} is a second choice of {values['participant']!r} in {trial}")
        if values["counted"] != "no":
            given[trial] = choice
    if not any(people.values()):
        raise SurveyError(f"{path}: has no choice that can be used")
    return [list(given.items()) for given in people.values() if given]


def _told(known: TaskOptions, made: Design) -> list[str]:
    lines = [
        f"after set {number}, one person tells {model:.3f} of {np.log(len(known.models)):.3f} nats about the model and "
        f"{theta:.3f} of {np.log(len(known.thetas)):.3f} about theta (expected)"
        for number, (model, theta) in enumerate(zip(made.about_model, made.about_theta, strict=True), 1)
    ]
    for truth, one in enumerate(known.models):
        for other, two in enumerate(known.models):
            if truth != other:
                needed = people_to_tell(made.answers, truth, other, LEVEL, POWER)
                people = (
                    "no number of people is enough" if needed is None else f"{needed:,} people are enough to show it"
                )
                lines.append(
                    f"if {model_name(one)} is right and {model_name(two)} is not, {people} (likelihood ratio test, "
                    f"power {POWER:g}, level {LEVEL:g})"
                )
    return lines


def _of_grid(made: GridDesign) -> list[str]:
    boltzmann, less = made.predicted
    lines = [
        f"paths of the experimental trial: {made.left} on the left and {made.right} on the right",
        f"one choice tells {made.about_model:.3f} of {np.log(2):.3f} nats about the model (mean over the shares of the "
        "control trial)",
    ]
    for name, truth, other in (("Boltzmann", boltzmann, less), ("LESS", less, boltzmann)):
        needed = people_needed(truth, other, LEVEL, POWER)
        lines.append(
            f"if {name} is right and the control trial is divided equally, {needed} people in the experimental trial "
            f"are enough to show that the other model is wrong (chi-square, power {POWER:g}, level {LEVEL:g})"
        )
    return lines


def _require_new(out: Path) -> None:
    if out.exists() or out.is_symlink():
        raise SurveyError(f"{out}: is there already; name another file with --out")
    if not out.resolve().parent.is_dir():
        raise SurveyError(f"{out.resolve().parent}: there is no such folder; make it, or name another file with --out")


def _write(out: Path, questionnaire: Questionnaire, said: list[str]) -> None:
    from ruamel.yaml import YAML

    text = io.StringIO()
    writer: Any = YAML(typ="safe", pure=True)
    writer.default_flow_style, writer.sort_base_mapping_type_on_output = None, False
    writer.dump(questionnaire.model_dump(mode="json", exclude_defaults=True), text)
    header = "".join(f"# {line}\n" for line in said)
    with written_whole(out) as stream:
        stream.write((header + text.getvalue()).encode())
    read_questionnaire(out)
