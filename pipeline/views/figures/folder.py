"""Writes the figures of a task, or of the studies, into their folder, and the headline numbers beside it."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.files.json_metrics import write_metrics
from pipeline.views.figures.captions import CAPTIONS
from pipeline.views.figures.style import Figure, write_figure
from pipeline.views.headline import Numbers
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project


def write_figures(project: Project, name: str, figures: Mapping[str, Figure], numbers: Numbers) -> None:
    """Replace the folder of figures by these, each with its caption beside it, and write metrics.json.

    Args:
        project: the project.
        name: name of a task, or `studies`.
        figures: the figures by the names of their files.
        numbers: the headline numbers, see `pipeline.views.headline`.
    """
    with folder_written_whole(project.figures(name)) as partial:
        for file_name, figure in tracked(list(figures.items()), f"figures {name}"):
            write_figure(partial, file_name, figure, CAPTIONS[file_name])
    write_metrics(project.metrics(name), numbers)
