"""A robot and its surroundings, read from MJCF or URDF: which joints move, where things are, what everything is called.

Nothing here knows a particular arm: any file whose joints are hinges or slides will do.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import degrees
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.errors import SceneError, few_of, one_of
from pipeline.replay.declared_sizes import check_declared_sizes
from pipeline.replay.described_scene import described_model, is_described, read_description
from pipeline.replay.mechanism.arm import Joints, chosen_joints, said_of_others
from pipeline.replay.mechanism.causes import RADIANS_AS_DEGREES, ranges_in_radians
from pipeline.replay.mechanism.chain import Carried, Chain
from pipeline.replay.mechanism.couplings import Coupling, joint_couplings, led_by
from pipeline.replay.mechanism.keyframes import (
    Keyframe,
    differences,
    read_keyframe,
    require_coupled,
    rest,
    scalar_limits,
)
from pipeline.replay.mechanism.limits import Limits
from pipeline.replay.mechanism.rig import Rig
from pipeline.replay.model_files import model_files
from pipeline.replay.urdf import is_urdf, read_urdf


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene and the J joints whose waypoints describe a trajectory.

    Attributes:
        path: the MJCF or URDF file.
        model: `mujoco.MjModel` as the file has it.
        limits: of the J joints, in the order of the waypoints' last axis.
        continuous: (J,) true for hinges without limits, which reach the same pose in every turn.
        start, goal: (J,) the keyframes of these names, None where the file has none.
        end_effector: name of the body or site whose path matters.
        rig: what a configuration of the J joints sets in MuJoCo, and what all else keeps: keyframe `start`, else
            `home`, else the model.
        chain: what the J joints move, for replay.
        remarks: what is odd about the scene, or not followed in it, a phrase each.
    """

    path: Path
    model: Any
    limits: Limits
    continuous: BoolArray
    start: FloatArray | None
    goal: FloatArray | None
    end_effector: str
    rig: Rig = field(repr=False)
    chain: Chain = field(repr=False)
    remarks: tuple[str, ...]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        return self.limits.joints

    @property
    def joint_units(self) -> tuple[str, ...]:
        """(J,) unit of each joint's position."""
        return tuple("m" if slides else "rad" for slides in self.slides)

    @property
    def slides(self) -> BoolArray:
        """(J,) true where a joint slides (m), false where it turns (rad)."""
        return self.limits.slides

    @property
    def lower(self) -> FloatArray:
        """(J,) lower limits in rad or m, minus infinity where a joint has none."""
        return self.limits.lower

    @property
    def upper(self) -> FloatArray:
        """(J,) upper limits in rad or m, infinity where a joint has none."""
        return self.limits.upper

    @property
    def home(self) -> FloatArray:
        """(nq,) the whole `qpos` at rest."""
        return self.rig.home.qpos

    @property
    def qpos_addresses(self) -> IndexArray:
        """(J,) where each joint's value sits in `qpos`."""
        return self.rig.addresses

    def at_home(self) -> Any:
        """A new `mujoco.MjData`, everything at home, after `mj_kinematics`."""
        data = self.rig.data()
        self.rig.pose(data, self.home[self.qpos_addresses])
        return data

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

    def carried(self, name: str) -> Carried:
        """The place of a body or site in the chain; see `place`."""
        kind, index = self.place(name)
        return (self.chain.bodies if kind == "body" else self.chain.sites)[index]

    def moving_bodies(self) -> IndexArray:
        """Indices of the bodies that the J joints move."""
        return np.flatnonzero([body.joint >= 0 for body in self.chain.bodies])

    def bodies_under(self, name: str) -> BoolArray:
        """(nbody,) true for a body and its children, and theirs; without a name, true for every body.

        Raises:
            SceneError: there is no body of that name.
        """
        found = np.full(self.model.nbody, not name)
        if name:
            found[self.body_id(name)] = True
            for body in range(1, self.model.nbody):  # parents come first
                found[body] |= found[self.model.body_parentid[body]]
        return found

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


