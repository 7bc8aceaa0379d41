"""Whether joint positions can be right: judged by the joints' limits, with the likely cause where they cannot.

Everything that names positions of a scene's joints is judged here: keyframes, recordings, given trajectories, the ends
of sampled paths. How far a position may be beyond a limit is stated once, in the constants below.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import pi, radians

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import ArgumentError
from pipeline.replay.mechanism.causes import likely_cause, many_turns

TOLERANCE_RAD = radians(3)  # calibration and encoder offsets
TOLERANCE_M = 0.01
TOLERANCE_SHARE = 0.1  # of a joint's whole range, at most: a finger's 4 cm leave no room for 1 cm
TURN = 2 * pi


class Verdict(Enum):
    """What became of a joint's positions."""

    WITHIN = "within its limits"
    TOLERATED = "beyond a limit by less than the tolerance"
    TURNED = "within its limits after whole turns"
    BEYOND = "beyond a limit"


@dataclass(frozen=True, eq=False)
class Limits:
    """The limits of J joints.

    Attributes:
        joints: J names.
        lower, upper: (J,) rad or m, infinite where a joint has none.
        slides: (J,) true where a joint slides (m), false where it turns (rad).
    """

    joints: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    slides: BoolArray

    @property
    def tolerance(self) -> FloatArray:
        """(J,) how far beyond a limit a position may be, rad or m."""
        stated = np.where(self.slides, TOLERANCE_M, TOLERANCE_RAD)
        return np.minimum(stated, TOLERANCE_SHARE * (self.upper - self.lower))

    def excess(self, positions: FloatArray) -> FloatArray:
        """How far positions (..., J) are beyond the nearer limit, 0 within both."""
        return np.maximum(0.0, np.maximum(self.lower - positions, positions - self.upper))

    def clamped(self, positions: FloatArray) -> FloatArray:
        """Positions (..., J), those beyond a limit moved onto it."""
        return np.clip(positions, self.lower, self.upper)

    def fit(self, positions: FloatArray) -> BoolArray:
        """(J,) whether all positions (T, J) of a joint are within its limits and the tolerance."""
        return np.asarray((self.excess(positions) <= self.tolerance).all(axis=0))


@dataclass(frozen=True)
class JointJudgement:
    """What is to be said of one joint.

    Attributes:
        joint: its name.
        slides: it slides (m) and does not turn (rad).
        verdict: what became of its positions.
        value: the position furthest beyond a limit, as given; NaN for a joint within its limits.
        limit: the limit that `value` is beyond; NaN for a joint within its limits.
        sample: the index of `value` among the T positions; 0 for a joint within its limits.
        lower, upper: the joint's limits.
    """

    joint: str
    slides: bool
    verdict: Verdict
    value: float
    limit: float
    sample: int
    lower: float
    upper: float

    def __str__(self) -> str:
        """Such as "joint 'elbow' is at 143.2; its limits are 0.8 to 5.4 rad"."""
        unit = "m" if self.slides else "rad"
        limits = f"its limits are {self.lower:.6g} to {self.upper:.6g} {unit}"
        if self.verdict is Verdict.TURNED:
            return (
                f"joint {self.joint!r} is at {self.value:.6g}, a whole turn from its limits, {self.lower:.6g} to "
                f"{self.upper:.6g} rad"
            )
        return f"joint {self.joint!r} is at {self.value:.6g}; {limits}"


