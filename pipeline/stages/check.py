"""What a recording holds and whether it can be used, in words."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import RecordingError
from pipeline.stages.ingest import demonstration
from pipeline.stages.project import Project
from pipeline.stages.scenes import load_task_scene
from pipeline.stores.recordings import RecordingReport, inspect_recording


def report(path: Path, project: Project | None, task: str | None) -> tuple[list[str], bool]:
    """Lines that describe the file, and whether it can be used (for `task`, if one is given)."""
    scene = load_task_scene(project, project.params.task(task)) if project and task else None
    found = inspect_recording(path, joints=scene.joints if scene else None)
    verdict = None if found.usable else f"{found.reason}: {found.detail}"
    if project and scene and verdict is None:
        try:
            demonstration(path, scene, project.params.ingest.waypoints, project.params.ingest.idle_rad)
        except RecordingError as error:
            verdict = f"{error.reason}: {error.detail}"
    return [
        f"{path}: {'usable' if verdict is None else f'cannot be used, {verdict}'}",
        *_contents(found),
    ], verdict is None


def _contents(found: RecordingReport) -> list[str]:
    lines = []
    for topic in found.topics:
        rate = f", {topic.rate_hz:.1f} Hz" if topic.rate_hz else ""
        kind = f"{topic.schema} in {topic.encoding}"
        lines.append(f"  {topic.topic}: {kind}, {topic.messages:,} messages, {topic.duration_s:.2f} s{rate}")
        if topic.joints:
            lines.append(f"    joints: {', '.join(topic.joints)}")
    for name, record in found.metadata.items():
        lines.append(f"  {name}: " + ", ".join(f"{key} = {value}" for key, value in record.items()))
    return lines
