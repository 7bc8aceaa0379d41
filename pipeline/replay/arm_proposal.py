"""What can be said of a scene before anybody has said which of its joints are the arm's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.replay.mechanism.arm import ancestors, body_of, movable_joints
from pipeline.replay.mechanism.couplings import joint_couplings
from pipeline.replay.mechanism.proposal import Arm, free_bodies, named_hand, proposed_arm
from pipeline.replay.scene import Scene, compile_scene

__all__ = ["Arm", "UnknownArm"]


class UnknownArm:
    """A scene that has been compiled, the joints of whose arm are still to be found.

    Args:
        path: MJCF or URDF.

    Raises:
        SceneError: it cannot be compiled, see `load_scene`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._model: Any = compile_scene(path)[0]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the hinges and slides that follow no other, in the order of the file."""
        movable = movable_joints(self._model, joint_couplings(self._path, self._model))
        return tuple(self._model.joint(joint).name for joint in movable)

    @property
    def free_bodies(self) -> list[str]:
        """Names of the bodies that nothing holds."""
        return free_bodies(self._model)

    def arm(self, recorded: Sequence[str]) -> Arm:
        """The joints that are likely the arm's, of those that were recorded; see `proposed_arm`."""
        return proposed_arm(self._path, self._model, recorded)


def hand_of_scene(scene: Scene) -> str:
    """Name of the body whose path tells that of the hand that the scene's joints move.

    Raises:
        SceneError: no body of the arm has a name.
    """
    return named_hand(scene.path, scene.model, scene.rig.joint_ids.tolist())


def joints_elsewhere(scene: Scene) -> list[str]:
    """Names of the scene's joints beyond which the end effector is not, nor they beyond it: those of another arm."""
    model, hand = scene.model, body_of(scene.model, scene.end_effector)
    bodies = [int(model.jnt_bodyid[joint]) for joint in scene.rig.joint_ids.tolist()]
    beside = [hand not in ancestors(model, body) and body not in ancestors(model, int(hand or 0)) for body in bodies]
    return [name for name, apart in zip(scene.joints, beside, strict=True) if apart]
