"""The studies by name: what `lessbench study NAME [TASK]` runs."""

from __future__ import annotations

from pipeline.errors import ParameterError, one_of
from pipeline.stages.registry import BY_COMMAND, STAGES
from pipeline.workspace.project import Project

COMMAND = "study "
STUDIES = {
    stage.command.removeprefix(COMMAND): stage for stage in (*STAGES, *BY_COMMAND) if stage.command.startswith(COMMAND)
}


def run(project: Project, name: str, task: str | None) -> None:
    """Run the study `name`, for `task` if it is one that is run per task.

    Raises:
        ParameterError: there is no such study, or a task is missing or too much.
    """
    study = STUDIES.get(name)
    if study is None:
        raise ParameterError(f"there is no study {name!r}; there are {one_of(STUDIES)}")
    if study.per_task and task is None:
        raise ParameterError(f"the study {name} needs a task; there are {one_of(project.params.tasks)}")
    if not study.per_task and task is not None:
        raise ParameterError(f"the study {name} takes no task; leave {task!r} out")
    study.run(project, task)
