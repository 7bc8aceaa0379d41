"""All stages of one task, one after another, for parameters that DVC does not watch."""

from __future__ import annotations

from pipeline.errors import ParameterError
from pipeline.stages.registry import STAGES, Scope
from pipeline.workspace.project import Project


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
    for stage in STAGES:
        if stage.scope is Scope.TASK:
            stage.run(project, name)
