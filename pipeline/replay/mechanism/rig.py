"""What a configuration of the replayed joints sets in MuJoCo: these joints, those that follow, and all that stays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import FloatArray, IndexArray
from pipeline.replay.mechanism.attachments import Attachment, attachments, carrying_joints
from pipeline.replay.mechanism.couplings import Coupling, in_order
from pipeline.replay.mechanism.keyframes import Keyframe

_STEP = 1e-6  # rad or m, of a central difference


@dataclass(frozen=True, eq=False)
class Rig:
    """A compiled model with everything but J joints at rest.

    Attributes:
        model: `mujoco.MjModel`.
        joint_ids: (J,) indices of the joints that are replayed, in the order of a configuration.
        home: what all other joints and the mocap bodies keep.
        couplings: of the joints that follow the replayed ones, leaders first.
        attached: bodies that are carried by a weld, in the order in which they are placed.
        carrier: (nbody,) the last joint, replayed or following, that carries each body; -1 for bodies that stay.
        remarks: what of the scene is not followed, a phrase each.
    """

    model: Any
    joint_ids: IndexArray
    home: Keyframe
    couplings: tuple[Coupling, ...]
    attached: tuple[Attachment, ...]
    carrier: IndexArray
    remarks: tuple[str, ...]

    @classmethod
    def of(
        cls, path: Path, model: Any, joint_ids: Sequence[int], home: Keyframe, couplings: dict[int, Coupling]
    ) -> Rig:
        """The rig of a scene.

        Args:
            path: of the scene, for messages.
            model: `mujoco.MjModel`.
            joint_ids: of the J joints.
            home: of all that stays.
            couplings: active in the model, led by the J joints (see `couplings.led_by`).

        Raises:
            SceneError: joints follow each other in a circle, or a constraint ties what the joints move to what cannot
                follow.
        """
        moving, staying = in_order(path, model, couplings, joint_ids)
        qpos = home.qpos.copy()
        for one in staying:
            leader = qpos[model.jnt_qposadr[one.leader]] if one.leader >= 0 else 0.0
            qpos[model.jnt_qposadr[one.follower]] = one.value(leader)
        ids = np.array([*joint_ids, *(one.follower for one in moving)], dtype=np.intp)
        carrier = carrying_joints(model, ids)
        rest = cls(model, ids[: len(joint_ids)], home.with_qpos(qpos), moving, (), carrier, ())
        data = rest.data()
        rest.pose(data, qpos[rest.addresses])
        attached, remarks = attachments(path, data, carrier)
        return cls(model, rest.joint_ids, rest.home, moving, attached, carrier, remarks)

    @cached_property
    def addresses(self) -> IndexArray:
        """(J,) where each replayed joint's value sits in `qpos`, read-only."""
        return self._addresses(self.joint_ids.tolist())

    @cached_property
    def moving_joints(self) -> list[int]:
        """Indices of the J joints and of the K that follow them, in the order of the columns of `expanded`."""
        return [*self.joint_ids.tolist(), *(one.follower for one in self.couplings)]

    def expanded(self, configurations: FloatArray) -> FloatArray:
        """Configurations (n, J) with the positions of the joints that follow, (n, J + K)."""
        if not self.couplings:
            return configurations
        columns = {joint: configurations[:, column] for column, joint in enumerate(self.joint_ids.tolist())}
        for one in self.couplings:
            columns[one.follower] = one.value(columns[one.leader])
        return np.stack([columns[joint] for joint in self.moving_joints], axis=1)

    def expansion(self, configurations: FloatArray) -> FloatArray:
        """How `expanded` changes with the J joints, (n, J + K, J), by central differences."""
        n, joints = configurations.shape
        if not self.couplings:
            return np.broadcast_to(np.eye(joints), (n, joints, joints))
        steps = _STEP * np.eye(joints)
        slopes = [self.expanded(configurations + step) - self.expanded(configurations - step) for step in steps]
        return np.stack(slopes, axis=-1) / (2 * _STEP)

    def data(self) -> Any:
        """A new `mujoco.MjData` of the model, with the mocap bodies where they stay."""
        data = mujoco.MjData(self.model)
        data.mocap_pos[:], data.mocap_quat[:] = self.home.mocap_pos, self.home.mocap_quat
        return data

    def pose(self, data: Any, configuration: FloatArray) -> None:
        """Put the J joints of `data` at a configuration (J,), all else where it belongs, and run `mj_kinematics`."""
        data.qpos[:] = self.home.qpos
        data.qpos[self._moving_addresses] = self.expanded(np.asarray(configuration, dtype=np.float64)[None])[0]
        mujoco.mj_kinematics(self.model, data)
        for one in self.attached:
            one.place(data)
            mujoco.mj_kinematics(self.model, data)

    @cached_property
    def _moving_addresses(self) -> IndexArray:
        return self._addresses(self.moving_joints)

    def _addresses(self, joints: Sequence[int]) -> IndexArray:
        found = np.array(self.model.jnt_qposadr[list(joints)], dtype=np.intp)
        found.flags.writeable = False
        return found
