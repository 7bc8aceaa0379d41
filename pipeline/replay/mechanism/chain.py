"""Forward kinematics of many configurations at once, from what MuJoCo says about one.

At the reference configuration `mj_kinematics` gives the axis and anchor of every joint and the pose of every body and
site. Any other configuration turns or slides rigid frames about these axes (the product of exponentials; Lynch & Park,
Modern Robotics, equation 4.14), which numpy does for thousands of configurations in one sweep. A batch of MuJoCo's own
has no stage of kinematics alone: it goes on to inertias, and takes many times as long (`benchmarks/replay.py`). What is
computed here agrees with `mj_kinematics` to rounding, which `Chain.of` checks for every scene that is loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from pipeline.arrays import FloatArray, IndexArray
from pipeline.errors import SceneError
from pipeline.replay.mechanism.rig import Rig

Axes = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""A frame in the world for each of n configurations: its x, y and z axis and its origin, (3, n) each or (3, 1)."""

_ROUNDING = 1e-15  # entries of a placement this close to -1, 0 or 1 are meant to be it
_AGREEMENT = 1e-9  # m, and of a unit vector
_TRIALS = 4  # random configurations at which the chain is compared with MuJoCo
_WORLD: Axes = (*np.eye(3)[:, :, None], np.zeros((3, 1)))


@dataclass(frozen=True, eq=False)
class Joint:
    """A hinge or slide, and the frame that it moves: z along its axis, the origin on it.

    Attributes:
        outer: index of the joint whose frame carries this one, -1 for the world.
        column: where its position is in an expanded configuration (see `Rig.expanded`).
        slides: along z, not turns about it.
        reference: position (rad or m) at which `placement` holds.
        placement: (3, 4) x, y, z axis and origin in the outer frame.
    """

    outer: int
    column: int
    slides: bool
    reference: float
    placement: FloatArray


@dataclass(frozen=True, eq=False)
class Carried:
    """A body or site: the joint whose frame carries it (-1: the world), its (3, 4) axes and origin in that frame."""

    joint: int
    placement: FloatArray


@dataclass(frozen=True, eq=False)
class Chain:
    """What the replayed joints of a scene move, outer joints first; bodies and sites in the model's order."""

    rig: Rig
    joints: tuple[Joint, ...]
    bodies: tuple[Carried, ...]
    sites: tuple[Carried, ...]

    @classmethod
    def of(cls, rig: Rig) -> Chain:
        """The chain of a scene.

        Raises:
            SceneError: the chain places something elsewhere than MuJoCo does.
        """
        model, data, moving = rig.model, rig.data(), rig.moving_joints
        rig.pose(data, model.qpos0[rig.addresses])
        frames, joints, places = [np.eye(3, 4)], [], {-1: -1}  # places: of a joint of the model in the chain
        for joint, before in _outer_first(rig):
            body, outer = int(model.jnt_bodyid[joint]), places[before]
            frame = _joint_frame(data.xaxis[joint], data.xanchor[joint], data.xmat[body].reshape(3, 3))
            joints.append(
                Joint(
                    outer=outer,
                    column=moving.index(joint),
                    slides=bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE),
                    reference=float(data.qpos[model.jnt_qposadr[joint]]),
                    placement=_seen_from(frames[outer + 1], frame),
                )
            )
            places[joint] = len(joints) - 1
            frames.append(frame)

        def carried(body: int, axes: FloatArray, origin: FloatArray) -> Carried:
            pose = np.column_stack([axes.reshape(3, 3), origin])
            carrier = places[int(rig.carrier[body])]
            return Carried(carrier, _seen_from(frames[carrier + 1], pose))

        chain = cls(
            rig,
            tuple(joints),
            tuple(carried(i, data.xmat[i], data.xpos[i]) for i in range(model.nbody)),
            tuple(carried(model.site_bodyid[i], data.site_xmat[i], data.site_xpos[i]) for i in range(model.nsite)),
        )
        chain.require_agreement()
        return chain

    def require_agreement(self) -> None:
        """Raise a SceneError unless all bodies are where `mj_kinematics` has them, at some random configurations."""
        model, data = self.rig.model, self.rig.data()
        configurations = np.random.default_rng(0).uniform(-2.0, 2.0, (_TRIALS, len(self.rig.joint_ids)))
        posed = self.posed(configurations)
        ours = np.empty((model.nbody, 4, 3, _TRIALS))
        for body, carried in enumerate(self.bodies):
            for row, vectors in enumerate((*posed.axes(carried), posed.origin(carried))):
                ours[body, row] = vectors
        for trial, configuration in enumerate(configurations):
            self.rig.pose(data, configuration)
            theirs = np.concatenate([data.xmat.reshape(-1, 3, 3).transpose(0, 2, 1), data.xpos[:, None]], axis=1)
            apart = np.abs(ours[..., trial] - theirs).max(axis=(1, 2))
            if not apart.max() < _AGREEMENT * max(1.0, np.abs(data.xpos).max()):
                raise SceneError(
                    f"body {model.body(int(apart.argmax())).name!r} differs by up to {apart.max():.3g} from where "
                    f"MuJoCo has it when the joints move; only bodies that hinges and slides carry can be replayed."
                )

    def posed(self, configurations: FloatArray) -> Posed:
        """The chain at n configurations (n, J)."""
        return Posed(self, self.rig.expanded(configurations))


