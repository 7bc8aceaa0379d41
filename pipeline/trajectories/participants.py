"""Simulated participants: what they want, how their hands move the arm, and what the robot's driver records.

A demonstration is made in three steps, none of which uses a choice model. `optimise_paths` finds a path of low cost for
the participant's weights, `demonstrate` moves the arm along it as a hand would, and `driver_messages` reports the
motion as the driver's joint encoders do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError, StageError
from pipeline.trajectories.measured_hand import Habit, uneven_speed, wandering
from pipeline.trajectories.paths import (
    Admissible,
    frozen,
    require_positive,
    sine_basis,
    within_limits,
)

_MOTION_HZ = 100  # sampling rate of a simulated motion: ten samples per period of a 10 Hz tremor
_ATTEMPTS = 200  # motions that are tried along one path before it is given up


@dataclass(frozen=True, eq=False)
class Participant:
    """One simulated person.

    Attributes:
        name: such as "participant-01".
        theta: (F,) cost weights, a unit vector of non-negative numbers.
        skill: 0 to 1; the disturbances have 2 (1 - skill) times the amplitudes of `Hand`.
    """

    name: str
    theta: FloatArray
    skill: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta", frozen(self.theta))
        if not 0 <= self.skill <= 1:
            raise ArgumentError(f"skill is {self.skill}; it must be between 0 and 1.")


@dataclass(frozen=True)
class Hand:
    """How hands disturb a path. The amplitudes are those at skill 1/2.

    `ramp` and `speed_variation` match the 21 recorded demonstrations of a JACO arm that its lab published:
    there the median of the mean square speed over the squared mean speed is 1.16, and it is 1.16 with these.

    Attributes:
        duration_s: shortest and longest duration of the motion.
        ramp: share of the duration during which the arm speeds up, and during which it slows down.
        speed_variation: standard deviation of the logarithm of the speed in between.
        drift_rad: root mean square of the slow deviation from the path, per joint.
        misplacement_rad: standard deviation of the error of start and goal, per joint.
        tremor_rad: root mean square of the tremor, per joint.
        tremor_hz: lowest and highest frequency of the tremor.
    """

    duration_s: tuple[float, float] = (4.0, 15.0)
    ramp: float = 0.12
    speed_variation: float = 0.45
    drift_rad: float = 0.03
    misplacement_rad: float = 0.02
    tremor_rad: float = 0.0005
    tremor_hz: tuple[float, float] = (8.0, 12.0)

    def __post_init__(self) -> None:
        for name in ("duration_s", "tremor_hz"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise ArgumentError(f"{name} is {(low, high)}; it must be two increasing positive numbers.")
        if not 0 < self.ramp <= 0.5:
            raise ArgumentError(f"ramp is {self.ramp}; it must be above 0 and at most 1/2.")
        for name in ("speed_variation", "drift_rad", "misplacement_rad", "tremor_rad"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ArgumentError(f"{name} is {getattr(self, name)}; it must be a finite number >= 0.")


@dataclass(frozen=True, eq=False)
class Motion:
    """The true motion of the arm: joint positions (M, J) at the times (M,) s, of which the first is 0."""

    time_s: FloatArray
    positions: FloatArray


@dataclass(frozen=True)
class Driver:
    """A robot driver that publishes joint states.

    Attributes:
        joints: names of the arm's joints, in the order of the motion.
        continuous: for each joint, whether it turns without limit.
        fingers: names of further joints, which stay at rest and are published after the arm's.
        rate_hz: nominal message rate.
        jitter_s: standard deviation of the difference between a message's time and its nominal time.
        idle_head_s: shortest and longest time that is recorded before the motion.
        idle_tail_s: shortest and longest time that is recorded after the motion.
        noise_rad: standard deviation of the encoder noise.
        wrapped_share: share of the recordings in which the encoders of continuous joints report positions within one
            turn, 0 to 2 pi or -pi to pi. In the others they count turns.
    """

    joints: tuple[str, ...]
    continuous: tuple[bool, ...]
    fingers: tuple[str, ...] = ()
    rate_hz: float = 100.0
    jitter_s: float = 0.001
    idle_head_s: tuple[float, float] = (0.5, 2.0)
    idle_tail_s: tuple[float, float] = (0.5, 2.0)
    noise_rad: float = 0.0005
    wrapped_share: float = 0.5

    def __post_init__(self) -> None:
        if len(self.joints) != len(self.continuous) or not self.joints:
            raise ArgumentError(f"continuous has {len(self.continuous)} entries for {len(self.joints)} joints.")
        require_positive("rate_hz", self.rate_hz)
        for name in ("idle_head_s", "idle_tail_s"):
            low, high = getattr(self, name)
            if not 0 <= low <= high < np.inf:
                raise ArgumentError(f"{name} is {(low, high)}; it must be two increasing numbers >= 0.")
        if min(self.jitter_s, self.noise_rad) < 0 or not 0 <= self.wrapped_share <= 1:
            raise ArgumentError(
                f"jitter_s is {self.jitter_s}, noise_rad {self.noise_rad}, wrapped_share {self.wrapped_share}; "
                f"allowed are >= 0, >= 0 and 0 to 1."
            )


@dataclass(frozen=True, eq=False)
class DriverLog:
    """Published joint states: times (M,) in ns, strictly increasing; joint names (K,); positions (M, K) in rad."""

    time_ns: IntArray
    names: tuple[str, ...]
    positions: FloatArray


def draw_participants(
    rng: np.random.Generator,
    theta: FloatArray,
    count: int,
    *,
    spread_rad: float = 0.15,
    skill: tuple[float, float] = (0.25, 0.75),
) -> tuple[Participant, ...]:
    """Draw people whose cost weights differ a little from those of the task.

    The task's weights, as a point on the unit sphere, are moved by a normal tangent vector, with standard deviation
    `spread_rad` in each direction. It is drawn again if a weight becomes negative.

    Args:
        rng: random generator for the participants of one task.
        theta: (F,) cost weights of the task, >= 0 and not all zero; only their direction matters.
        count: number of people, >= 1.
        spread_rad: standard deviation of the weights, as an angle in each direction.
        skill: least and greatest skill, between which it is uniformly distributed.

    Raises:
        ArgumentError: an argument is out of range.
    """
    theta = np.asarray(theta, dtype=np.float64)
    if theta.ndim != 1 or not np.isfinite(theta).all() or (theta < 0).any() or not theta.any():
        raise ArgumentError(f"theta is {theta.tolist()}; it must be a vector of weights >= 0, not all zero.")
    if count < 1 or not 0 <= spread_rad <= 1 or not 0 <= skill[0] <= skill[1] <= 1:
        raise ArgumentError(
            f"count is {count}, spread_rad {spread_rad} and skill {skill}; "
            f"allowed are >= 1, 0 to 1 and two increasing numbers between 0 and 1."
        )
    unit = theta / np.linalg.norm(theta)
    digits = max(2, len(str(count)))
    return tuple(
        Participant(f"participant-{i:0{digits}d}", _turned(rng, unit, spread_rad), rng.uniform(*skill))
        for i in range(1, count + 1)
    )


def demonstrate(
    rng: np.random.Generator,
    path: FloatArray,
    skill: float,
    hand: Hand,
    habit: Habit | None = None,
    *,
    lower: FloatArray,
    upper: FloatArray,
    admissible: Admissible,
) -> Motion:
    """Move the arm along `path` as a hand would.

    The motion starts and ends slightly beside the path, drifts slowly around it, speeds up, varies its speed, slows
    down, and trembles. A motion that leaves the limits or that the scene does not allow is drawn again.

    Args:
        rng: random generator for this demonstration.
        path: (T, J) the path that the participant intends.
        skill: 0 to 1, see `Participant`.
        hand: the disturbances.
        habit: how far and how unevenly the person moves; with it the hand wanders as measured, instead of drifting by
            `hand.drift_rad`.
        lower, upper: (J,) joint limits (rad), infinite for a continuous joint.
        admissible: from (N, M, J) positions to (N,) whether the scene allows each; called with one motion at a time.

    Raises:
        ArgumentError: the path is not a finite (T, J) array, or the skill is not between 0 and 1.
        StageError: no motion near the path is allowed.
    """
    if path.ndim != 2 or len(path) < 2 or not np.isfinite(path).all() or not 0 <= skill <= 1:
        raise ArgumentError(
            f"path has shape {path.shape} and skill is {skill}; needed are finite (T, J), T >= 2, and 0 to 1."
        )
    for _ in range(_ATTEMPTS):
        motion = _disturbed(rng, path, 2 * (1 - skill), hand, habit)
        positions = motion.positions[None]
        if within_limits(positions, lower, upper)[0] and admissible(positions)[0]:
            return motion
    raise StageError(
        f"none of {_ATTEMPTS} motions along the path kept the joint limits and was allowed by the scene; plan the "
        f"path with more clearance or lower drift_rad (now {hand.drift_rad:g} at a skill of {skill:.2f})."
    )


def driver_messages(rng: np.random.Generator, motion: Motion, driver: Driver, start_time_ns: int) -> DriverLog:
    """The messages that the driver publishes while the arm rests, moves as in `motion`, and rests again.

    Args:
        rng: random generator for this recording.
        motion: the motion of the arm.
        driver: rate, noise and names.
        start_time_ns: time of the first nominal sample, ns since the epoch.

    Raises:
        ArgumentError: the driver has another number of joints than the motion.
    """
    if motion.positions.shape[1] != len(driver.joints):
        raise ArgumentError(
            f"driver.joints names {len(driver.joints)} joints, the motion has {motion.positions.shape[1]}; name each."
        )
    head_s = rng.uniform(*driver.idle_head_s)
    tail_s = rng.uniform(*driver.idle_tail_s)
    nominal_s = np.arange(0.0, head_s + motion.time_s[-1] + tail_s, 1 / driver.rate_hz)
    # Clipped so that neighbours keep their order: a driver may be late, but it does not publish out of order.
    reach = 0.45 / driver.rate_hz
    time_s = nominal_s + np.clip(rng.normal(0.0, driver.jitter_s, nominal_s.size), -reach, reach)
    arm = np.stack([np.interp(time_s - head_s, motion.time_s, joint) for joint in motion.positions.T], axis=1)
    arm = _reported(rng, arm + rng.normal(0.0, driver.noise_rad, arm.shape), driver)
    fingers = np.zeros((time_s.size, len(driver.fingers)))
    time_ns = start_time_ns + np.rint(1e9 * time_s).astype(np.int64)
    time_ns.setflags(write=False)
    return DriverLog(time_ns, driver.joints + driver.fingers, frozen(np.hstack([arm, fingers])))


def _turned(rng: np.random.Generator, unit: FloatArray, spread_rad: float) -> FloatArray:
    """(F,) the unit vector `unit`, moved by a normal tangent vector; the weights stay >= 0."""
    while True:
        tangent = spread_rad * rng.standard_normal(unit.size)
        tangent -= (tangent @ unit) * unit
        angle = float(np.linalg.norm(tangent))
        theta: FloatArray = np.cos(angle) * unit + np.sinc(angle / np.pi) * tangent
        if (theta >= 0).all():
            return theta


def _disturbed(rng: np.random.Generator, path: FloatArray, amplitude: float, hand: Hand, habit: Habit | None) -> Motion:
    """A motion along the path with disturbances of `amplitude` times those of `hand`."""
    from scipy.interpolate import CubicSpline

    joints = path.shape[1]
    duration_s = rng.uniform(*hand.duration_s)
    samples = int(np.ceil(duration_s * _MOTION_HZ)) + 1
    time_s = np.linspace(0.0, duration_s, samples)
    places, drift_rad = np.linspace(0.0, 1.0, len(path)), hand.drift_rad
    if habit is not None:
        path, drift_rad = wandering(rng, path, habit.length), 0.0
        along = np.concatenate([[0.0], np.cumsum(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1)) + 1e-12)])
        places = along / along[-1]  # so that the speed of the hand is that of its progress
    progress = _progress(rng, samples, hand, habit)
    drift = sine_basis(samples, 6, 1.0).T @ rng.standard_normal((6, joints))
    ends = rng.standard_normal((2, joints))
    misplacement = (1 - progress)[:, None] * ends[0] + progress[:, None] * ends[1]
    positions = CubicSpline(places, path)(progress) + amplitude * (
        drift_rad * drift + hand.misplacement_rad * misplacement + hand.tremor_rad * _tremor(rng, time_s, joints, hand)
    )
    return Motion(frozen(time_s), frozen(positions))


def _progress(rng: np.random.Generator, samples: int, hand: Hand, habit: Habit | None) -> FloatArray:
    """(M,) the fraction of the path that is covered: from 0 to 1, never decreasing, at rest at both ends."""
    s = np.linspace(0.0, 1.0, samples)
    to_end = np.minimum(s, 1 - s) / hand.ramp
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.minimum(to_end, 1.0))
    if habit is not None:
        speed = uneven_speed(rng, ramp, habit.unevenness)
    else:
        speed = ramp * np.exp(hand.speed_variation * (rng.standard_normal(4) @ sine_basis(samples, 4, 1.0)))
    distance = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)])
    fraction: FloatArray = distance / distance[-1]
    return fraction


def _tremor(rng: np.random.Generator, time_s: FloatArray, joints: int, hand: Hand) -> FloatArray:
    """(M, J) tremor of unit root mean square: a few tones per joint that fade in and out with the motion."""
    tones = 4
    frequency_hz = rng.uniform(*hand.tremor_hz, (tones, joints))
    phase = rng.uniform(0.0, 2 * np.pi, (tones, joints))
    waves = np.sin(2 * np.pi * frequency_hz * time_s[:, None, None] + phase).sum(axis=1)
    # A tone under a half-sine envelope has mean square 1/4, so the sum of four has mean square 1.
    tremor: FloatArray = np.sin(np.pi * time_s / time_s[-1])[:, None] * waves * np.sqrt(4 / tones)
    return tremor


def _reported(rng: np.random.Generator, arm: FloatArray, driver: Driver) -> FloatArray:
    """(M, J) the positions that this recording's encoders report: counting turns, or within one turn."""
    if rng.random() >= driver.wrapped_share:
        return arm
    lowest = -np.pi * rng.integers(2)  # 0 to 2 pi, or -pi to pi
    reported = arm.copy()
    turning = np.array(driver.continuous)
    reported[:, turning] = lowest + np.mod(arm[:, turning] - lowest, 2 * np.pi)
    return reported
