"""`lessbench survey`: serve a browser study, and keep what people choose."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.commands.serve import interrupted
from pipeline.errors import SurveyError, few_of
from pipeline.formats.files.lock import held
from pipeline.formats.parquet.tables import read_table
from pipeline.survey.choices_file import ChoicesFile
from pipeline.survey.clips import clips
from pipeline.survey.questionnaire import PAPER, Questionnaire, Trial, read_questionnaire
from pipeline.survey.server import serving
from pipeline.survey.visits import Visits
from pipeline.survey.words import read_words
from pipeline.terminal import say
from pipeline.views.rerun.server import claim
from pipeline.workspace.project import Project, find_project
from pipeline.workspace.scenes import load_task_scene


def serve_survey(study: Path | None, choices: Path, words: str, bind: str, port: int) -> None:
    """Serve a study until Ctrl-C; what people choose is in the file `choices`.

    Args:
        study: YAML file; the study of section 3 of the paper if None.
        choices: CSV file that grows by a line for each choice.
        words: language of the page, or a YAML file with its words.
        bind: address to listen at.
        port: 0 for any that is free.

    Raises:
        SurveyError: the study, the words or the file is not what it should be.
        StageError: the address cannot be had, or another server is writing the same file.
    """
    questionnaire = read_questionnaire(study or PAPER)
    texts = read_words(words)
    address = claim(bind, port)
    drawings = _drawings(questionnaire)
    folder = choices.resolve().parent
    if not folder.is_dir():
        raise SurveyError(f"{folder}: there is no such folder; make it, or name another file with --choices")
    with held(folder / f".{choices.name}.lock", f"the survey into {choices}", folder):
        file = ChoicesFile(folder / choices.name)
        visits = Visits(questionnaire, file, lambda trial, option: drawings[trial][option])
        with interrupted() as stop, serving(address.bind, address.port, visits, texts) as server:
            if not address.local:
                say(
                    f"warning: {address.bind} can be reached from other machines, without encryption; put a server "
                    "that speaks HTTPS in front of it before people you do not know take part",
                    error=True,
                )
            say(f"the study is at http://{address.bind}:{server.server_port}/ and Ctrl-C ends it")
            say(f"for each person from elsewhere: http://{address.bind}:{server.server_port}/?code=THEIR-CODE")
            say(f"choices go to {choices}, which has {_count(file)} so far")
            stop.wait()
        asked = questionnaire.trials.values()
        of_task = all(trial.task for trial in asked) and len({trial.task for trial in asked}) == 1
        reader = f"survey weigh {study}" if of_task else "study human-choice --choices"
        say(f"{choices} has {_count(file)}; `lessbench {reader} {choices}` says what they tell")


def _count(file: ChoicesFile) -> str:
    choices = sum(len(chosen) for chosen in file.chosen.values())
    return f"{choices} choices of {len(file.chosen)} people"


def _drawings(questionnaire: Questionnaire) -> dict[str, dict[str, dict[str, object]]]:
    """By trial and option, for the trials of tasks."""
    trials = {name: trial for name, trial in questionnaire.trials.items() if trial.task}
    if not trials:
        return {}
    project = find_project(Path.cwd())
    return {name: _drawn(project, name, trial) for name, trial in trials.items()}


def _drawn(project: Project, name: str, trial: Trial) -> dict[str, dict[str, object]]:
    task = str(trial.task)
    scene = load_task_scene(project, project.params.task(task))
    table = read_table(project.table(task, "alternatives"), "alternatives", ["alternative_id", "waypoints"])
    wanted = {option: str(settings.alternative) for option, settings in trial.options.items()}
    found = table.filter(table["alternative_id"].is_in(list(wanted.values())))
    rows: dict[str, FloatArray] = {
        row["alternative_id"]: np.array(row["waypoints"], dtype=np.float64) for row in found.iter_rows(named=True)
    }
    if missing := [alternative for alternative in wanted.values() if alternative not in rows]:
        raise SurveyError(f"trial {name}: the alternatives of {task} have no {few_of(missing)}")
    return clips(scene, {option: rows[alternative] for option, alternative in wanted.items()})
