"""All stages of one task, one after another, for parameters that DVC does not watch."""

from __future__ import annotations

from importlib import import_module

from pipeline.errors import ParameterError
from pipeline.workspace.project import Project

CHAIN = ("ingest", "sample", "featurize", "density", "infer", "shift", "robustness", "figures", "inspect")


def run_task(project: Project, name: str) -> None:
    """Run the stages from the recordings of the task `name` to its figures and its recording for the viewer."""
    project.params.task(name)
    copied, sizes = project.params.robustness.duplicates.set_size, project.params.sample.sizes
    if copied not in sizes:  # asked by one of the last stages, and better known before the first
        raise ParameterError(
            f"robustness.duplicates.set_size is {copied}; it must be one of sample.sizes, {', '.join(map(str, sizes))}"
        )
    for stage in CHAIN:
        import_module(f"pipeline.stages.{stage}").run(project, name)
