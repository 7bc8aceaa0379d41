"""The figures of a task, or of the studies, in their folder, with the headline numbers beside it."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.files.json_metrics import write_metrics
from pipeline.views.figures.style import Figure, write_figure
from pipeline.views.headline import Numbers
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project


def write_figures(project: Project, name: str, figures: Mapping[str, Figure], numbers: Numbers) -> None:
    """Write the figures as SVG and PNG, in place of those that were there, and metrics.json.

    Args:
        project: where.
        name: a task, or `studies`.
        figures: by the names of their files.
        numbers: see `pipeline.views.headline`.
    """
    with folder_written_whole(project.figures(name)) as partial:
        for title, figure in tracked(list(figures.items()), f"figures {name}"):
            write_figure(partial, title, figure)
    write_metrics(project.metrics(name), numbers)
