"""Keyframes of a scene: where its joints and mocap bodies are, judged by the joints' limits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import FloatArray, IndexArray
from pipeline.errors import SceneError
from pipeline.replay.mechanism.couplings import Coupling
from pipeline.replay.mechanism.limits import Limits, judge_positions

SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_SAME = 1e-6  # rad or m: what is nearer is in the same place


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A whole configuration of a model; arrays are read-only.

    Attributes:
        qpos: (nq,) of all joints.
        mocap_pos, mocap_quat: (nmocap, 3) m and (nmocap, 4) wxyz of the mocap bodies.
    """

    qpos: FloatArray
    mocap_pos: FloatArray
    mocap_quat: FloatArray

    def with_qpos(self, qpos: FloatArray) -> Keyframe:
        """The same with other joint positions."""
        return replace(self, qpos=_frozen(qpos))


def rest(model: Any) -> Keyframe:
    """The model as its file has it, without a keyframe."""
    data = mujoco.MjData(model)
    return Keyframe(_frozen(data.qpos), _frozen(data.mocap_pos), _frozen(data.mocap_quat))


def scalar_limits(model: Any) -> tuple[IndexArray, Limits]:
    """All hinges and slides of a model: their indices and their limits."""
    ids = np.flatnonzero(np.isin(model.jnt_type, SCALAR))
    limited = np.asarray(model.jnt_limited[ids], dtype=bool)
    return ids, Limits(
        tuple(model.joint(int(i)).name or f"number {i}" for i in ids),
        _frozen(np.where(limited, model.jnt_range[ids, 0], -np.inf)),
        _frozen(np.where(limited, model.jnt_range[ids, 1], np.inf)),
        _frozen(model.jnt_type[ids] == int(mujoco.mjtJoint.mjJNT_SLIDE)),
    )


def read_keyframe(path: Path, model: Any, name: str) -> tuple[Keyframe | None, tuple[str, ...]]:
    """A keyframe by its name, None if there is none; and remarks on what was done to it.

    A limited hinge that is a whole turn away from its limits is turned back; it is in the same place.

    Raises:
        SceneError: a joint is beyond its limits.
    """
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, name)
    if index < 0:
        return None, ()
    qpos = np.array(model.key_qpos[index], dtype=np.float64)
    ids, limits = scalar_limits(model)
    addresses = model.jnt_qposadr[ids]
    judged = judge_positions(limits, qpos[addresses][None])
    if judged.refusal is not None:
        raise SceneError(f"{path}: in keyframe {name!r} {judged.refusal}")
    qpos[addresses] = judged.positions[0]
    mocap = (model.key_mpos[index].reshape(-1, 3), model.key_mquat[index].reshape(-1, 4))
    remarks = tuple(f"in keyframe {name!r} {remark}" for remark in judged.remarks)
    return Keyframe(_frozen(qpos), *(_frozen(values) for values in mocap)), remarks


def require_coupled(path: Path, model: Any, name: str, keyframe: Keyframe, couplings: Iterable[Coupling]) -> None:
    """Raise a SceneError if a keyframe has a joint elsewhere than the joint that it follows wants it."""
    ids, limits = scalar_limits(model)
    tolerance = dict(zip(ids.tolist(), limits.tolerance.tolist(), strict=True))
    for one in couplings:
        leader = keyframe.qpos[model.jnt_qposadr[one.leader]] if one.leader >= 0 else 0.0
        wanted, given = float(one.value(leader)), float(keyframe.qpos[model.jnt_qposadr[one.follower]])
        if abs(wanted - given) > tolerance[one.follower]:
            follower = model.joint(one.follower).name
            said = f"joint {model.joint(one.leader).name!r}" if one.leader >= 0 else "an equality constraint"
            raise SceneError(
                f"{path}: keyframe {name!r} has joint {follower!r} at {given:.6g}, and {said} wants it at "
                f"{wanted:.6g}; write that into the keyframe."
            )


def differences(model: Any, start: Keyframe, goal: Keyframe, moving_joints: Iterable[int]) -> list[str]:
    """What is elsewhere in `goal` than in `start` although the joints do not move it: names of joints and bodies."""
    moving, found = set(moving_joints), []
    for joint in range(model.njnt):
        first = model.jnt_qposadr[joint]
        last = model.jnt_qposadr[joint + 1] if joint + 1 < model.njnt else model.nq
        if joint not in moving and np.abs(goal.qpos[first:last] - start.qpos[first:last]).max() > _SAME:
            found.append(f"joint {model.joint(joint).name!r}")
    for body in range(model.nbody):
        mocap = model.body_mocapid[body]
        if mocap >= 0 and max(
            np.abs(goal.mocap_pos[mocap] - start.mocap_pos[mocap]).max(),
            np.abs(goal.mocap_quat[mocap] - start.mocap_quat[mocap]).max(),
        ) > _SAME:  # fmt: skip
            found.append(f"mocap body {model.body(body).name!r}")
    return found


def _frozen(values: Any) -> Any:
    array = np.array(values)
    array.flags.writeable = False
    return array
