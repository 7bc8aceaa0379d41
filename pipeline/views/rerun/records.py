"""What the recording of a task shows: records that its writers read and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import ArgumentError

if TYPE_CHECKING:
    import polars as pl

    from pipeline.arrays import FloatArray, IntArray
    from pipeline.replay.geometry import Geometry
    from pipeline.views.task_summary import DensityCurve, DensityMap

TIMELINE = "replay"


@dataclass(frozen=True)
class Replay:
    """The demonstrations played one after another.

    Attributes:
        geometry: the shapes of the arm and its scene.
        body_positions: (M, B, 3) m, world frame, bodies as in the geometry.
        body_quaternions: (M, B, 4) wxyz, world frame.
        time_s: (M,) strictly increasing.
        demonstration: (M,) row of the demonstration that each sample belongs to, 0..n-1, none skipped.
    """

    geometry: Geometry
    body_positions: FloatArray
    body_quaternions: FloatArray
    time_s: FloatArray
    demonstration: IntArray


@dataclass(frozen=True)
class AlternativeSet:
    """Paths of one set of alternatives; in the viewer's tree a branch per part of its name, a leaf per sampler.

    Attributes:
        name: the branches down to the set: `("working",)`, `("sets of 100", "set 03")`.
        samplers: (A,) which sampler drew each.
        paths: (A, T', 3) m, of the end effector in the world's frame.
        log_weights: (A,) LESS's log weight of each in its set.
        shown: whether it is to be seen before anybody selects it.
    """

    name: tuple[str, ...]
    samplers: tuple[str, ...]
    paths: FloatArray
    log_weights: FloatArray
    shown: bool = False

    def __post_init__(self) -> None:
        count = len(self.log_weights)
        _check_shape(f"paths of {self.label}", self.paths, (count, None, 3))
        if not self.name or len(self.samplers) != count:
            raise ArgumentError(f"{self.label} needs a name and {count} samplers; got {len(self.samplers)}.")

    @property
    def label(self) -> str:
        """The name in one piece."""
        return ", ".join(self.name)


@dataclass(frozen=True)
class FeatureSpace:
    """Alternatives and demonstrations as points along three features.

    Attributes:
        features: names of the three.
        units: theirs.
        alternatives: (N, 3) raw values.
        log_weights: (N,) LESS's log weight of each.
        demonstrations: (n, 3) raw values.
    """

    features: tuple[str, str, str]
    units: tuple[str, str, str]
    alternatives: FloatArray
    log_weights: FloatArray
    demonstrations: FloatArray

    def __post_init__(self) -> None:
        _check_shape("alternatives of the feature space", self.alternatives, (len(self.log_weights), 3))
        _check_shape("demonstrations of the feature space", self.demonstrations, (len(self.demonstrations), 3))


@dataclass(frozen=True)
class Inspection:
    """Everything that the recording of one task shows; nothing in it is computed here.

    Attributes:
        task: its name.
        replay: the arm over time.
        demonstration_ids: (n,) in the order of the replay.
        demonstration_paths: (n, T, 3) m, of the end effector in the world's frame.
        alternatives: at least one set, of as many alternatives as are to be drawn (150 of a set are plenty).
        curves: at least one; the first is shown first.
        map: the density over two features.
        space: points along three features; None where there are fewer.
        theta_labels: (K,) the hypotheses in words.
        theta_meaning: what the numbers in the labels are.
        posteriors: by model, (n + 1, K): row k after the first k demonstrations, row 0 the prior; each sums to one.
        robustness: rows of `robustness_summary` that are to be drawn, or None if that study was not run.
        summary: Markdown: the task, the numbers and where they came from.
    """

    task: str
    replay: Replay
    demonstration_ids: tuple[str, ...]
    demonstration_paths: FloatArray
    alternatives: tuple[AlternativeSet, ...]
    curves: tuple[DensityCurve, ...]
    map: DensityMap
    space: FeatureSpace | None
    theta_labels: tuple[str, ...]
    theta_meaning: str
    posteriors: Mapping[str, FloatArray]
    robustness: pl.DataFrame | None
    summary: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "posteriors", MappingProxyType(dict(self.posteriors)))
        n, k = len(self.demonstration_ids), len(self.theta_labels)
        replay, bodies = self.replay, len(self.replay.geometry.body_names)
        samples = len(replay.time_s)
        if not self.curves or not self.posteriors or not self.alternatives or n == 0:
            raise ArgumentError(
                "an inspection needs at least one demonstration, one set of alternatives, one density curve and one model."
            )
        _check_shape("demonstration_paths", self.demonstration_paths, (n, None, 3))
        _check_shape("replay.body_positions", replay.body_positions, (samples, bodies, 3))
        _check_shape("replay.body_quaternions", replay.body_quaternions, (samples, bodies, 4))
        for model, posterior in self.posteriors.items():
            _check_shape(f"posteriors[{model!r}]", posterior, (n + 1, k))
        if not (np.diff(replay.time_s) > 0).all():
            raise ArgumentError("replay.time_s must increase strictly; it does not.")
        if not np.array_equal(np.unique(replay.demonstration), np.arange(n)):
            raise ArgumentError(f"replay.demonstration must name each of the {n} demonstrations 0..{n - 1}.")

    @property
    def end_s(self) -> FloatArray:
        """(n,) when each demonstration has been played."""
        return np.array(
            [self.replay.time_s[self.replay.demonstration == i][-1] for i in range(len(self.demonstration_ids))]
        )

    @property
    def start_s(self) -> FloatArray:
        """(n,) when each demonstration begins to play."""
        return np.array(
            [self.replay.time_s[self.replay.demonstration == i][0] for i in range(len(self.demonstration_ids))]
        )


def _check_shape(name: str, array: FloatArray, shape: tuple[int | None, ...]) -> None:
    got = np.shape(array)
    if len(got) != len(shape) or any(want not in (None, have) for want, have in zip(shape, got, strict=True)):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise ArgumentError(f"{name} must have shape ({wanted}); got {got}.")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name} must be finite; it holds NaN or infinity.")
