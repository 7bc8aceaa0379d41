"""Which joints of a scene are the arm's, whose positions describe a trajectory; all others stay where they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco

from pipeline.errors import SceneError, few_of, one_of
from pipeline.replay.mechanism.couplings import NOBODY, Coupling
from pipeline.replay.mechanism.keyframes import SCALAR

Joints = str | Sequence[str]
"""The name of a body, whose subtree has the joints; or the names of joints, in the order of the waypoints."""


def chosen_joints(
    path: Path, model: Any, joints: Joints | None, end_effector: str | None, couplings: Mapping[int, Coupling]
) -> list[int]:
    """Indices of the J joints of a trajectory, in the order of its last axis.

    Args:
        path: of the scene, for messages.
        model: `mujoco.MjModel`.
        joints: which joints; None for those of the arm that carries the end effector, see `arm_joints`.
        end_effector: body or site; None for every joint of the scene that does not follow another.
        couplings: of the joints that follow others, by follower.

    Raises:
        SceneError: a name is not in the scene or is there twice, a joint is neither hinge nor slide or has no name, or
            none is left.
    """
    movable = movable_joints(model, couplings)
    if joints is None:
        body = None if end_effector is None else body_of(model, end_effector)
        ids = movable if body is None else arm_joints(model, body, couplings)
        ids = ids or movable
    elif isinstance(joints, str):
        ids = _in_subtree(path, model, joints, movable)
    else:
        ids = _named(path, model, joints)
    if not ids:
        raise SceneError(f"{path} has no hinge or slide joint to move; a trajectory needs at least one.")
    names = [model.joint(i).name for i in ids]
    if "" in names:
        raise SceneError(f"{path}: hinge or slide joint number {ids[names.index('')]} has no name; name it.")
    if len(set(names)) < len(names):
        raise SceneError(f"joints {', '.join(names)}: each joint may be named once only.")
    return ids


def movable_joints(model: Any, couplings: Mapping[int, Coupling]) -> list[int]:
    """Indices of the hinges and slides that do not follow another joint, in the order of the file."""
    return [i for i in range(model.njnt) if model.jnt_type[i] in SCALAR and i not in couplings]


def arm_joints(model: Any, body: int, couplings: Mapping[int, Coupling]) -> list[int]:
    """Indices of the joints between the world and a body, and of those beyond it up to where the arm branches.

    Beyond a hand that carries two fingers or more nothing is the arm's. A joint that follows another stands for the one
    that leads it.
    """
    found = [joint for one in ancestors(model, body) for joint in scalar_joints(model, one)]
    beyond = _branches(model, body)
    while len(beyond) == 1:
        (body,) = beyond
        found += scalar_joints(model, body)
        beyond = _branches(model, body)
    return sorted({leader for joint in found if (leader := _leader(joint, couplings)) != NOBODY})


def hand_of(model: Any, ids: Sequence[int]) -> int:
    """Index of the body whose path tells the hand's: the last that all joints move before the arm branches.

    Where no body is moved by all of them, as with two arms, it is one that the last joint moves.
    """
    chosen = set(ids)
    bodies = [int(model.jnt_bodyid[joint]) for joint in sorted(ids, reverse=True)]
    body = max(bodies, key=lambda one: len(ancestors(model, one)))
    while True:
        jointed = _branches(model, body)
        children = [i for i in range(body + 1, model.nbody) if model.body_parentid[i] == body and model.body(i).name]
        if jointed and (len(jointed) > 1 or set(scalar_joints(model, jointed[0])) - chosen):
            return body
        if not jointed and len(children) != 1:
            return body
        body = jointed[0] if jointed else children[0]


def body_of(model: Any, name: str) -> int | None:
    """Index of a body, or of the body that a site of this name is on; None if there is neither."""
    body = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))
    if body >= 0:
        return body
    site = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name))
    return int(model.site_bodyid[site]) if site >= 0 else None


def left_out(model: Any, ids: Sequence[int], couplings: Mapping[int, Coupling]) -> list[str]:
    """Names of the hinges and slides that stay where they are, without those that follow one that moves."""
    chosen = set(ids)
    return [
        model.joint(i).name or f"number {i}"
        for i in range(model.njnt)
        if model.jnt_type[i] in SCALAR and i not in chosen and _leader(i, couplings) not in chosen
    ]


def said_of_others(model: Any, ids: Sequence[int], couplings: Mapping[int, Coupling], end_effector: str) -> list[str]:
    """A remark on the joints that stay where they are because nobody named them, if there are any."""
    names = left_out(model, ids, couplings)
    verb, whose = ("stays", "it is") if len(names) == 1 else ("stay", "they are")
    return [f"{few_of(names)} {verb} at home, as {whose} no part of the arm that carries {end_effector!r}"] * bool(
        names
    )


def _named(path: Path, model: Any, joints: Sequence[str]) -> list[int]:
    by_name = {model.joint(i).name: i for i in range(model.njnt) if model.jnt_type[i] in SCALAR and model.joint(i).name}
    unknown = [name for name in joints if name not in by_name]
    if unknown:
        raise SceneError(
            f"{path} has no hinge or slide joint named {unknown[0]!r}; it has {one_of(by_name) or '(none)'}."
        )
    return [by_name[name] for name in joints]


def _in_subtree(path: Path, model: Any, name: str, movable: Sequence[int]) -> list[int]:
    root = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))
    if root < 0:
        bodies = [model.body(i).name for i in range(1, model.nbody) if model.body(i).name]
        raise SceneError(
            f"{path} has no body named {name!r} whose joints could be the arm's; it has {one_of(bodies)}; or list the "
            "names of joints."
        )
    found = [i for i in movable if root in ancestors(model, int(model.jnt_bodyid[i]))]
    if not found:
        raise SceneError(f"{path}: there is no hinge or slide in body {name!r} or what it carries; name another body.")
    return found


def ancestors(model: Any, body: int) -> list[int]:
    """The body itself and all that carry it."""
    found = []
    while body > 0:
        found.append(body)
        body = int(model.body_parentid[body])
    return found


def scalar_joints(model: Any, body: int) -> list[int]:
    """Indices of the hinges and slides of a body itself."""
    first = int(model.body_jntadr[body])
    return [i for i in range(first, first + int(model.body_jntnum[body])) if model.jnt_type[i] in SCALAR]


def _has_joints(model: Any, root: int) -> bool:
    """Whether a body or anything that it carries has a hinge or slide."""
    return any(scalar_joints(model, body) and root in ancestors(model, body) for body in range(root, model.nbody))


def _branches(model: Any, body: int) -> list[int]:
    """The bodies that a body carries directly and that have joints, themselves or further out."""
    return [i for i in range(body + 1, model.nbody) if model.body_parentid[i] == body and _has_joints(model, i)]


def _leader(joint: int, couplings: Mapping[int, Coupling]) -> int:
    seen = set[int]()
    while joint in couplings and joint not in seen:
        seen.add(joint)
        joint = couplings[joint].leader
    return joint
