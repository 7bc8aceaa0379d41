"""Which joints of a scene are likely an arm's, from how its joints hang on each other and what they are called."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.errors import SceneError, one_of
from pipeline.replay.mechanism.arm import ancestors, hand_of, movable_joints, scalar_joints
from pipeline.replay.mechanism.couplings import joint_couplings

_FINGER = re.compile(r"finger|gripper|knuckle|thumb|jaw", re.IGNORECASE)
_TIPS = (  # what the place that matters is called, the surest first
    r"tcp",
    r"(pinch|grasp|grip)(_site|_point|_center|_frame|$)",
    r"tool",
    r"attachment",
    r"tip$",
    r"eef|end_?effector|(^|_)ee($|_)",
    r"flange",
)
_SMALL = 0.5  # of the longest chain beside it: a shorter one is no arm


@dataclass(frozen=True)
class Arm:
    """What was proposed.

    Attributes:
        joints: names, in the order of the file.
        hand: site or body whose path tells the hand's.
        left_out: why each other joint is none of them, by its name.
    """

    joints: tuple[str, ...]
    hand: str
    left_out: dict[str, str]


def proposed_arm(path: Path, model: Any, recorded: Sequence[str]) -> Arm:
    """The joints that are likely the arm's.

    Left out are joints that nobody recorded, fingers (by name, or because they hang on a chain that branches and is
    longer than they are), and chains beside one of twice their length, such as drawers and heads.

    Args:
        path: of the scene, for messages.
        model: `mujoco.MjModel`.
        recorded: names of the scene's joints that the recordings have.

    Raises:
        SceneError: none is left.
    """
    couplings = joint_couplings(path, model)
    movable = movable_joints(model, couplings)
    outer = _outer_joints(model)
    depth = {joint: len(_path(outer, joint)) for joint in outer}
    reasons: dict[int, str] = {}
    for joint in movable:
        name = model.joint(joint).name
        if name not in recorded:
            reasons[joint] = "in no recording"
        elif _FINGER.search(name) or _of_hand(outer, depth, joint):
            reasons[joint] = "finger"
    chosen = [joint for joint in movable if joint not in reasons]
    reasons |= dict.fromkeys(_in_short_chains(outer, chosen), "short chain beside a longer one, as a drawer or a head")
    ids = [joint for joint in chosen if joint not in reasons]
    if not ids:
        names = [model.joint(joint).name for joint in movable]
        raise SceneError(
            f"none of the joints of {path} looks like an arm's that was recorded; name them with --joint, of "
            f"{one_of(names) or '(none)'}"
        )
    left = {model.joint(joint).name or f"number {joint}": reason for joint, reason in sorted(reasons.items())}
    return Arm(tuple(model.joint(joint).name for joint in ids), named_hand(path, model, ids), left)


def named_hand(path: Path, model: Any, ids: Sequence[int]) -> str:
    """Name of the site or body whose path tells the hand's.

    It is on the hand (see `hand_of`) or on what the hand holds without a joint: the first that is called as the point
    between fingers or the tip of a tool is, else the only site, else the hand, or the nearest body that carries it and
    has a name.

    Raises:
        SceneError: there is none.
    """
    hand = hand_of(model, ids)
    fixed = [hand]
    for body in range(hand + 1, model.nbody):
        if int(model.body_parentid[body]) in fixed and not model.body_jntnum[body]:
            fixed.append(body)
    sites = [name for i in range(model.nsite) if int(model.site_bodyid[i]) in fixed and (name := model.site(i).name)]
    called = [*sites, *(name for body in fixed[1:] if (name := model.body(body).name))]
    for pattern in _TIPS:
        if found := [name for name in called if re.search(pattern, name, re.IGNORECASE)]:
            return str(found[0])
    if len(sites) == 1:
        return str(sites[0])
    for body in ancestors(model, hand):
        if model.body(body).name:
            return str(model.body(body).name)
    raise SceneError(f"{path}: no body of the arm has a name; name the one whose path matters")


def free_bodies(model: Any) -> list[str]:
    """Names of the bodies that no hinge or slide carries but a free joint does."""
    return [
        model.body(int(model.jnt_bodyid[i])).name or f"number {i}" for i in range(model.njnt) if not model.jnt_type[i]
    ]


def _outer_joints(model: Any) -> dict[int, int]:
    """For every hinge and slide the next one between it and the world, -1 if there is none."""
    found: dict[int, int] = {}
    for body in range(1, model.nbody):
        for joint in scalar_joints(model, body):
            same = [one for one in scalar_joints(model, body) if one < joint]
            before = [one for carrier in ancestors(model, body)[1:] for one in scalar_joints(model, carrier)[-1:]]
            found[joint] = same[-1] if same else (before[0] if before else -1)
    return found


def _path(outer: Mapping[int, int], joint: int) -> list[int]:
    """The joint and all that carry it."""
    found = []
    while joint >= 0:
        found.append(joint)
        joint = outer[joint]
    return found


def _in_short_chains(outer: Mapping[int, int], chosen: Sequence[int]) -> list[int]:
    """Those of the chosen joints whose chain is much shorter than another that hangs on the same joint or the world."""
    longest = {
        joint: max(len(set(_path(outer, one)) & set(chosen)) for one in outer if joint in _path(outer, one))
        - len(set(_path(outer, joint)[1:]) & set(chosen))
        for joint in outer
    }
    short = {
        joint
        for joint, length in longest.items()
        if length < _SMALL * max(longest[one] for one in outer if outer[one] == outer[joint])
    }
    return [joint for joint in chosen if short & set(_path(outer, joint))]


def _of_hand(outer: Mapping[int, int], depth: Mapping[int, int], joint: int) -> bool:
    """Whether it is beyond a joint that carries several chains, each no longer than the one that leads there."""
    for carrier in _path(outer, joint)[1:]:
        beyond = [one for one in outer if carrier in _path(outer, one)[1:]]
        several = sum(outer[one] == carrier for one in beyond) > 1
        if several and max(depth[one] for one in beyond) - depth[carrier] <= depth[carrier]:
            return True
    return False
