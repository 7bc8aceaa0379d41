"""Samplers of alternatives: random paths from a start to a goal, of which impossible ones are rejected.

Shapes and units are those of `paths`; every path starts and ends exactly at its anchor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError, StageError
from pipeline.trajectories.paths import (
    Anchor,
    frozen,
    natural_bump,
    require_anchor_within,
    require_positive,
    sine_basis,
    straight_path,
    within_limits,
)
from pipeline.vocabulary import DEFORMATION, MIXTURE, PLANNER, VIA_POINT

__all__ = [
    "Anchor",
    "Deformation",
    "Draw",
    "Fate",
    "Mixture",
    "Planner",
    "Sampler",
    "Tally",
    "ViaPoint",
    "draw_admissible",
    "propose",
]

_HOPELESS_AFTER = 2000  # proposals before a low share of accepted ones is an error


class Fate(IntEnum):
    """Whether a proposal is kept, or the first reason that applies for discarding it."""

    KEPT = 0
    OUTSIDE_LIMITS = 1
    THROUGH_SURFACE = 2
    IN_COLLISION = 3


Judge = Callable[[FloatArray], IntArray]
"""From waypoints (N, T, J) within the joint limits to the fate (N,) of each path in the scene."""


class Sampler(Protocol):
    """Draws paths, none of which it rejects."""

    @property
    def name(self) -> str:
        """The value of the `sampler` column."""

    def sample(self, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int) -> FloatArray:
        """Draw (count, n_waypoints, J) paths from anchor.start to anchor.goal."""


@dataclass(frozen=True)
class Deformation:
    """The straight joint path plus a smooth Gaussian deformation that vanishes at both ends.

    q(s) = line(s) + width * sum_k b_k(s) z_k, with z_k ~ N(0, I_J) and the `sine_basis` b_k. The joints are
    independent; in each, the covariance of the deviations at times s and s' is width^2 sum_k b_k(s) b_k(s').

    Attributes:
        width_rad: root mean square deviation from the straight path per joint, averaged over the path.
        modes: number of half waves; with more, paths have more bends.
        decay: amplitude of mode k is proportional to k^-decay.
    """

    width_rad: float = 0.3
    modes: int = 5
    decay: float = 2.0
    name: str = DEFORMATION

    def __post_init__(self) -> None:
        require_positive("width_rad", self.width_rad)
        sine_basis(self.modes + 2, self.modes, self.decay)

    def sample(self, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int) -> FloatArray:
        """Draw (count, n_waypoints, J) paths. Each takes one standard normal per mode and joint from the stream."""
        basis = self.width_rad * sine_basis(n_waypoints, self.modes, self.decay)
        z = rng.standard_normal((count, self.modes, anchor.start.size))
        deformation: FloatArray = np.einsum("kt,nkj->ntj", basis, z)
        return straight_path(anchor, n_waypoints) + deformation

    def log_proposal(self, waypoints: FloatArray, anchor: Anchor) -> FloatArray:
        """(N,) log density with which `waypoints` (N, T, J) are drawn, as a density of the modes' amplitudes (rad).

        The density ignores rejection, which would add the same constant to all paths of one anchor.

        Raises:
            ArgumentError: this sampler cannot draw a trajectory: it is more than 1e-5 rad away from all that it can.
        """
        n_waypoints = waypoints.shape[1]
        basis = sine_basis(n_waypoints, self.modes, self.decay)
        scale = np.sqrt((basis**2).sum(axis=1, keepdims=True) * 2 / (n_waypoints - 1))  # (modes, 1), rad per z
        deviation = waypoints - straight_path(anchor, n_waypoints)
        # The sampled sines are orthogonal, so each amplitude is the projection onto its mode.
        amplitude = np.einsum("kt,ntj->nkj", basis / scale, deviation) * 2 / (n_waypoints - 1)
        residual = np.abs(deviation - np.einsum("kt,nkj->ntj", basis / scale, amplitude)).max(initial=0.0)
        if residual > 1e-5:
            raise ArgumentError(
                f"waypoints lie up to {residual:.3g} rad outside what a deformation of {self.modes} modes can "
                f"draw; pass trajectories that this sampler drew from this anchor."
            )
        sigma = self.width_rad * scale
        log_q = -0.5 * (amplitude / sigma) ** 2 - np.log(sigma * np.sqrt(2 * np.pi))
        total: FloatArray = log_q.sum(axis=(1, 2))
        return total


@dataclass(frozen=True)
class ViaPoint:
    """The path of least acceleration (natural cubic spline) from start to goal through one random configuration.

    The via configuration is uniform in a box of half width `reach_rad` around the straight path. It is passed after a
    fraction of the time that is uniform between the two of `when`.

    Attributes:
        reach_rad: largest deviation from the straight path at the via point, per joint.
        when: earliest and latest fraction of the time at which the via point is passed.
    """

    reach_rad: float = 0.75
    when: tuple[float, float] = (0.3, 0.7)
    name: str = VIA_POINT

    def __post_init__(self) -> None:
        require_positive("reach_rad", self.reach_rad)
        if not 0 < self.when[0] <= self.when[1] < 1:
            raise ArgumentError(f"when is {self.when}; it must be two increasing fractions between 0 and 1.")

    def sample(self, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int) -> FloatArray:
        """Draw (count, n_waypoints, J) paths. Each takes J + 1 uniform numbers from the stream."""
        u = rng.random((count, 1 + anchor.start.size))
        peak = self.when[0] + (self.when[1] - self.when[0]) * u[:, :1]
        bump = natural_bump(np.linspace(0.0, 1.0, n_waypoints), peak)
        deviation = self.reach_rad * (2 * u[:, 1:] - 1)
        return straight_path(anchor, n_waypoints) + bump[:, :, None] * deviation[:, None, :]


@dataclass(frozen=True, eq=False)
class Planner:
    """Deformations of planned paths, each of which is picked with the same probability.

    The deviation of the planned path from its own straight path is added to the straight path of the anchor.

    Attributes:
        paths: (P, T, J) planned paths, such as those of `optimise_paths` under random weights.
        deformation: the random deformation that is added to them.
    """

    paths: FloatArray
    deformation: Deformation = Deformation(0.1)
    name: str = PLANNER

    def __post_init__(self) -> None:
        paths = frozen(self.paths)
        object.__setattr__(self, "paths", paths)
        if paths.ndim != 3 or 0 in paths.shape or not np.isfinite(paths).all():
            raise ArgumentError(f"paths has shape {paths.shape}; it must be a finite (P, T, J) array, P >= 1.")

    def sample(self, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int) -> FloatArray:
        """Draw (count, n_waypoints, J) paths; `n_waypoints` must be that of the planned paths."""
        if self.paths.shape[1:] != (n_waypoints, anchor.start.size):
            raise ArgumentError(
                f"paths are of {self.paths.shape[1]} waypoints and {self.paths.shape[2]} joints, and "
                f"{n_waypoints} and {anchor.start.size} were asked for; plan them again for this task."
            )
        picked = self._deviations[rng.integers(len(self.paths), size=count)]
        return self.deformation.sample(rng, anchor, count, n_waypoints) + picked

    @cached_property
    def _deviations(self) -> FloatArray:
        """(P, T, J) deviations of the planned paths from their own straight paths."""
        lines = [straight_path(Anchor(path[0], path[-1]), self.paths.shape[1]) for path in self.paths]
        return self.paths - np.stack(lines)


@dataclass(frozen=True)
class Mixture:
    """Draws each path from one of several samplers, which is picked at random.

    Attributes:
        samplers: the parts of the mixture.
        weights: (len(samplers),) proportional to the probability of each part; they need not sum to one.
    """

    samplers: tuple[Sampler, ...]
    weights: tuple[float, ...]
    name: str = MIXTURE

    def __post_init__(self) -> None:
        if not self.samplers or len(self.samplers) != len(self.weights):
            raise ArgumentError(
                f"weights has {len(self.weights)} entries for {len(self.samplers)} samplers; give one for each."
            )
        for weight in self.weights:
            require_positive("weights", weight)

    def sample(self, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int) -> FloatArray:
        """Draw (count, n_waypoints, J) paths."""
        return propose(self, rng, anchor, count, n_waypoints)[0]


@dataclass(frozen=True)
class Tally:
    """How many proposals of a sampler were kept and discarded; a mixture has one tally for each of its parts.

    Attributes:
        sampler: name of the sampler.
        proposed: number of paths drawn.
        outside_limits: number discarded because a joint leaves its limits.
        through_surface: number discarded because something goes through the surface, of those within the limits.
        in_collision: number discarded because the arm touches itself or something else, of those above the surface.
    """

    sampler: str
    proposed: int
    outside_limits: int = 0
    through_surface: int = 0
    in_collision: int = 0

    @property
    def kept(self) -> int:
        """Number of proposals that were kept."""
        return self.proposed - self.outside_limits - self.through_surface - self.in_collision

    def __add__(self, other: Tally) -> Tally:
        """The tally of the proposals of both, which are of the same sampler."""
        return Tally(
            self.sampler,
            self.proposed + other.proposed,
            self.outside_limits + other.outside_limits,
            self.through_surface + other.through_surface,
            self.in_collision + other.in_collision,
        )


@dataclass(frozen=True, eq=False)
class Draw:
    """The paths that were kept, in the order in which they were drawn, and how many were discarded.

    Attributes:
        waypoints: (N, T, J), read-only.
        sampler: (N,) name of the sampler that drew each path; for a mixture, of its part.
        tallies: one for each of these names, in alphabetical order.
    """

    waypoints: FloatArray
    sampler: tuple[str, ...]
    tallies: tuple[Tally, ...]

    @property
    def rejection_rate(self) -> float:
        """Share of the proposed paths that was discarded."""
        return 1 - sum(t.kept for t in self.tallies) / sum(t.proposed for t in self.tallies)


def draw_admissible(
    sampler: Sampler,
    rng: np.random.Generator,
    anchor: Anchor,
    count: int,
    n_waypoints: int,
    *,
    lower: FloatArray,
    upper: FloatArray,
    judge: Judge,
    least_acceptance: float = 1e-3,
    joints: Sequence[str] = (),
) -> Draw:
    """Draw `count` paths that keep the joint limits and that `judge` keeps. Other paths are discarded.

    Each round draws exactly as many paths as are still missing, so the result depends on the generator's state alone.

    Args:
        sampler: draws the proposals.
        rng: random generator for this one set.
        anchor: start and goal, joint positions (J,).
        count: number of paths wanted, >= 1.
        n_waypoints: T, >= 2.
        lower, upper: (J,) joint limits (rad), infinite for a continuous joint.
        judge: gives each path within the limits its fate.
        least_acceptance: the smallest share of accepted proposals; below it an error is raised.
        joints: J names, for that error; by default their numbers.

    Raises:
        ArgumentError: a count is too small, or the anchor itself is outside the limits.
        StageError: after 2000 proposals or more, too few were accepted.
    """
    if count < 1 or n_waypoints < 2:
        raise ArgumentError(f"count is {count} and n_waypoints {n_waypoints}; allowed are >= 1 and >= 2.")
    require_anchor_within(anchor, lower, upper)
    rounds: list[tuple[FloatArray, NDArray[np.object_]]] = []
    fates: Counter[tuple[str, int]] = Counter()
    beyond = np.zeros(anchor.start.size, dtype=np.intp)  # (J,) paths in which a joint leaves its limits
    missing = count
    while missing:
        paths, fate, drawn_by = _judged(sampler, rng, anchor, missing, n_waypoints, lower, upper, judge)
        accepted = fate == Fate.KEPT
        outside = paths[fate == Fate.OUTSIDE_LIMITS]
        beyond += ((outside < lower) | (outside > upper)).any(axis=1).sum(axis=0)
        rounds.append((paths[accepted], drawn_by[accepted]))
        fates.update(zip(drawn_by.tolist(), fate.tolist(), strict=True))
        missing -= int(accepted.sum())
        proposed = fates.total()
        if proposed >= _HOPELESS_AFTER and count - missing < least_acceptance * proposed:
            left, through, touching = (
                sum(n for (_, fate), n in fates.items() if fate == why) for why in Fate if why != Fate.KEPT
            )
            raise StageError(
                f"sampler {sampler.name!r} had {count - missing} of {proposed} paths accepted ({left} left the "
                f"joint limits, {through} went through the surface, {touching} touched something); at least "
                f"{least_acceptance:g} of them must be: make it narrower or move the start and goal."
                + _culprit(beyond, proposed, anchor, lower, upper, joints)
            )
    waypoints = np.concatenate([paths for paths, _ in rounds])
    waypoints.setflags(write=False)
    tallies = tuple(
        Tally(name, sum(fates[name, fate] for fate in Fate), *(fates[name, fate] for fate in Fate if fate != Fate.KEPT))
        for name in sorted({name for name, _ in fates})
    )
    return Draw(waypoints, tuple(np.concatenate([names for _, names in rounds])), tallies)


def _culprit(
    beyond: NDArray[np.intp],
    proposed: int,
    anchor: Anchor,
    lower: FloatArray,
    upper: FloatArray,
    joints: Sequence[str],
) -> str:
    """A sentence on the joint that most of the paths failed by, if it is one."""
    j = int(beyond.argmax())
    if 2 * beyond[j] < proposed:
        return ""
    name = repr(joints[j]) if joints else f"number {j + 1}"
    return (
        f" Joint {name} left its limits, {lower[j]:.6g} to {upper[j]:.6g}, in {beyond[j]} of them, on its way from "
        f"{anchor.start[j]:.6g} to {anchor.goal[j]:.6g}; if it is no part of the arm, as a finger or a drawer is "
        "none, leave it out of the task's `joints`."
    )


def _judged(
    sampler: Sampler,
    rng: np.random.Generator,
    anchor: Anchor,
    count: int,
    n_waypoints: int,
    lower: FloatArray,
    upper: FloatArray,
    judge: Judge,
) -> tuple[FloatArray, IntArray, NDArray[np.object_]]:
    """(count, T, J) proposals, (count,) the fate of each and (count,) the name of the sampler that drew it."""
    paths, drawn_by = propose(sampler, rng, anchor, count, n_waypoints)
    inside = within_limits(paths, lower, upper)
    fate = np.where(inside, Fate.KEPT, Fate.OUTSIDE_LIMITS)
    if inside.any():
        fate[inside] = judge(paths[inside])
    return paths, fate, drawn_by


def propose(
    sampler: Sampler, rng: np.random.Generator, anchor: Anchor, count: int, n_waypoints: int
) -> tuple[FloatArray, NDArray[np.object_]]:
    """Draw (count, T, J) paths, none of which is rejected, with (count,) the name of the sampler that drew each.

    For a mixture it is the name of its part.
    """
    if not isinstance(sampler, Mixture):
        return sampler.sample(rng, anchor, count, n_waypoints), np.full(count, sampler.name, dtype=object)
    weights = np.array(sampler.weights)
    picked = rng.choice(len(weights), size=count, p=weights / weights.sum())
    paths = np.empty((count, n_waypoints, anchor.start.size))
    names = np.empty(count, dtype=object)
    for index, part in enumerate(sampler.samplers):
        rows = picked == index
        paths[rows], names[rows] = propose(part, rng, anchor, int(rows.sum()), n_waypoints)
    return paths, names
