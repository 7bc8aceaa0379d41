"""Stage: one file that tells what was run, what came out and what to be careful about."""

from __future__ import annotations

from pipeline.views.report.contents import report
from pipeline.views.report.html import write_report
from pipeline.vocabulary import ALL
from pipeline.workspace.project import Project, recorded_run


def run(project: Project) -> None:
    """Write datasets/report.html from the catalog, the figures and the headline numbers."""
    with recorded_run(project, "report", ALL, (project.datasets / "report.html",)) as record:
        size = write_report(project.datasets / "report.html", report(project))
        record.produced = f"{size / 1e6:.1f} MB"