def load_scene(path: str | Path, *, end_effector: str | None = None, joints: Joints | None = None) -> Scene:
    """Read and compile an MJCF file, a URDF file (see `urdf`), or a YAML file that describes a scene around one.

    Joints that an equality constraint makes follow others are computed from those (see `couplings`), bodies that an
    active weld ties to the arm are carried by it (see `attachments`), and mocap bodies are where keyframe `start` has
    them.

    Args:
        path: the file; files it includes are found from its folder.
        end_effector: body or site whose path matters; None: the last body that the joints move.
        joints: names of the joints of a trajectory, in order, or one body whose subtree has them, in the order of the
            file; None: those of the arm that carries the end effector (see `mechanism.arm`), or, where no end effector
            is named either, every hinge and slide of the scene that does not follow another.

    Raises:
        SceneError: the file is missing or does not compile, a name is not in it, a joint is neither hinge nor
            slide or is named twice, no joint is left, none moves the end effector, a keyframe is beyond the limits,
            or a constraint cannot be held.
    """
    path = Path(path)
    model, said_of_file = compile_scene(path)
    couplings = joint_couplings(path, model)
    ids = chosen_joints(path, model, joints, end_effector, couplings)
    others = said_of_others(model, ids, couplings, end_effector) if joints is None and end_effector else ()
    couplings = led_by(path, model, couplings, ids)
    limits = _limits(model, ids, couplings)
    start, said_of_start = read_keyframe(path, model, "start")
    goal, said_of_goal = read_keyframe(path, model, "goal")
    home = start or read_keyframe(path, model, "home")[0] or rest(model)
    rig = Rig.of(path, model, ids, home, couplings)
    for name, keyframe in (("start", start), ("goal", goal)):
        if keyframe is not None:
            require_coupled(path, model, name, keyframe, couplings.values())
    scene = Scene(
        path=path,
        model=model,
        limits=limits,
        continuous=_frozen(np.isinf(limits.lower) & np.isinf(limits.upper) & ~limits.slides),
        start=None if start is None else _frozen(start.qpos[rig.addresses]),
        goal=None if goal is None else _frozen(goal.qpos[rig.addresses]),
        end_effector=end_effector or "",
        rig=rig,
        chain=Chain.of(rig),
        remarks=(
            *said_of_file,
            *said_of_start,
            *said_of_goal,
            *_elsewhere(rig, start, goal),
            *_tiny_ranges(model),
            *rig.remarks,
            *others,
        ),
    )
    if end_effector is None:
        last = model.body(int(scene.moving_bodies()[-1])).name
        return replace(scene, end_effector=last)
    if scene.carried(end_effector).joint < 0:
        raise SceneError(f"{path}: none of the joints {one_of(scene.joints)} moves the end effector {end_effector!r}.")
    return scene


def model_hash(scene: Scene) -> str:
    """SHA-256 of the compiled model and of the joints that move: included files and meshes count, comments do not."""
    buffer = np.zeros(mujoco.mj_sizeModel(scene.model), dtype=np.uint8)
    mujoco.mj_saveModel(scene.model, None, buffer)
    return hashlib.sha256(buffer.tobytes() + "\0".join(scene.joints).encode()).hexdigest()


def scene_files(path: str | Path) -> list[Path]:
    """The file itself and every file it depends on (an arm, included files, meshes, textures), sorted.

    Raises:
        SceneError: one of them is missing or is not what it should be.
    """
    path = Path(path).absolute()
    if is_described(path):
        return sorted({path, *model_files(read_description(path).arm)})
    return model_files(path)


def compile_scene(path: Path) -> tuple[Any, tuple[str, ...]]:
    """`mujoco.MjModel` of an MJCF or URDF file or of a description (see `described_scene`), and remarks on it.

    Raises:
        SceneError: the file is missing, declares more than can be built, or does not compile.
    """
    if not path.is_file():
        raise SceneError(f"There is no scene file {path}; give the path of an MJCF, URDF or YAML file.")
    if is_described(path):
        return described_model(path)
    check_declared_sizes(path)
    try:  # by the full path, as MuJoCo misses what an included file names if the first path is relative
        if is_urdf(path):
            urdf = read_urdf(path)
            return mujoco.MjSpec.from_string(urdf.text, assets=urdf.assets).compile(), urdf.remarks
        return mujoco.MjModel.from_xml_path(str(path.absolute())), ()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise SceneError(f"MuJoCo cannot compile {path}: {_one_line(error)}") from error


def _limits(model: Any, ids: Sequence[int], couplings: Mapping[int, Coupling]) -> Limits:
    """The limits of the joints, narrowed where a joint that follows in proportion would leave its own."""
    scalar, every = scalar_limits(model)
    rows = {joint: row for row, joint in enumerate(scalar.tolist())}
    chosen = [rows[joint] for joint in ids]
    lower, upper = every.lower[chosen], every.upper[chosen]
    for one in couplings.values():
        if one.leader in ids and one.affine:
            place, follower = ids.index(one.leader), rows[one.follower]
            ends = np.sort(one.reversed().value(np.array([every.lower[follower], every.upper[follower]])))
            lower[place], upper[place] = max(lower[place], ends[0]), min(upper[place], ends[1])
    names = tuple(every.joints[row] for row in chosen)
    return Limits(names, _frozen(lower), _frozen(upper), _frozen(every.slides[chosen]))


def _elsewhere(rig: Rig, start: Keyframe | None, goal: Keyframe | None) -> list[str]:
    if start is None or goal is None:
        return []
    others = differences(rig.model, start, goal, rig.moving_joints)
    return (
        [f"{', '.join(others)}: elsewhere in keyframe 'goal' than in 'start'; replay has it as in 'start'"]
        if others
        else []
    )


def _tiny_ranges(model: Any) -> list[str]:
    names = ranges_in_radians(scalar_limits(model)[1])
    degrees_of_a_turn = f"{degrees(RADIANS_AS_DEGREES):.2g} degrees"
    return [
        f"the range of {few_of(names)} is less than {degrees_of_a_turn}, as if radians had been taken for degrees"
    ] * bool(names)


def _names(model: Any, object_type: Any, count: int) -> Iterable[str]:
    names = (mujoco.mj_id2name(model, object_type, i) for i in range(count))
    return [name for name in names if name]


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())


def _frozen(array: Any) -> Any:
    array = np.array(array)
    array.flags.writeable = False
    return array
