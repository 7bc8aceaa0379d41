"""The studies by name: what `lessbench study NAME [TASK]` runs."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module

from pipeline.errors import ParameterError, one_of
from pipeline.workspace.project import Project


@dataclass(frozen=True)
class Study:
    """A study: the module whose `run` it is, and whether that is run for one task at a time."""

    module: str
    per_task: bool


STUDIES = {
    "human-choice": Study("pipeline.stages.human_choice", per_task=False),
    "grid-world": Study("pipeline.stages.grid_world", per_task=False),
    "robustness": Study("pipeline.stages.robustness", per_task=True),
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
    import_module(study.module).run(project, *([task] if study.per_task else []))
