"""A scene in a few lines of YAML: an arm, a table to stand on, objects on it, and where paths start and end.

arm: my_arm.urdf              # MJCF or URDF, from the folder of this file
table: true                   # its top at the height of the arm's base, with the site table_top
objects: {cup: [0.5, 0.1, 0.05]}
start: {j1: 0.0, j2: 0.4}     # rad or m; joints that are not named rest or follow
goal: {j1: 0.8, j2: 0.1}
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pipeline.errors import SceneError, one_of
from pipeline.replay.furnished_scene import Place, building, furnished_spec
from pipeline.replay.mechanism.couplings import joint_couplings
from pipeline.yaml_text import YamlError, plain_yaml

ENDINGS = (".yaml", ".yml")
KEYS = ("arm", "table", "objects", "start", "goal")
LARGEST, MOST_OBJECTS, FURTHEST_M = 1_000_000, 1_000, 1_000.0


@dataclass(frozen=True)
class Description:
    """What such a file says.

    Attributes:
        path: the file.
        arm: MJCF or URDF file.
        table: whether there is a table.
        objects: where spheres of 4 cm are, m, by name.
        keyframes: `start` and `goal` as far as they are given, values of joints by name, rad or m.
    """

    path: Path
    arm: Path
    table: bool = False
    objects: Mapping[str, Place] = field(default_factory=dict)
    keyframes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def is_described(path: Path) -> bool:
    """Whether a file is read as a description, by its ending."""
    return path.suffix.lower() in ENDINGS


def read_description(path: Path) -> Description:
    """Read and check a description; the arm is not opened.

    Raises:
        SceneError: it is too large, no YAML, or says something else than it may; the message says what is allowed.
    """
    found = _mapping(path, "", _document(path))
    for key in found:
        if key not in KEYS:
            raise SceneError(f"{path}: {key!r} is unknown; allowed are {one_of(KEYS)}.")
    arm, table = found.get("arm"), found.get("table", False)
    if not isinstance(arm, str) or not arm:
        raise SceneError(f"{path}: arm is {arm!r}; it must name an MJCF or URDF file, from the folder of this file.")
    if not isinstance(table, bool):
        raise SceneError(f"{path}: table is {table!r}; allowed are true and false.")
    if is_described(Path(arm)):
        raise SceneError(f"{path}: arm is {arm!r}, which is a description itself; name an MJCF or URDF file.")
    objects = _mapping(path, "objects", found.get("objects") or {})
    if len(objects) > MOST_OBJECTS:
        raise SceneError(f"{path}: has {len(objects):,} objects; at most {MOST_OBJECTS:,} are built.")
    keyframes = {key: _mapping(path, key, found[key]) for key in ("start", "goal") if found.get(key) is not None}
    return Description(
        path, Path(os.path.normpath(path.absolute().parent / arm)), table,
        {name: _place(path, name, value) for name, value in objects.items()},
        {
            key: {joint: _number(path, f"{key}.{joint}", value) for joint, value in joints.items()}
            for key, joints in keyframes.items()
        },
    )  # fmt: skip


def described_model(path: Path) -> tuple[Any, tuple[str, ...]]:
    """`mujoco.MjModel` of a description, and remarks on what of the arm was replaced.

    Raises:
        SceneError: see `read_description` and `furnished_scene.furnished`; or a keyframe names a joint that is none.
    """
    wanted = read_description(path)
    with building(wanted.arm):
        spec, remarks = furnished_spec(wanted.arm, path.absolute().parent, table=wanted.table, objects=wanted.objects)
        model = spec.compile()
        for name, joints in wanted.keyframes.items():
            if any(key.name == name for key in spec.keys):
                raise SceneError(
                    f"{path}: {name} is given here, and {wanted.arm} has a keyframe of that name; drop one."
                )
            spec.add_key(name=name, qpos=_qpos(path, model, name, joints))
        return (spec.compile() if wanted.keyframes else model), remarks


def _qpos(path: Path, model: Any, name: str, joints: Mapping[str, float]) -> np.ndarray:
    qpos = np.array(model.qpos0)
    single = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    known = {
        model.joint(at).name: model.jnt_qposadr[at] for at in range(model.njnt) if int(model.jnt_type[at]) in single
    }
    for joint, value in joints.items():
        if joint not in known:
            raise SceneError(
                f"{path}: {name} names {joint!r}, which is no joint; there are {one_of(known) or '(none)'}."
            )
        qpos[known[joint]] = value
    couplings = joint_couplings(path, model)
    for _ in couplings:  # one may follow another that follows
        for one in couplings.values():
            if model.joint(one.follower).name not in joints:
                leader = qpos[model.jnt_qposadr[one.leader]] if one.leader >= 0 else 0.0
                qpos[model.jnt_qposadr[one.follower]] = one.value(leader)
    return qpos


def _document(path: Path) -> object:
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST + 1)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror}); give the path of a file.") from error
    if len(content) > LARGEST:
        raise SceneError(f"{path}: has more than {LARGEST:,} bytes, which no description of a scene needs.")
    try:
        return plain_yaml(content.decode("utf-8"))
    except UnicodeDecodeError:
        raise SceneError(f"{path}: is no UTF-8 text; save it as one.") from None
    except YamlError as error:
        raise SceneError(f"{path}: {error}.") from None


def _mapping(path: Path, key: str, value: object) -> dict[str, object]:
    if not isinstance(value, dict) or not all(isinstance(name, str) and name for name in value):
        what = f"{key} is {value!r}; it" if key else "it"
        raise SceneError(f"{path}: {what} must be names with their values, such as `name: value`.")
    return value


def _place(path: Path, name: str, value: object) -> Place:
    if not isinstance(value, list) or len(value) != 3:
        raise SceneError(f"{path}: objects.{name} is {value!r}; it must be [x, y, z] in m.")
    x, y, z = (_number(path, f"objects.{name}", one) for one in value)
    return x, y, z


def _number(path: Path, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= FURTHEST_M:
        raise SceneError(f"{path}: {key} is {value!r}; it must be a number from -{FURTHEST_M:g} to {FURTHEST_M:g}.")
    return float(value)
