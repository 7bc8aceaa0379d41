"""A scene for a task, built around an arm and the ends of its recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.commands.new_task import Wishes, chosen_arm, require_new
from pipeline.commands.task_checks import shared_ends
from pipeline.errors import ParameterError
from pipeline.formats.files.atomic import written_whole
from pipeline.replay.furnished_scene import TABLE_TOP, Place, furnished, with_keyframes
from pipeline.replay.scene import Scene
from pipeline.stages.ingest import collect
from pipeline.workspace.demonstrations import Intake
from pipeline.workspace.project import Project


@dataclass(frozen=True)
class Surroundings:
    """What is asked for around an arm.

    Attributes:
        arm: MJCF or URDF file.
        table: whether a table is wanted.
        objects: where objects are to stand, m, by name.
    """

    arm: Path
    table: bool
    objects: Mapping[str, Place]


@contextmanager
def built_scene(project: Project, wishes: Wishes, wanted: Surroundings) -> Iterator[tuple[Wishes, list[str]]]:
    """Write datasets/scenes/NAME.xml; it is taken away again if what follows fails.

    Its keyframes `start` and `goal` are the medians of the recordings' ends, if these are near each other.

    Yields:
        the wishes with this scene, and what was built, a line each.

    Raises:
        ParameterError: the file is there already; see also `add_task`.
        SceneError: see `furnished`.
    """
    require_new(project, wishes.name)
    file = project.datasets / "scenes" / f"{wishes.name}.xml"
    if file.exists():
        raise ParameterError(f"{project.named(file)} is there already; name it with --scene, or move it away")
    text, remarks = furnished(wanted.arm, file, table=wanted.table, objects=wanted.objects)
    _write(file, text)
    wishes = replace(wishes, scene=file, objects=tuple(wanted.objects))
    try:
        scene, names, _ = chosen_arm(wishes)
        ends = _shared_ends(project, wishes, scene, names)
        if ends:
            _write(file, with_keyframes(text, scene, ends))
        around = [*(["a table with the site " + TABLE_TOP] if wanted.table else []), *wanted.objects]
        yield (
            wishes,
            [
                f"Scene: {project.named(file)}, {wanted.arm.name}{' with ' if around else ''}{', '.join(around)}; edit "
                f"it as you like; later changes of {wanted.arm.name} do not reach it.",
                "Its keyframes start and goal are the medians of where the recordings start and end."
                if ends
                else "It has no keyframes, as the recordings start or end in different places.",
                *(f"Of {wanted.arm.name}: {remark}." for remark in remarks),
            ],
        )
    except BaseException:
        file.unlink(missing_ok=True)
        raise


def _shared_ends(project: Project, wishes: Wishes, scene: Scene, names: Mapping[str, str]) -> dict[str, FloatArray]:
    """Keyframes for where all recordings start and end, if these are the same places."""
    settings = project.params.ingest
    rows = collect(
        wishes.recordings, Intake(wishes.name, scene, settings, False, joint_names=names, reading=wishes.said)
    ).rows
    return shared_ends(scene, np.stack([row["waypoints"] for row in rows]), settings) if rows else {}


def _write(file: Path, text: str) -> None:
    with written_whole(file) as stream:
        stream.write(text.encode())
