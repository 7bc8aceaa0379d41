"""Joints that follow others: the equality constraints between joints, and URDF's mimic joints, which become such.

MuJoCo holds `y - y0 = a0 + a1 (x - x0) + ... + a4 (x - x0)^4` between a follower y and its leader x (its reference,
XML, equality/joint). It does so by forces; `mj_kinematics` alone leaves the follower where it is. Replay has no forces,
so the follower is computed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import SceneError

NOBODY = -1  # the leader of a joint that an equality constraint holds at a constant


@dataclass(frozen=True)
class Coupling:
    """A joint whose position is a polynomial of another joint's.

    Attributes:
        follower, leader: indices of joints; the leader is NOBODY for a constant.
        coefficients: a0 to a4.
        follower_reference, leader_reference: y0 and x0.
    """

    follower: int
    leader: int
    coefficients: tuple[float, ...]
    follower_reference: float
    leader_reference: float

    def value(self, leader: FloatArray | float) -> Any:
        """The follower's position at the leader's, rad or m."""
        return self.follower_reference + np.polynomial.polynomial.polyval(
            leader - self.leader_reference, self.coefficients
        )

    @property
    def affine(self) -> bool:
        """Whether the follower moves in proportion to its leader, so that either gives the other."""
        return self.leader != NOBODY and self.coefficients[1] != 0 and not any(self.coefficients[2:])

    def reversed(self) -> Coupling:
        """The same constraint of an affine coupling, with the leader as follower."""
        a0, a1 = self.coefficients[:2]
        turned = (-a0 / a1, 1 / a1, 0.0, 0.0, 0.0)
        return Coupling(self.leader, self.follower, turned, self.leader_reference, self.follower_reference)


def joint_couplings(path: Path, model: Any) -> dict[int, Coupling]:
    """The active couplings of a compiled model, by follower.

    Raises:
        SceneError: a joint follows two others.
    """
    found: dict[int, Coupling] = {}
    for i in range(model.neq):
        if model.eq_type[i] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[i]:
            continue
        follower, leader = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        if follower in found:
            raise SceneError(
                f"{path}: two equality constraints give the position of joint {model.joint(follower).name!r}; keep one."
            )
        coefficients = tuple(float(a) for a in model.eq_data[i, :5])
        found[follower] = Coupling(
            follower,
            leader,
            coefficients if leader != NOBODY else (coefficients[0], 0.0, 0.0, 0.0, 0.0),
            _reference(model, follower),
            _reference(model, leader) if leader != NOBODY else 0.0,
        )
    return found


def led_by(path: Path, model: Any, couplings: Mapping[int, Coupling], joint_ids: Sequence[int]) -> dict[int, Coupling]:
    """The couplings, those on the way from one of the joints that are given to its leaders turned round.

    Raises:
        SceneError: a joint that is given follows another that is given, or cannot lead.
    """
    found = dict(couplings)
    for joint in joint_ids:
        above = found.pop(joint, None)
        while above is not None:
            if above.leader in joint_ids or not above.affine:
                leader = "a constant" if above.leader == NOBODY else f"joint {model.joint(above.leader).name!r}"
                raise SceneError(
                    f"{path}: an equality constraint makes joint {model.joint(joint).name!r} follow {leader}; leave "
                    "the follower out of the joints."
                )
            following = found.pop(above.leader, None)
            found[above.leader] = above.reversed()
            above = following
    return found


def in_order(
    path: Path, model: Any, couplings: Mapping[int, Coupling], joint_ids: Sequence[int]
) -> tuple[tuple[Coupling, ...], tuple[Coupling, ...]]:
    """The couplings that the given joints move, and those of joints that stay; leaders come before their followers.

    Raises:
        SceneError: joints follow each other in a circle.
    """
    moving: list[Coupling] = []
    staying: list[Coupling] = []
    led, waiting = set(joint_ids), dict(couplings)
    while waiting:
        ready = [one for one in waiting.values() if one.leader not in waiting]
        if not ready:
            names = ", ".join(repr(model.joint(joint).name) for joint in waiting)
            raise SceneError(f"{path}: equality constraints make joints {names} follow each other in a circle.")
        for one in ready:
            del waiting[one.follower]
            if one.leader in led:
                led.add(one.follower)
                moving.append(one)
            else:
                staying.append(one)
    return tuple(moving), tuple(staying)


def _reference(model: Any, joint: int) -> float:
    return float(model.qpos0[model.jnt_qposadr[joint]])
