"""Where the alternatives of a task start and end: all as the scene does, or each demonstration's as it does itself."""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

from pipeline.params import Task
from pipeline.replay.room import Room, task_anchor
from pipeline.replay.scene import Scene
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.random_streams import content_key
from pipeline.vocabulary import TASK_ANCHOR
from pipeline.workspace.scenes import SceneFile, loaded, scene_file

MOST_NOTES = 5


@dataclass(frozen=True, eq=False)
class Ends:
    """One anchor of a task, and what a worker needs to make the room between its start and its goal.

    Attributes:
        label: what the column `anchor` has.
        anchor: start and goal as they were found.
        scene: of the task.
        surface, collisions: what the task asks of paths.
    """

    label: str
    anchor: Anchor
    scene: SceneFile
    surface: str | None
    collisions: bool

    @property
    def key(self) -> str:
        """A label for random streams that depends on the scene, the start and the goal, and on no name of a task.

        The scene is in it so that tasks that only share their start and goal draw independent alternatives.
        """
        return _key(self.scene, self.anchor)

    def room(self) -> Room:
        """The room between start and goal.

        Raises:
            StageError, SceneError: see `Room.of`.
        """
        whose = str(self.scene.path) if self.label == TASK_ANCHOR else f"demonstration {self.label!r}"
        return Room.of(loaded(self.scene), self.surface, self.collisions, self.anchor, whose)


def ends_of(scene: Scene, task: Task, demonstrations: pl.DataFrame) -> list[Ends]:
    """The anchors of a task.

    Args:
        scene: of the task.
        task: says whether all demonstrations share the scene's start and goal.
        demonstrations: with `demonstration_id` and `waypoints`.

    Raises:
        StageError: the scene's start and goal are asked for, and it has none.
    """
    file = scene_file(scene)
    return [
        Ends(label, anchor, file, task.surface, task.collisions)
        for label, anchor in _anchors(scene, task, demonstrations).items()
    ]


def anchor_keys(scene: Scene, task: Task, demonstrations: pl.DataFrame) -> dict[str, str]:
    """By anchor, its label for random streams (see `Ends.key`); arguments and errors as those of `ends_of`."""
    file = scene_file(scene)
    return {label: _key(file, anchor) for label, anchor in _anchors(scene, task, demonstrations).items()}


def _anchors(scene: Scene, task: Task, demonstrations: pl.DataFrame) -> dict[str, Anchor]:
    if task.anchor == TASK_ANCHOR:
        return {TASK_ANCHOR: task_anchor(scene)}
    paths = demonstrations["waypoints"].to_numpy()
    return {
        label: Anchor(path[0], path[-1]) for label, path in zip(demonstrations["demonstration_id"], paths, strict=True)
    }


def _key(scene: SceneFile, anchor: Anchor) -> str:
    return f"{scene.content}/{content_key(anchor.start, anchor.goal)}"


def shortened(notes: list[str]) -> list[str]:
    """The first notes of many, and how many more there are."""
    more = len(notes) - MOST_NOTES
    return notes if more <= 0 else [*notes[:MOST_NOTES], f"and {more} more notes of this kind"]
