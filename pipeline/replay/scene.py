"""A robot and its surroundings, read from MJCF: which joints move, where things are, what everything is called.

Nothing here knows a particular arm: any MJCF whose joints are hinges or slides will do.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.errors import SceneError, one_of
from pipeline.replay.chain import Chain

_MOVABLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene and the J joints whose waypoints describe a trajectory.

    Attributes:
        path: the MJCF file.
        model: `mujoco.MjModel` as the file has it.
        joints: names of the J joints, in the order of the waypoints' last axis.
        qpos_addresses: (J,) where each joint's value sits in `qpos`.
        slides: (J,) true where a joint slides (m), false where it turns (rad).
        continuous: (J,) true for hinges without limits, which reach the same pose in every turn.
        lower, upper: (J,) limits in rad or m, infinite where a joint has none.
        start, goal: (J,) the keyframes of these names, None where the file has none.
        home: (nq,) the whole `qpos` of keyframe `start`, else of the model; what the other joints keep.
        end_effector: name of the body or site whose path matters.
        chain: what the J joints move, for replay.
    """

    path: Path
    model: Any
    joints: tuple[str, ...]
    qpos_addresses: IndexArray
    slides: BoolArray
    continuous: BoolArray
    lower: FloatArray
    upper: FloatArray
    start: FloatArray | None
    goal: FloatArray | None
    home: FloatArray
    end_effector: str
    chain: Chain = field(repr=False)

    def body_id(self, name: str) -> int:
        """Index of a body. Raises SceneError, listing the bodies, if there is none of that name."""
        return self._id(mujoco.mjtObj.mjOBJ_BODY, "body", name)

    def site_id(self, name: str) -> int:
        """Index of a site. Raises SceneError, listing the sites, if there is none of that name."""
        return self._id(mujoco.mjtObj.mjOBJ_SITE, "site", name)

    def place(self, name: str) -> tuple[str, int]:
        """("body" or "site", index) of a name; a body goes before a site of the same name.

        Raises:
            SceneError: there is neither; the message lists both.
        """
        for kind, object_type in (("body", mujoco.mjtObj.mjOBJ_BODY), ("site", mujoco.mjtObj.mjOBJ_SITE)):
            index = mujoco.mj_name2id(self.model, object_type, name)
            if index >= 0:
                return kind, index
        bodies = _names(self.model, mujoco.mjtObj.mjOBJ_BODY, self.model.nbody)
        sites = _names(self.model, mujoco.mjtObj.mjOBJ_SITE, self.model.nsite)
        raise SceneError(
            f"{self.path} has no body or site named {name!r}; its bodies are {one_of(bodies)}"
            f" and its sites {one_of(sites) or '(none)'}."
        )

    def moving_bodies(self) -> IndexArray:
        """Indices of the bodies that the J joints move."""
        return np.flatnonzero([body.joint >= 0 for body in self.chain.bodies])

    def box_sites(self) -> list[str]:
        """Names of the sites that are boxes, any of which could be a task's surface."""
        kinds = self.model.site_type
        return [self.model.site(i).name for i in range(self.model.nsite) if kinds[i] == mujoco.mjtGeom.mjGEOM_BOX]

    def _id(self, object_type: Any, kind: str, name: str) -> int:
        index = int(mujoco.mj_name2id(self.model, object_type, name))
        if index < 0:
            count = self.model.nbody if kind == "body" else self.model.nsite
            valid = one_of(_names(self.model, object_type, count)) or "(none)"
            raise SceneError(f"{self.path} has no {kind} named {name!r}; it has {valid}.")
        return index


