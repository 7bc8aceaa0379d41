"""All stages of one task, one after another, for parameters that DVC does not watch."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.errors import ParameterError
from pipeline.stages.registry import STAGES, Scope, stage
from pipeline.workspace.project import Project


def run_all(project: Project, names: Sequence[str]) -> None:
    """Run the tasks `names` through all stages, draw their sets again and again, and gather what came out.

    Args:
        project: its parameters have the tasks.
        names: of the tasks.

    Raises:
        ParameterError: see `run_task`.
    """
    redrawn = project.params.robustness.redraws is not None
    for name in names:
        run_task(project, name)
        if redrawn:
            stage("redraws").run(project, name)
    stage("catalog").run(project)
    if redrawn:
        stage("section-5").run(project)


def run_task(project: Project, name: str) -> None:
    """Run the stages of the task `name`, from its scene and recordings to its figures and its recording for the viewer.

    Raises:
        ParameterError: there is no such task, or a late stage needs a set of alternatives that an early one does not
            draw.
    """
    project.params.task(name)
    copied, sizes = project.params.robustness.duplicates.set_size, project.params.sample.sizes
    if copied not in sizes:  # asked by one of the last stages, and better known before the first
        raise ParameterError(
            f"robustness.duplicates.set_size is {copied}; it must be one of sample.sizes, {', '.join(map(str, sizes))}"
        )
    for one in STAGES:
        if one.scope is Scope.TASK:
            one.run(project, name)
