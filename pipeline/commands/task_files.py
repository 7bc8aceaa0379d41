"""The files of a project that name every task, when a task comes or goes."""

from __future__ import annotations

from pipeline.formats.files.atomic import written_whole
from pipeline.stages import dvc_yaml
from pipeline.workspace.project import Project


class DvcFile:
    """dvc.yaml of a project whose tasks are about to change.

    Args:
        project: as it is before the change.
    """

    def __init__(self, project: Project) -> None:
        self._before, self._own = project, dict(project.own_tasks)
        self._states_all = dvc_yaml.states_all(project.params)
        self._files = _files(project)
        self._parts = dvc_yaml.of_all_tasks(project.params, self._own)

    def follow(self) -> str | None:
        """Let the stages of the whole project wait for the tasks there are now, as DVC cannot list them by itself.

        Returns:
            what to do, if dvc.yaml has been changed by hand where this should stand.
        """
        file = self._before.root / dvc_yaml.FILE
        if not file.is_file():
            return None
        after = Project(self._before.root)
        text = file.read_text(encoding="utf-8")
        others = dvc_yaml.states_all(after.params) != self._states_all or _files(after) != self._files
        if self._own or after.own_tasks or others:  # all stages change
            changed = text == dvc_yaml.dvc_yaml(self._before.params, self._own)
            text = dvc_yaml.dvc_yaml(after.params, after.own_tasks)
        else:
            parts = list(zip(self._parts, dvc_yaml.of_all_tasks(after.params, self._own), strict=True))
            changed = all(old in text for old, _ in parts)
            for old, new in parts:
                text = text.replace(old, new)
        if not changed:
            return (
                f"{dvc_yaml.FILE} is not as `python -m pipeline.stages.dvc_yaml` writes it, so it will not follow: "
                "write it anew with that command, or name the tasks in its last stages by hand"
            )
        with written_whole(file) as stream:
            stream.write(text.encode())
        return None


def _files(project: Project) -> set[str]:
    """Files that the stages of every task wait for, as tasks name them."""
    tasks = project.params.tasks.values()
    return {file for task in tasks for file in (*task.feature_files, *task.scene_files)}
