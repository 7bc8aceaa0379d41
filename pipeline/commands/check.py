"""What a recording holds and whether it can be used, in words."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import RecordingError
from pipeline.formats.mcap.joint_states import RecordingReport, inspect_recording
from pipeline.params import Ingest
from pipeline.replay.scene import Scene
from pipeline.stages.ingest import demonstration
from pipeline.terminal import plain
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene

LONGEST_LINE = 4000  # characters
LISTED = 200  # topics and metadata records


def report(path: Path, project: Project | None, task: str | None) -> tuple[list[str], bool]:
    """Lines that describe the file, and whether it can be used (for `task`, if one is given)."""
    scene = load_task_scene(project, project.params.task(task)) if project and task else None
    settings = project.params.ingest if project else None
    found = inspect_recording(path, joints=scene.joints if scene else None)
    salvage = _salvage(found, scene, settings)
    verdict = None if found.usable else f"{found.reason}: {found.detail}"
    if settings and scene and (verdict is None or settings.salvage):
        verdict = _refusal(path, scene, settings)
    lines = [
        f"{path}: {'usable' if verdict is None else f'cannot be used, {verdict}'}",
        *salvage,
        *_contents(found),
    ]
    return [plain(line, LONGEST_LINE) for line in lines], verdict is None


def _refusal(path: Path, scene: Scene, settings: Ingest) -> str | None:
    try:
        demonstration(path, scene, settings)
    except RecordingError as error:
        return f"{error.reason}: {error.detail}"
    return None


def _salvage(found: RecordingReport, scene: Scene | None, settings: Ingest | None) -> list[str]:
    """Of a recording that is cut off: what ingest.salvage takes of it."""
    part = found.salvageable
    if part is None:
        return ["  nothing in it can be salvaged"] if found.reason == "truncated" else []
    refusal = _refusal(found.path, scene, settings.model_copy(update={"salvage": True})) if scene and settings else None
    if refusal is not None:
        return [f"  nothing in it can be salvaged: {refusal}"]
    duration_s = (part.time_ns[-1] - part.time_ns[0]) / 1e9
    verb = "is" if settings and settings.salvage else "can be"
    return [
        f"  {verb} salvaged with ingest.salvage: {len(part.time_ns):,} poses on {part.topic}, {duration_s:.2f} s; "
        f"lost: {part.lost}"
    ]


def _contents(found: RecordingReport) -> list[str]:
    lines = []
    for topic in found.topics[:LISTED]:
        rate = f", {topic.rate_hz:.1f} Hz" if topic.rate_hz else ""
        kind = f"{topic.schema} in {topic.encoding}"
        lines.append(f"  {topic.topic}: {kind}, {topic.messages:,} messages, {topic.duration_s:.2f} s{rate}")
        if topic.joints:
            lines.append(f"    joints: {', '.join(topic.joints)}")
    if len(found.topics) > LISTED:
        lines.append(f"  and {len(found.topics) - LISTED:,} more topics")
    for name, record in list(found.metadata.items())[:LISTED]:
        lines.append(f"  {name}: " + ", ".join(f"{key} = {value}" for key, value in record.items()))
    return lines
