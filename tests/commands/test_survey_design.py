"""`lessbench survey design` and `weigh` on a small task and on the grid: from a design to what choices tell."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.commands.survey_design import design_grid, design_task, weigh
from pipeline.errors import SurveyError
from pipeline.stages import density, featurize, ingest, sample
from pipeline.survey.choices_file import COLUMNS
from pipeline.survey.questionnaire import Questionnaire, read_questionnaire
from pipeline.survey.task_options import TaskOptions
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]


@pytest.fixture
def project(make_project: Make, parameters: dict[str, Any]) -> Project:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5], "working_set": 60}
    project = make_project(parameters)
    for one in (ingest, sample, featurize, density):
        one.run(project, "sweep")
    return project


def made(project: Project, out: Path, **changes: Any) -> Questionnaire:
    settings: dict[str, Any] = {"trials": 3, "options": 3, "candidates": 80, "theta_share": 0.0} | changes
    design_task(project, "sweep", out=out, **settings)
    return read_questionnaire(out)


def rows_of(people: list[dict[str, str]], path: Path) -> Path:
    lines = [",".join(COLUMNS)]
    for number, chosen in enumerate(people):
        lines += [f"p{number},{trial},{choice},{choice},yes,,no,2026-01-01T00:00:00Z,1,1,1"
                  for trial, choice in chosen.items()]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_design_is_served_as_it_is_and_the_same_again(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = made(project, tmp_path / "one.yaml")
    said = capsys.readouterr().out
    assert "3 sets of 3 motions of sweep, picked from 80" in said
    assert said.count("people are enough to show it (likelihood ratio test, power 0.8, level 0.05)") == 2
    assert [len(trial.options) for trial in first.trials.values()] == [3, 3, 3]
    made(project, tmp_path / "two.yaml")
    assert (tmp_path / "one.yaml").read_bytes() == (tmp_path / "two.yaml").read_bytes()
    with pytest.raises(SurveyError, match=r"one\.yaml: is there already; name another file with --out"):
        made(project, tmp_path / "one.yaml")
    with pytest.raises(SurveyError, match="there is no such folder"):
        made(project, tmp_path / "no" / "one.yaml")


@pytest.mark.parametrize("truth", ["boltzmann", "less"])
def test_the_choices_of_people_who_follow_a_model_make_it_probable(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: str
) -> None:
    study = made(project, tmp_path / "study.yaml")
    known = TaskOptions.of(project, "sweep")
    model, rng = known.models.index(truth), np.random.default_rng(4)
    tables = {
        name: known.of_ids([str(option.alternative) for option in trial.options.values()])
        for name, trial in study.trials.items()
    }
    people = []
    for _ in range(400):
        k, b = rng.integers(len(known.thetas)), rng.integers(len(known.betas))
        names = {name: list(trial.options) for name, trial in study.trials.items()}
        people.append({name: names[name][rng.choice(3, p=p[model, k, b])] for name, p in tables.items()})
    capsys.readouterr()
    weigh(project, tmp_path / "study.yaml", rows_of(people, tmp_path / "choices.csv"))
    said = capsys.readouterr().out
    assert "1200 choices of 400 people in 3 sets" in said
    name = {"boltzmann": "Boltzmann", "less": "LESS"}[truth]
    line = next(line for line in said.splitlines() if line.startswith(f"{name}: log evidence"))
    assert float(line.rpartition(" ")[2]) > 0.9


def test_choices_that_do_not_belong_to_the_study_are_refused(project: Project, tmp_path: Path) -> None:
    made(project, tmp_path / "study.yaml")
    for people, why in (
        ([{"set-9": "a"}], "line 2 has the trial 'set-9'; the study has set-1, set-2, set-3"),
        ([{"set-1": "z"}], "line 2 has the choice 'z' in set-1; it has a, b, c"),
        ([], "has no choice that can be used"),
    ):
        with pytest.raises(SurveyError, match=why):
            weigh(project, tmp_path / "study.yaml", rows_of(people, tmp_path / "c.csv"))
    twice = rows_of([{"set-1": "a"}], tmp_path / "c.csv")
    twice.write_text(twice.read_text() + twice.read_text().splitlines()[1] + "\n")
    with pytest.raises(SurveyError, match="line 3 is a second choice of 'p0' in set-1"):
        weigh(project, tmp_path / "study.yaml", twice)
    twice.write_bytes(b"\xff\xfe")
    with pytest.raises(SurveyError, match="no text in UTF-8"):
        weigh(project, tmp_path / "study.yaml", twice)
    twice.write_text("participant,trial\np,set-1\n")
    with pytest.raises(SurveyError, match="line 2 has not all of participant, trial, choice"):
        weigh(project, tmp_path / "study.yaml", twice)
    design_grid(project, options=4, out=tmp_path / "grid.yaml")
    with pytest.raises(SurveyError, match="is not a study of the motions of one task; `lessbench study human-choice"):
        weigh(project, tmp_path / "grid.yaml", twice)


def test_without_tables_it_says_how_to_make_them(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    with pytest.raises(SurveyError, match="there is no such table; make it with `dvc repro` or `lessbench run sweep`"):
        made(project, project.root / "study.yaml")


def test_the_design_of_a_grid_says_how_many_people_decide(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    design_grid(project, options=4, out=tmp_path / "grid.yaml")
    said = capsys.readouterr().out
    assert "1 on the left and 3 on the right" in said  # as in the paper
    assert "44 people in the experimental trial are enough to show that the other model is wrong" in said
    study = read_questionnaire(tmp_path / "grid.yaml")
    assert set(study.trials) == {"control", "experimental"}
    groups = [option.group for option in study.trials["experimental"].options.values() if not option.attention]
    assert groups == ["left", "right", "right", "right"]
