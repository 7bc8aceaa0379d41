"""What an arm carries by a weld, and what a constraint ties together that replay cannot hold.

A body with a free joint that an active weld ties to a body of the arm is carried: it keeps its place on that body, as
the weld's forces would hold it. Constraints that would move the arm itself are refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import FloatArray, IndexArray
from pipeline.errors import SceneError

Pose = tuple[FloatArray, FloatArray]
"""Position (3,) and quaternion (4,) wxyz."""

_RIGID = (int(mujoco.mjtEq.mjEQ_WELD), int(mujoco.mjtEq.mjEQ_CONNECT))
_NOT_FOLLOWED = {
    int(getattr(mujoco.mjtEq, name)): name.removeprefix("mjEQ_").lower()
    for name in dir(mujoco.mjtEq)
    if name.startswith("mjEQ_") and name not in ("mjEQ_WELD", "mjEQ_CONNECT", "mjEQ_JOINT")
}


@dataclass(frozen=True, eq=False)
class Attachment:
    """A body with a free joint that keeps its place on another body.

    Attributes:
        carrier: index of the other body.
        root: index of the body with the free joint.
        address: where the pose of the free joint begins in `qpos`.
        pose: of the root in the carrier's frame.
    """

    carrier: int
    root: int
    address: int
    pose: Pose

    def place(self, data: Any) -> None:
        """Write the root's pose into `qpos`, the carrier being where `data` has it."""
        position, quaternion = composed((data.xpos[self.carrier], data.xquat[self.carrier]), self.pose)
        data.qpos[self.address : self.address + 3] = position
        data.qpos[self.address + 3 : self.address + 7] = quaternion


def carrying_joints(model: Any, joint_ids: IndexArray) -> IndexArray:
    """(nbody,) for each body the last of the given joints between the world and it, -1 if there is none."""
    carrier = np.full(model.nbody, -1, dtype=np.intp)
    chosen = set(joint_ids.tolist())
    for body in range(1, model.nbody):  # parents come first
        carrier[body] = carrier[model.body_parentid[body]]
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            if joint in chosen:
                carrier[body] = joint
    return carrier


def attachments(path: Path, data: Any, carrier: IndexArray) -> tuple[tuple[Attachment, ...], tuple[str, ...]]:
    """What is carried by welds, in an order in which each can be placed, and remarks on what is not followed.

    Args:
        path: of the scene, for messages.
        data: `mujoco.MjData` of the scene at home, after `mj_kinematics`.
        carrier: see `carrying_joints`; changed in place, so that what is carried has its carrier's joint.

    Raises:
        SceneError: a constraint ties a body that the joints move to one that cannot follow.
    """
    model = data.model
    remarks = [f"equality constraint {_name(model, i)} ({kind}) is not followed" for i, kind in _others(model)]
    found: list[Attachment] = []
    ties = [i for i in range(model.neq) if model.eq_active0[i] and model.eq_type[i] in _RIGID]
    while ties:
        tie = next((i for i in ties if _moved(model, i, carrier) == 1), ties[0])  # what is carried may carry more
        ties.remove(tie)
        bodies = _tied(model, tie)
        first, second = (int(carrier[body]) for body in bodies)
        if first == second:
            continue
        if any(model.body_mocapid[body] >= 0 for body in bodies):
            remarks.append(
                f"weld {_name(model, tie)} to a mocap body is not followed: the recorded joints say where the arm is"
            )
            continue
        loose = 0 if first < 0 else 1
        root = _free_root(model, bodies[loose]) if min(first, second) < 0 else None
        if root is None:
            held, other = (model.body(body).name or "world" for body in (bodies[1 - loose], bodies[loose]))
            raise SceneError(
                f"{path}: equality constraint {_name(model, tie)} ties body {held!r}, which the joints move, to "
                f"{other!r}, which cannot follow it; positions of the joints alone do not say how such a loop moves. "
                'Where it may be ignored, set active="false" on it.'
            )
        if model.eq_type[tie] != mujoco.mjtEq.mjEQ_WELD or not model.eq_data[tie, 10]:
            remarks.append(
                f"body {model.body(root).name!r} hangs from a point ({_name(model, tie)}), which does not say how it "
                "is turned; it stays where the keyframe has it"
            )
            continue
        found.append(_attachment(data, tie, bodies[1 - loose], root, loose))
        resting = np.flatnonzero((model.body_rootid == root) & (carrier < 0))
        carrier[resting] = carrier[bodies[1 - loose]]
    return tuple(found), tuple(remarks)


def _others(model: Any) -> Iterator[tuple[int, str]]:
    for i in range(model.neq):
        kind = _NOT_FOLLOWED.get(int(model.eq_type[i]))
        if kind is not None and model.eq_active0[i]:
            yield i, kind


def _moved(model: Any, tie: int, carrier: IndexArray) -> int:
    return sum(carrier[body] >= 0 for body in _tied(model, tie))


def _tied(model: Any, tie: int) -> tuple[int, int]:
    """The two bodies that a constraint ties, by themselves or by their sites."""
    ends = int(model.eq_obj1id[tie]), int(model.eq_obj2id[tie])
    if model.eq_objtype[tie] == mujoco.mjtObj.mjOBJ_SITE:
        return int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
    return ends


def _free_root(model: Any, body: int) -> int | None:
    """The body with a free joint that a body belongs to, None if there is none."""
    root = int(model.body_rootid[body])
    joint = model.body_jntadr[root]
    return root if joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else None


def _attachment(data: Any, tie: int, carrier: int, root: int, loose: int) -> Attachment:
    """Where the weld has the root in the carrier's frame; `loose` says whether the root hangs on its body 0 or 1."""
    model = data.model
    between = _welded(model, tie)
    if loose == 0:
        between = inverse(between)
    body = _tied(model, tie)[loose]
    within = composed(inverse((data.xpos[body], data.xquat[body])), (data.xpos[root], data.xquat[root]))
    address = int(model.jnt_qposadr[model.body_jntadr[root]])
    return Attachment(carrier, root, address, composed(between, within))


def _welded(model: Any, tie: int) -> Pose:
    """The pose of a weld's second body in the frame of its first."""
    if model.eq_objtype[tie] == mujoco.mjtObj.mjOBJ_SITE:
        first, second = (
            (model.site_pos[site], model.site_quat[site]) for site in (model.eq_obj1id[tie], model.eq_obj2id[tie])
        )
        return composed(first, inverse(second))
    anchor, position, quaternion = np.split(model.eq_data[tie, :10], (3, 6))
    return composed((position, quaternion), (-anchor, np.array([1.0, 0.0, 0.0, 0.0])))


def composed(outer: Pose, inner: Pose) -> Pose:
    """The pose `inner`, seen from where `outer` is given."""
    position, quaternion = np.empty(3), np.empty(4)
    mujoco.mju_mulPose(position, quaternion, *outer, *inner)
    mujoco.mju_normalize4(quaternion)
    return position, quaternion


def inverse(pose: Pose) -> Pose:
    """The pose of the outer frame in the inner one."""
    position, quaternion = np.empty(3), np.empty(4)
    mujoco.mju_negPose(position, quaternion, *pose)
    return position, quaternion


def _name(model: Any, tie: int) -> str:
    return repr(model.eq(tie).name or f"number {tie}")
