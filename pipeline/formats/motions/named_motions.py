"""Motions of one arm, with what is said of each: what the writers of this folder are given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError

MOST_FRAMES = 20_000_000  # of all motions together, which is some 3 GB of an arm with seven joints
NS = 1_000_000_000


@dataclass(frozen=True, eq=False)
class NamedMotion:
    """One motion.

    Attributes:
        name: of the demonstration or plan.
        participant: who moved the arm.
        begin_ns: when it began, since 1970-01-01 UTC.
        time_ns: (M,) since then, strictly increasing from 0, M >= 2.
        positions: (M, J) rad or m, finite.
        about: what else is said of it.
    """

    name: str
    participant: str
    begin_ns: int
    time_ns: IntArray
    positions: FloatArray
    about: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.time_ns)
        if count < 2 or self.time_ns[0] != 0 or (np.diff(self.time_ns) <= 0).any():
            raise ArgumentError(f"{self.name!r} must have two times or more, from 0 and strictly increasing.")
        if self.positions.ndim != 2 or len(self.positions) != count or not np.isfinite(self.positions).all():
            raise ArgumentError(f"{self.name!r} must have one finite pose for each of its {count} times.")

    @property
    def time_s(self) -> FloatArray:
        """(M,) s since it began."""
        return np.asarray(self.time_ns / NS)


@dataclass(frozen=True, eq=False)
class MotionSet:
    """The motions of a task.

    Attributes:
        task: its name.
        joints: J different names.
        slides: J times whether the joint slides (m) or turns (rad).
        motions: at least one, of these joints, of different names.
    """

    task: str
    joints: tuple[str, ...]
    slides: tuple[bool, ...]
    motions: tuple[NamedMotion, ...]

    def __post_init__(self) -> None:
        joints, names = len(self.joints), [motion.name for motion in self.motions]
        if not joints or len(set(self.joints)) < joints or len(self.slides) != joints:
            raise ArgumentError(f"joints must be different names, each of which slides or not, got {self.joints!r}.")
        if not names or len(set(names)) < len(names):
            raise ArgumentError(f"motions must be one or more of different names, got {names!r}.")
        wrong = [motion.name for motion in self.motions if motion.positions.shape[1] != joints]
        if wrong:
            raise ArgumentError(f"{wrong[0]!r} must have {joints} joints.")

    @property
    def units(self) -> tuple[str, ...]:
        """J units, rad or m."""
        return tuple("m" if slides else "rad" for slides in self.slides)

    def sampled(self, rate_hz: float) -> MotionSet:
        """The same motions with poses at a fixed rate, on straight lines between those that are there.

        The first pose is kept. So is the last, at the first time of the rate that is not before it.

        Raises:
            ArgumentError: that would be more than `MOST_FRAMES` poses.
        """
        counts = [_frames(motion, rate_hz) for motion in self.motions]
        if sum(counts) > MOST_FRAMES:
            raise ArgumentError(
                f"{rate_hz:g} Hz would be {sum(counts):,} poses, at most {MOST_FRAMES:,} are written; lower the rate."
            )
        pairs = zip(self.motions, counts, strict=True)
        return replace(self, motions=tuple(_sampled(motion, rate_hz, count) for motion, count in pairs))


def _frames(motion: NamedMotion, rate_hz: float) -> int:
    return max(2, int(np.ceil(motion.time_s[-1] * rate_hz - 1e-6)) + 1)


def _sampled(motion: NamedMotion, rate_hz: float, count: int) -> NamedMotion:
    time_s = np.arange(count) / rate_hz
    positions = np.stack([np.interp(time_s, motion.time_s, joint) for joint in motion.positions.T], axis=1)
    positions[-1] = motion.positions[-1]
    return replace(motion, time_ns=np.rint(time_s * NS).astype(np.int64), positions=positions)