@dataclass(frozen=True, eq=False)
class Judgement:
    """What is to be said of all joints.

    Attributes:
        joints: one judgement for each of the J joints.
        positions: (T, J) as given, but for the whole turns that bring a joint within its limits.
        cause: what the positions look like, one sentence with a remedy, if they look like something that they should
            not be; None otherwise.
    """

    joints: tuple[JointJudgement, ...]
    positions: FloatArray
    cause: str | None

    def of(self, verdict: Verdict) -> tuple[JointJudgement, ...]:
        """The joints with this verdict."""
        return tuple(one for one in self.joints if one.verdict is verdict)

    @property
    def refusal(self) -> str | None:
        """Why the positions cannot be used: joint, value, limits, likely cause. None if they can."""
        beyond = self.of(Verdict.BEYOND)
        if not beyond:
            return None
        more = len(beyond) - 1
        others = f" ({more} more joint{'s are' if more > 1 else ' is'} beyond a limit)" if more else ""
        return f"{beyond[0]}{others}." + (f" {self.cause}" if self.cause else "")

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is odd about positions that are used, or was done to them, one phrase each."""
        joints = tuple(str(one) for one in self.of(Verdict.TURNED) + self.of(Verdict.TOLERATED))
        return joints + ((self.cause.rstrip("."),) if self.cause else ())


def judge_positions(limits: Limits, positions: FloatArray) -> Judgement:
    """Judge positions of a scene's joints by the joints' limits.

    A joint is within its limits, or beyond one by less than the tolerance (see `Limits.tolerance`), or within them
    after whole turns, or beyond. Whole turns are added to a limited hinge where its positions are one turn away, or
    where they jump by a turn from one sample to the next, as drivers that report within one turn let them. Joints
    without limits are always within them.

    Args:
        limits: of the J joints, such as `Scene.limits`.
        positions: (T, J) rad or m, T >= 1, one row after another as recorded.

    Raises:
        ArgumentError: the positions are not (T, J) or not finite.
    """
    positions = np.asarray(positions, dtype=np.float64)
    if positions.ndim != 2 or not len(positions) or positions.shape[1] != len(limits.joints):
        raise ArgumentError(
            f"positions have shape {positions.shape}; they must be (T, {len(limits.joints)}), one column for each of "
            f"{', '.join(limits.joints)}."
        )
    if not np.isfinite(positions).all():
        raise ArgumentError("positions must be finite.")
    turned = _turned(limits, positions)
    excess, fits = limits.excess(turned), limits.fit(turned)
    moved = (turned != positions).any(axis=0)
    verdicts = [
        Verdict.BEYOND if not fits[j]
        else Verdict.TURNED if moved[j]
        else Verdict.TOLERATED if excess[:, j].any()
        else Verdict.WITHIN
        for j in range(len(limits.joints))
    ]  # fmt: skip
    judged = tuple(_joint(limits, positions, j, verdict) for j, verdict in enumerate(verdicts))
    cause = many_turns(limits, positions) if fits.all() else likely_cause(limits, positions)
    return Judgement(judged, turned, cause)


def _joint(limits: Limits, positions: FloatArray, j: int, verdict: Verdict) -> JointJudgement:
    given = positions[:, j]
    lower, upper = float(limits.lower[j]), float(limits.upper[j])
    sample, value, limit = 0, np.nan, np.nan
    if verdict is not Verdict.WITHIN:
        sample = int(np.maximum(lower - given, given - upper).argmax())
        value = float(given[sample])
        limit = lower if lower - value > value - upper else upper
    return JointJudgement(limits.joints[j], bool(limits.slides[j]), verdict, value, limit, sample, lower, upper)


def _turned(limits: Limits, positions: FloatArray) -> FloatArray:
    """The positions, with whole turns added to those limited hinges that they bring within their limits."""
    turned = positions.copy()
    hinges = ~limits.slides & np.isfinite(limits.upper - limits.lower)
    jumps = np.concatenate([np.zeros((1, positions.shape[1])), np.rint(np.diff(positions, axis=0) / TURN)])
    smooth = positions - TURN * np.cumsum(jumps, axis=0)
    wanted = hinges & (~limits.fit(positions) | jumps.any(axis=0))
    for turns in (0, 1, -1):
        candidate = smooth + TURN * turns
        fits = wanted & limits.fit(candidate)
        turned[:, fits] = candidate[:, fits]
        wanted &= ~fits
    return turned