class Posed:
    """A chain at n positions of all its joints; a frame is computed when it is first asked for, and kept."""

    def __init__(self, chain: Chain, configurations: FloatArray) -> None:
        self._joints = chain.joints
        self._values, self._count = np.ascontiguousarray(configurations.T), len(configurations)
        self._placed: dict[int, Axes] = {}
        self._moved: dict[int, Axes] = {-1: _WORLD}

    def origin(self, carried: Carried, at: IndexArray | None = None) -> FloatArray:
        """Of a body or site in the world, (3, n) m, or (3, 1) where nothing moves it; `at` picks configurations."""
        frame: Sequence[FloatArray] = self._frame(carried)
        if at is not None:
            frame = [np.broadcast_to(vector, (3, self._count))[:, at] for vector in frame]
        return weighted(frame[:3], carried.placement[:, 3], frame[3])

    def coordinate(self, carried: Carried, direction: FloatArray) -> FloatArray:
        """Of the origin of a body or site along a direction (3,) of the world, (n,) m."""
        along = [weighted(vector, direction) for vector in self._frame(carried)]
        return np.broadcast_to(weighted(along[:3], carried.placement[:, 3], along[3]), self._count)

    def axes(self, carried: Carried) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The x, y and z axis of a body or site in the world, (3, n) or (3, 1) each."""
        frame = self._after(carried.joint)
        x, y, z = (weighted(frame[:3], column) for column in carried.placement[:, :3].T)
        return x, y, z

    def jacobian(self, carried: Carried) -> FloatArray:
        """How the origin of a body or site moves with each column of the configurations, (3, C, n) m per rad or m.

        Source: Lynch & Park, Modern Robotics, section 5.1; of the linear velocity alone.
        """
        origin, index = self.origin(carried), carried.joint
        found = np.zeros((3, len(self._values), self._count))
        while index >= 0:
            joint = self._joints[index]
            _, _, axis, on_axis = self._after(index)
            found[:, joint.column] = axis if joint.slides else np.cross(axis, origin - on_axis, axis=0)
            index = joint.outer
        return found

    def _frame(self, carried: Carried) -> Axes:
        """What carries a body or site, moved as far as its origin can tell: turning leaves what is on the axis."""
        on_axis = carried.joint >= 0 and not self._joints[carried.joint].slides and not carried.placement[:2, 3].any()
        return self._before(carried.joint) if on_axis else self._after(carried.joint)

    def _before(self, index: int) -> Axes:
        """A joint's frame as its outer frame carries it, not yet moved by the joint itself."""
        if index not in self._placed:
            joint = self._joints[index]
            outer, placement = self._after(joint.outer), joint.placement
            x, y, z = (weighted(outer[:3], column) for column in placement[:, :3].T)
            self._placed[index] = x, y, z, weighted(outer[:3], placement[:, 3], outer[3])
        return self._placed[index]

    def _after(self, index: int) -> Axes:
        if index not in self._moved:
            joint = self._joints[index]
            x, y, z, origin = self._before(index)
            value = self._values[joint.column] - joint.reference
            if joint.slides:
                self._moved[index] = x, y, z, origin + value * z
            else:
                cosine, sine = _cosine_and_sine(value)
                self._moved[index] = cosine * x + sine * y, cosine * y - sine * x, z, origin
        return self._moved[index]


def _cosine_and_sine(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both from the tangent of half the angle: one call of the mathematical library and not two."""
    tangent = np.tan(0.5 * angle)
    square = tangent * tangent
    share = 1.0 / (1.0 + square)
    return (1.0 - square) * share, 2.0 * tangent * share


def weighted(
    vectors: Sequence[FloatArray] | FloatArray, weights: FloatArray, start: FloatArray | None = None
) -> FloatArray:
    """`start` and the weighted sum of vectors; weights of 0 and 1, which most are, cost nothing."""
    total = start
    for vector, weight in zip(vectors, weights.tolist(), strict=True):
        if weight == 0:
            continue
        term = vector if weight == 1 else -vector if weight == -1 else weight * vector
        total = term if total is None else total + term
    return np.zeros_like(vectors[0]) if total is None else total


def _outer_first(rig: Rig) -> list[tuple[int, int]]:
    """The moving joints and for each the next one between it and the world (-1: none), which comes before it."""
    model, ordered = rig.model, dict[int, int]()

    def add(joint: int) -> None:
        if joint in ordered or joint < 0:
            return
        body = int(model.jnt_bodyid[joint])
        same = [i for i in range(model.body_jntadr[body], joint) if i in rig.moving_joints]
        before = same[-1] if same else int(rig.carrier[model.body_parentid[body]])
        add(before)
        ordered[joint] = before

    for joint in sorted(rig.moving_joints):
        add(joint)
    return list(ordered.items())


def _joint_frame(axis: FloatArray, anchor: FloatArray, body_axes: FloatArray) -> FloatArray:
    """(3, 4): z along the joint's axis, x as near as can be to the body axis that is furthest from it."""
    near = body_axes[:, np.abs(axis @ body_axes).argmin()]
    x = near - axis * (axis @ near)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis, anchor])


def _seen_from(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """The (3, 4) frame `inner` in the frame `outer`."""
    placement = outer[:, :3].T @ (inner - np.column_stack([np.zeros((3, 3)), outer[:, 3]]))
    whole = np.rint(placement)
    placement = np.where(np.abs(placement - whole) < _ROUNDING, whole, placement)
    placement.flags.writeable = False
    return placement
