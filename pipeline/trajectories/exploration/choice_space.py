"""The choice space: which trajectories a person could have chosen, declared once and the same for every sampler.

A trajectory of the space is the straight joint path plus a sum of half waves, q(s) = line(s) + sum_k b_k(s) z_k. The
basis b_k is that of `sine_basis`, times `width_rad`. The coefficients z (K, J) are what everything here works on.
They have two useful properties. The base measure is the standard normal, z ~ N(0, I), cut to the space. The effort, the
sum of squared joint steps, is exactly a quadratic form: effort = least effort + sum_k c_k |z_k|^2, as sampled half
waves have orthogonal steps and a straight path has equal ones. So the bound on effort is an ellipsoid.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.trajectories.measures import squared_steps
from pipeline.trajectories.paths import (
    Anchor,
    frozen,
    require_anchor_within,
    require_positive,
    sine_basis,
    straight_path,
    within_limits,
)

Assess = Callable[[FloatArray], tuple[FloatArray, NDArray[np.bool_]]]
"""(N, T, J) waypoints to (N, F) scaled features and (N,) whether the scene allows each: one replay for both."""

Measure = Callable[[FloatArray], FloatArray]
"""(N, T, J) waypoints to (N, F) scaled features, without asking the scene."""

Wanted = Callable[[FloatArray, NDArray[np.intp]], NDArray[np.bool_]]
"""(M, F) features and (M,) rows to (M,) whether a trajectory with these is of use."""

MARGIN = 1.25  # how much more effort than the most wasteful demonstration the default bound allows


@dataclass(frozen=True, eq=False)
class ChoiceSpace:
    """Trajectories between two ends, smooth, within limits, allowed by the scene and of bounded effort.

    Attributes:
        anchor: both ends, joint positions (J,) in rad or m.
        n_waypoints: T.
        lower, upper: (J,) joint limits, infinite for a continuous joint.
        assess: scaled features and whether the scene allows a path; it only sees paths within the limits.
        effort_multiple: largest effort as a multiple of the least possible between the ends, > 1.
        width_rad: of the base measure, the root mean square deviation from the straight path of an uncut draw.
        modes: K, half waves per joint: the smoothness family.
        decay: half wave k of the base measure has an amplitude proportional to k^-decay. Above 3/2 the expected
            effort stays finite as K grows, so the base measure does not depend on where the sum is cut.
        largest_step: (J,) most that a joint may move from one waypoint to the next; None: no limit of speed.
        measure: the features alone, for `evaluate_wanted`, where that is cheaper than `assess`; None: it is not.

    Raises:
        ArgumentError: a number is out of range, or an end is outside the limits.
    """

    anchor: Anchor
    n_waypoints: int
    lower: FloatArray
    upper: FloatArray
    assess: Assess
    effort_multiple: float
    width_rad: float = 0.3
    modes: int = 8
    decay: float = 2.0
    largest_step: FloatArray | None = None
    measure: Measure | None = None

    def __post_init__(self) -> None:
        require_positive("width_rad", self.width_rad)
        sine_basis(self.n_waypoints, self.modes, self.decay)
        for name in ("lower", "upper"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        if not 1 < self.effort_multiple < np.inf:
            raise ArgumentError(f"effort_multiple is {self.effort_multiple}; it must be a finite number > 1.")
        if not self.least_effort > 0:
            raise ArgumentError("anchor starts and ends at the same place; a multiple of no effort bounds nothing.")
        require_anchor_within(self.anchor, self.lower, self.upper)
        if self.largest_step is not None:
            object.__setattr__(self, "largest_step", frozen(self.largest_step))
            step = np.abs(np.diff(self.line, axis=0)).max(axis=0)
            if self.largest_step.shape != step.shape or (step > self.largest_step).any():
                raise ArgumentError(
                    f"largest_step is {self.largest_step}; the straight path needs {step} from one waypoint to the "
                    "next."
                )

    @property
    def joints(self) -> int:
        """J."""
        return self.anchor.start.size

    @cached_property
    def line(self) -> FloatArray:
        """(T, J) the straight path."""
        return straight_path(self.anchor, self.n_waypoints)

    @cached_property
    def basis(self) -> FloatArray:
        """(K, T) the half waves in rad per unit of z."""
        return np.asarray(self.width_rad * sine_basis(self.n_waypoints, self.modes, self.decay))

    @cached_property
    def stiffness(self) -> FloatArray:
        """(K,) c_k, the effort of one unit of z_k."""
        return np.asarray((np.diff(self.basis, axis=1) ** 2).sum(axis=1))

    @cached_property
    def least_effort(self) -> float:
        """Effort of the straight path at even speed, rad^2: no other between the ends has less."""
        return float(squared_steps(self.line[None])[0])

    @property
    def most_effort(self) -> float:
        """The bound, rad^2."""
        return self.effort_multiple * self.least_effort

    def effort(self, z: FloatArray) -> FloatArray:
        """(N, K, J) -> (N,) sum of squared joint steps, rad^2, without building the path."""
        return np.asarray(self.least_effort + (z**2).sum(axis=2) @ self.stiffness)

    def decode(self, z: FloatArray) -> FloatArray:
        """(N, K, J) -> waypoints (N, T, J); both ends are the anchor's to the last bit."""
        by_joint = np.ascontiguousarray(np.moveaxis(z, 2, 0)).reshape(-1, self.modes) @ self.basis
        paths = by_joint.reshape(self.joints, len(z), self.n_waypoints) + self.line.T[:, None]
        return np.moveaxis(paths, 0, 2)

    def encode(self, waypoints: FloatArray) -> FloatArray:
        """(N, T, J) -> (N, K, J), the nearest member of the family to each path's deviation from *its own* line.

        A recorded path does not start and end exactly where the space does, so its ends take no part.
        """
        s = np.linspace(0.0, 1.0, self.n_waypoints)[None, :, None]
        own = waypoints[:, :1] + s * (waypoints[:, -1:] - waypoints[:, :1])
        square = (self.basis**2).sum(axis=1)
        return np.asarray(np.einsum("kt,ntj->nkj", self.basis / square[:, None], waypoints - own))

    def evaluate(self, z: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Features (N, F) and membership (N,) of coefficients (N, K, J); a non-member's features are NaN.

        The cheap tests come first: effort, then limits and speed, then the replay.
        """
        inside, waypoints = self._within_bounds(z)
        values, allowed = self.assess(waypoints)
        features = np.full((len(z), values.shape[1]), np.nan)
        features[inside] = values
        inside[inside] = allowed
        features[~inside] = np.nan
        return features, inside

    def evaluate_wanted(self, z: FloatArray, wanted: Wanted) -> tuple[FloatArray, NDArray[np.bool_]]:
        """As `evaluate`, but for those that are not wanted, whose features are NaN and which count as non-members.

        The scene, which takes most of the time, is only asked about the others.
        """
        if self.measure is None:
            features, inside = self.evaluate(z)
            rows = np.flatnonzero(inside)
            inside[rows] = wanted(features[rows], rows)
        else:
            inside, waypoints = self._within_bounds(z)
            values = self.measure(waypoints)
            features = np.full((len(z), values.shape[1]), np.nan)
            features[inside] = values
            useful = wanted(values, np.flatnonzero(inside))
            inside[inside] = useful
            inside[inside] = self.assess(waypoints[useful])[1]
        features[~inside] = np.nan
        return features, inside

    def _within_bounds(self, z: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
        """(N,) whether effort, limits and speed allow each, and the waypoints of those they allow."""
        inside = self.effort(z) <= self.most_effort
        waypoints = self.decode(z[inside])
        kept = within_limits(waypoints, self.lower, self.upper)
        if self.largest_step is not None:
            kept &= (np.abs(np.diff(waypoints, axis=1)) <= self.largest_step).all(axis=(1, 2))
        inside[inside] = kept
        return inside, waypoints if kept.all() else waypoints[kept]

    def draw_base(self, rng: np.random.Generator, count: int, attempts: int = 1000) -> tuple[FloatArray, FloatArray]:
        """`count` draws from the base measure cut to the space, by rejection: z (count, K, J), features (count, F).

        Raises:
            ArgumentError: fewer than `count` members in `attempts` rounds of `count` draws.
        """
        found: list[tuple[FloatArray, FloatArray]] = []
        missing = count
        for _ in range(attempts):
            z = rng.standard_normal((count, self.modes, self.joints))
            features, inside = self.evaluate(z)
            found.append((z[inside], features[inside]))
            missing -= int(inside.sum())
            if missing <= 0:
                kept_z, kept_features = zip(*found, strict=True)
                return np.concatenate(kept_z)[:count], np.concatenate(kept_features)[:count]
        raise ArgumentError(
            f"width_rad is {self.width_rad:g} and effort_multiple {self.effort_multiple:g}; only {count - missing} of "
            f"{count * attempts} draws of this base measure are in the space, so make the width smaller or the bound "
            "larger."
        )

    def declaration(self) -> dict[str, float | int | list[float] | None]:
        """What was declared, as plain numbers to keep with every result (the scene has its own hash)."""
        return {
            "n_waypoints": self.n_waypoints,
            "modes": self.modes,
            "decay": self.decay,
            "width_rad": self.width_rad,
            "effort_multiple": self.effort_multiple,
            "least_effort_rad2": self.least_effort,
            "start": self.anchor.start.tolist(),
            "goal": self.anchor.goal.tolist(),
            "lower": self.lower.tolist(),
            "upper": self.upper.tolist(),
            "largest_step": None if self.largest_step is None else self.largest_step.tolist(),
        }


def default_effort_multiple(demonstrations: FloatArray, margin: float = MARGIN) -> float:
    """The default bound: `margin` times the effort of the most wasteful demonstration, rounded up to a tenth.

    Each demonstration (N, T, J) is compared with the straight path between its own ends.

    Raises:
        ArgumentError: a demonstration ends where it starts.
    """
    ends = demonstrations[:, -1] - demonstrations[:, 0]
    least = (ends**2).sum(axis=1) / (demonstrations.shape[1] - 1)
    if not (least > 0).all():
        raise ArgumentError("demonstrations has one that ends where it starts; declare effort_multiple yourself.")
    return math.ceil(round(10 * margin * float((squared_steps(demonstrations) / least).max()), 9)) / 10


def default_width(demonstrations: FloatArray) -> float:
    """The default width of the base measure: rms deviation (rad) of demonstrations from their own straight paths."""
    s = np.linspace(0.0, 1.0, demonstrations.shape[1])[None, :, None]
    own = demonstrations[:, :1] + s * (demonstrations[:, -1:] - demonstrations[:, :1])
    return float(np.sqrt(((demonstrations - own) ** 2).mean()))
