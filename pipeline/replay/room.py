"""Where an arm may be between a start and a goal: within limits, above the surface and, if asked, touching nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IntArray
from pipeline.errors import StageError
from pipeline.replay.contacts import Contacts, Pair
from pipeline.replay.mechanism.limits import Verdict, judge_positions
from pipeline.replay.replay import Motion, replay
from pipeline.replay.scene import Scene
from pipeline.replay.surface import Surface
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.samplers import Draw, Fate, Sampler, draw_admissible

YIELD_M = 0.02  # how far the ends may be under the surface: calibration, and cups that are put down
TOUCH_M = 0.01  # how far what touches at the ends may be in each other
_ROUNDING_M = 1e-6  # what turns within another part stays as deep in it, but for MuJoCo's rounding


@dataclass(frozen=True, eq=False)
class Room:
    """Where the arm may be on its way from one start to one goal.

    Attributes:
        scene: of the task.
        anchor: start and goal, within the limits.
        top: the surface, which gives way as far as the ends are under it; None if there is none.
        contacts: what may not touch; None if that is not asked for.
        remarks: how the ends were made to fit, a phrase each.
    """

    scene: Scene
    anchor: Anchor
    top: Surface | None
    contacts: Contacts | None
    remarks: tuple[str, ...]

    @classmethod
    def of(
        cls,
        scene: Scene,
        surface: str | None,
        collisions: bool,
        anchor: Anchor,
        whose: str,
        clearance_m: float = 0.0,
    ) -> Room:
        """The room between two ends.

        The limits are the scene's, whatever the ends are: an end that is beyond one by less than the tolerance is moved
        onto it.

        Args:
            scene: of the task.
            surface: name of its surface; None if there is none.
            collisions: whether the arm may not touch itself or its surroundings.
            anchor: start and goal as they were found.
            whose: start and goal they are, for messages, such as "demonstration 'p01'".
            clearance_m: with collisions, how near the arm may not come to its surroundings, but for what is nearer at
                the ends.

        Raises:
            StageError: an end is beyond the limits, under the surface or in collision by more than what is tolerated.
            SceneError: see `Surface` and `Contacts`.
        """
        remarks: list[str] = []
        ends = [_within(scene, end, f"{name} of {whose}", remarks) for name, end in _named(anchor)]
        fitted = Anchor(*ends)
        top = None if surface is None else _surface(scene, surface, fitted, whose, remarks)
        contacts = _contacts(scene, fitted, whose, remarks, clearance_m) if collisions else None
        return cls(scene, fitted, top, contacts, tuple(remarks))

    def judge(self, waypoints: FloatArray) -> IntArray:
        """(N, T, J) within the limits -> (N,) `Fate` of each."""
        motions = [self.top.cleared_by(motion) for motion in replay(self.scene, waypoints)] if self.top else []
        clear = np.concatenate(motions) if motions else np.ones(len(waypoints), dtype=bool)
        return self._fates(clear, waypoints)

    def judge_motion(self, motion: Motion) -> IntArray:
        """The same of trajectories that are replayed already, (n,)."""
        clear = self.top.cleared_by(motion) if self.top else np.ones(len(motion.waypoints), dtype=bool)
        return self._fates(clear, motion.waypoints)

    def admissible(self, waypoints: FloatArray) -> BoolArray:
        """(N, T, J) within the limits -> (N,): the scene allows it."""
        return np.asarray(self.judge(waypoints) == Fate.KEPT)

    def draw(
        self, sampler: Sampler, rng: np.random.Generator, count: int, n_waypoints: int, least_acceptance: float = 1e-3
    ) -> Draw:
        """Alternatives that keep to the room.

        Raises:
            StageError: see `draw_admissible`.
        """
        return draw_admissible(
            sampler, rng, self.anchor, count, n_waypoints, lower=self.scene.lower, upper=self.scene.upper,
            judge=self.judge, least_acceptance=least_acceptance, joints=self.scene.joints,
        )  # fmt: skip

    def _fates(self, clear: BoolArray, waypoints: FloatArray) -> IntArray:
        fates = np.where(clear, Fate.KEPT, Fate.THROUGH_SURFACE)
        if self.contacts is not None and clear.any():
            fates[clear] = np.where(self.contacts.free(waypoints[clear]), Fate.KEPT, Fate.IN_COLLISION)
        return fates


def task_anchor(scene: Scene) -> Anchor:
    """The scene's start and goal.

    Raises:
        StageError: it has no such keyframes.
    """
    if scene.start is None or scene.goal is None:
        raise StageError(
            f"{scene.path}: has no keyframes `start` and `goal`, which are needed to plan paths; add them, or set the "
            "task's anchor to demonstration"
        )
    return Anchor(scene.start, scene.goal)


def _named(anchor: Anchor) -> tuple[tuple[str, FloatArray], tuple[str, FloatArray]]:
    return ("start", anchor.start), ("goal", anchor.goal)


def _within(scene: Scene, end: FloatArray, what: str, remarks: list[str]) -> FloatArray:
    judged = judge_positions(scene.limits, end[None])
    wrong = judged.of(Verdict.BEYOND) + judged.of(Verdict.TURNED)
    if wrong:
        raise StageError(
            f"{what}: {judged.refusal or wrong[0]}; correct the positions, or the joint's range in {scene.path}"
        )
    fitted = scene.limits.clamped(end)
    if (fitted != end).any():
        j = int(np.abs(fitted - end).argmax())
        remarks.append(
            f"{what} is {abs(fitted - end)[j]:.2g} beyond a limit of {scene.joints[j]!r}; paths keep to the limit"
        )
    return fitted


def _surface(scene: Scene, name: str, anchor: Anchor, whose: str, remarks: list[str]) -> Surface:
    top = Surface(scene, name)
    (motion,) = replay(scene, np.stack([anchor.start, anchor.goal])[:, None])
    depths = top.depth(motion)
    deepest = float(depths.max())
    if not deepest:
        return top
    end = ("start", "goal")[int(depths.argmax())]
    what = f"{end} of {whose} has the arm or what it carries {100 * deepest:.2g} cm under {name!r}"
    if deepest > YIELD_M:
        raise StageError(
            f"{what}, {100 * YIELD_M:g} cm are tolerated; lower the site in {scene.path}, or set the task's surface to "
            "null"
        )
    remarks.append(f"{what}; paths may go as deep")
    return Surface(scene, name, deepest)


def _contacts(scene: Scene, anchor: Anchor, whose: str, remarks: list[str], clearance_m: float) -> Contacts:
    contacts = Contacts(scene, clearance_m=clearance_m)
    allowed: dict[Pair, float] = {}
    for name, end in _named(anchor):
        for pair, depth in contacts.depths(end).items():
            what = f"{name} of {whose} has {contacts.named(pair)} {100 * depth:.2g} cm in each other"
            if depth > TOUCH_M:
                raise StageError(
                    f"{what}, {100 * TOUCH_M:g} cm are tolerated; move them in {scene.path}, or, where they may "
                    "overlap, add them to its <contact> as <exclude body1=... body2=.../>"
                )
            if depth > 0:
                remarks.append(f"{what}; paths may have them as deep")
            allowed[pair] = max(depth + _ROUNDING_M, allowed.get(pair, -np.inf))
    return Contacts(scene, allowed, clearance_m=clearance_m)