def load_scene(path: str | Path, *, end_effector: str | None = None, joints: Sequence[str] | None = None) -> Scene:
    """Read and compile an MJCF file.

    Args:
        path: the MJCF file; files it includes are found from its folder.
        end_effector: body or site whose path matters; None: the last body that the joints move.
        joints: names of the joints of a trajectory, in order; None: every hinge and slide of the scene, in the
            order of the file.

    Raises:
        SceneError: the file is missing or does not compile, a name is not in it, a joint is neither hinge nor
            slide or is named twice, or no joint is left.
    """
    path = Path(path)
    model = _compile(path)
    ids = _joint_ids(path, model, joints)
    addresses = np.asarray(model.jnt_qposadr[ids], dtype=np.intp)
    limited = np.asarray(model.jnt_limited[ids], dtype=bool)
    slides = np.asarray(model.jnt_type[ids] == int(mujoco.mjtJoint.mjJNT_SLIDE))
    start, goal = _keyframe(model, "start"), _keyframe(model, "goal")
    home = _frozen(np.array(model.qpos0) if start is None else start)
    scene = Scene(
        path=path,
        model=model,
        joints=tuple(model.joint(i).name for i in ids),
        qpos_addresses=_frozen(addresses),
        slides=_frozen(slides),
        continuous=_frozen(~limited & ~slides),
        lower=_frozen(np.where(limited, model.jnt_range[ids, 0], -np.inf)),
        upper=_frozen(np.where(limited, model.jnt_range[ids, 1], np.inf)),
        start=None if start is None else _frozen(start[addresses]),
        goal=None if goal is None else _frozen(goal[addresses]),
        home=home,
        end_effector=end_effector or "",
        chain=Chain.of(model, ids, home),
    )
    if end_effector is None:
        last = model.body(int(scene.moving_bodies()[-1])).name
        return replace(scene, end_effector=last)
    scene.place(end_effector)
    return scene


def model_hash(scene: Scene) -> str:
    """SHA-256 of the compiled model: included files, meshes and textures count, comments do not."""
    buffer = np.zeros(mujoco.mj_sizeModel(scene.model), dtype=np.uint8)
    mujoco.mj_saveModel(scene.model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def scene_files(path: str | Path) -> list[Path]:
    """The file itself and every file it depends on (included files, meshes, textures), sorted.

    Raises:
        SceneError: one of them is missing or is not XML where it should be.
    """
    try:
        return sorted(Path(file) for file in mujoco.mju_getXMLDependencies(str(path)))
    except (ValueError, mujoco.FatalError) as error:
        raise SceneError(f"The files that {path} depends on cannot be listed: {_one_line(error)}") from error


def _compile(path: Path) -> Any:
    if not path.is_file():
        raise SceneError(f"There is no scene file {path}; give the path of an MJCF file.")
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise SceneError(f"MuJoCo cannot compile {path}: {_one_line(error)}") from error


def _joint_ids(path: Path, model: Any, joints: Sequence[str] | None) -> list[int]:
    movable = [i for i in range(model.njnt) if model.jnt_type[i] in _MOVABLE]
    if joints is None:
        ids = movable
    else:
        by_name = {model.joint(i).name: i for i in movable if model.joint(i).name}
        unknown = [name for name in joints if name not in by_name]
        if unknown:
            raise SceneError(
                f"{path} has no hinge or slide joint named {unknown[0]!r}; it has {one_of(by_name) or '(none)'}."
            )
        ids = [by_name[name] for name in joints]
    if not ids:
        raise SceneError(f"{path} has no hinge or slide joint to move; a trajectory needs at least one.")
    names = [model.joint(i).name for i in ids]
    if "" in names:
        raise SceneError(f"{path}: hinge or slide joint number {ids[names.index('')]} has no name; name it.")
    if len(set(names)) < len(names):
        raise SceneError(f"joints {', '.join(names)}: each joint may be named once only.")
    return ids


def _keyframe(model: Any, name: str) -> FloatArray | None:
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, name)
    return None if index < 0 else np.array(model.key_qpos[index], dtype=np.float64)


def _names(model: Any, object_type: Any, count: int) -> Iterable[str]:
    names = (mujoco.mj_id2name(model, object_type, i) for i in range(count))
    return [name for name in names if name]


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())


def _frozen(array: Any) -> Any:
    array = np.array(array)
    array.flags.writeable = False
    return array
