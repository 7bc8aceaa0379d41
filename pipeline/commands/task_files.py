"""The files of a project that name every task, when a task comes or goes."""

from __future__ import annotations

from pipeline.formats.files.atomic import written_whole
from pipeline.stages import dvc_yaml
from pipeline.workspace.project import Project


def dvc_follows(before: Project) -> str | None:
    """Let the stages of the whole project wait for the tasks there are now, as DVC cannot list them by itself.

    Args:
        before: the project as it was read before its tasks changed.

    Returns:
        what to do, if dvc.yaml has been changed by hand where this should stand.
    """
    file = before.root / dvc_yaml.FILE
    if not file.is_file():
        return None
    text = file.read_text(encoding="utf-8")
    parts = dvc_yaml.of_all_tasks(before.params), dvc_yaml.of_all_tasks(Project(before.root).params)
    for old, new in zip(*parts, strict=True):
        if old not in text:
            return (
                f"{dvc_yaml.FILE} is not as `python -m pipeline.stages.dvc_yaml` writes it, so its catalog will not "
                "follow: write it anew with that command, or name the tasks in its last stages by hand"
            )
        text = text.replace(old, new)
    with written_whole(file) as stream:
        stream.write(text.encode())
    return None
