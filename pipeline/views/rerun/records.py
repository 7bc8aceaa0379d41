"""Records of everything that the recording of a task shows; its writers read nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import ArgumentError
from pipeline.views.hypothesis_rows import HypothesisRows, rows_that_matter

if TYPE_CHECKING:
    import polars as pl

    from pipeline.arrays import FloatArray, IntArray
    from pipeline.replay.geometry import Geometry
    from pipeline.views.feature_axis import FeatureAxis
    from pipeline.views.task_summary import DensityCurve, DensityMap


@dataclass(frozen=True)
class Replay:
    """The demonstrations, played one after another.

    Attributes:
        geometry: the shapes of the arm and its scene.
        body_positions: (M, B, 3) m, in the world frame, in the order of the geometry's bodies.
        body_quaternions: (M, B, 4) wxyz, in the world frame.
        time_s: (M,) s, strictly increasing.
        demonstration: (M,) row of the demonstration that each sample belongs to; each of 0 to n - 1 occurs.
    """

    geometry: Geometry
    body_positions: FloatArray
    body_quaternions: FloatArray
    time_s: FloatArray
    demonstration: IntArray


@dataclass(frozen=True)
class AlternativeSet:
    """The paths of a set of alternatives. The viewer's tree has a branch per part of its name and a leaf per sampler.

    Attributes:
        name: the branches that lead to the set, such as `("working",)` or `("sets of 100", "set 03")`.
        samplers: (A,) name of the sampler that drew each path.
        paths: (A, T', 3) m, paths of the end effector in the world frame.
        log_weights: (A,) log weight of each alternative under LESS, in its set.
        shown: whether it is visible before the user selects it.
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
        """The parts of the name, joined by commas."""
        return ", ".join(self.name)


@dataclass(frozen=True)
class FeatureSpace:
    """Alternatives and demonstrations as points along three features.

    Attributes:
        labels: of their axes, with units.
        alternatives: (N, 3) values of the alternatives on these axes.
        log_weights: (N,) log weight of each alternative under LESS.
        demonstrations: (n, 3) values of the demonstrations.
        wanted: by the name of a model, (3,) what people want by its belief: the reward for each unit of the axes.
        truth: (3,) what they truly want, likewise; None if that is not known.
    """

    labels: tuple[str, str, str]
    alternatives: FloatArray
    log_weights: FloatArray
    demonstrations: FloatArray
    wanted: Mapping[str, FloatArray] = field(default_factory=dict)
    truth: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "wanted", MappingProxyType(dict(self.wanted)))
        _check_shape("alternatives of the feature space", self.alternatives, (len(self.log_weights), 3))
        _check_shape("demonstrations of the feature space", self.demonstrations, (len(self.demonstrations), 3))


@dataclass(frozen=True)
class Motions:
    """Demonstrations along their waypoints.

    Attributes:
        joints: (J,) names of the joints.
        joint_units: (J,) `rad` or `m`.
        axes: (F,) the features.
        waypoints: (n, T, J).
        along: (n, T, F) value of each feature at each waypoint, in its unit; NaN where it has none.
        raw: (n, F) raw value of each feature for the whole.
    """

    joints: tuple[str, ...]
    joint_units: tuple[str, ...]
    axes: tuple[FeatureAxis, ...]
    waypoints: FloatArray
    along: FloatArray
    raw: FloatArray

    def __post_init__(self) -> None:
        n, length = self.waypoints.shape[:2]
        _check_shape("waypoints of motions", self.waypoints, (n, length, len(self.joints)))
        _check_shape("raw values of motions", self.raw, (n, len(self.axes)))
        if self.along.shape != (n, length, len(self.axes)):
            raise ArgumentError(f"features along motions have shape {self.along.shape}; not one per waypoint.")


@dataclass(frozen=True)
class Weights:
    """The weights of the features.

    Attributes:
        features: (F,) names.
        summary: `model`, `feature`, `low`, `median` and `high` of the direction's part along each scaled feature.
        truth: (F,) what simulated people truly want; None if that is not known.
    """

    features: tuple[str, ...]
    summary: pl.DataFrame
    truth: FloatArray | None = None


@dataclass(frozen=True)
class Predicted:
    """Where the end effector of someone new is predicted to be, under one model.

    Attributes:
        low, median, high: (T, 3) m: central intervals of probability 0.9 and medians of x, y and z, each by itself.
        likely: (M, T', 3) m, the most probable trajectories, the most probable one first.
    """

    low: FloatArray
    median: FloatArray
    high: FloatArray
    likely: FloatArray

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            _check_shape(f"{name} of a prediction", getattr(self, name), (len(self.median), 3))
        _check_shape("likely paths of a prediction", self.likely, (None, None, 3))


@dataclass(frozen=True)
class Inspection:
    """Everything that the recording of one task shows.

    Attributes:
        task: name of the task.
        replay: the poses of the arm over time.
        demonstration_ids: (n,) names of the demonstrations, in the order of the replay.
        demonstration_paths: (n, T, 3) m, paths of the end effector in the world frame.
        motions: the demonstrations along their waypoints.
        alternatives: at least one set, each with the alternatives to draw; 70 of a set are plenty.
        curves: at least one density along a feature; the first is shown first.
        map: the density over two features.
        space: points along three features; None if there are fewer features.
        theta_labels: (K,) the hypotheses in words.
        theta_meaning: what the numbers in the labels mean.
        posteriors: for each model, (n + 1, K) probabilities: row k is the posterior after the first k demonstrations.
        robustness: rows of `robustness_summary` to draw, or None if the study was not run.
        weights: the weights of the features, or None if nothing is concluded yet.
        nearest_truth: the hypothesis nearest to what simulated people truly want; None if that is not known.
        predicted: by model, what someone new would do; empty if nothing is predicted yet.
        summary: text in Markdown: the task, its numbers and where they came from.
    """

    task: str
    replay: Replay
    demonstration_ids: tuple[str, ...]
    demonstration_paths: FloatArray
    motions: Motions
    alternatives: tuple[AlternativeSet, ...]
    curves: tuple[DensityCurve, ...]
    map: DensityMap
    space: FeatureSpace | None
    theta_labels: tuple[str, ...]
    theta_meaning: str
    posteriors: Mapping[str, FloatArray]
    robustness: pl.DataFrame | None
    weights: Weights | None
    nearest_truth: int | None
    predicted: Mapping[str, Predicted]
    summary: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "posteriors", MappingProxyType(dict(self.posteriors)))
        object.__setattr__(self, "predicted", MappingProxyType(dict(self.predicted)))
        n, k = len(self.demonstration_ids), len(self.theta_labels)
        replay, bodies = self.replay, len(self.replay.geometry.body_names)
        samples = len(replay.time_s)
        if not self.curves or not self.posteriors or not self.alternatives or n == 0:
            raise ArgumentError(
                "an inspection needs at least one demonstration, one set of alternatives, one density curve and one "
                "model."
            )
        _check_shape("demonstration_paths", self.demonstration_paths, (n, None, 3))
        if len(self.motions.waypoints) != n:
            raise ArgumentError(f"motions must be of the {n} demonstrations; got {len(self.motions.waypoints)}.")
        _check_shape("replay.body_positions", replay.body_positions, (samples, bodies, 3))
        _check_shape("replay.body_quaternions", replay.body_quaternions, (samples, bodies, 4))
        for model, posterior in self.posteriors.items():
            _check_shape(f"posteriors[{model!r}]", posterior, (n + 1, k))
        if not (np.diff(replay.time_s) > 0).all():
            raise ArgumentError("replay.time_s must increase strictly; it does not.")
        if not np.array_equal(np.unique(replay.demonstration), np.arange(n)):
            raise ArgumentError(f"replay.demonstration must name each of the {n} demonstrations 0..{n - 1}.")

    @property
    def rows(self) -> HypothesisRows:
        """The hypotheses that have a row, by what is believed after all demonstrations."""
        return rows_that_matter({model: steps[-1] for model, steps in self.posteriors.items()}, self.nearest_truth)

    @property
    def end_s(self) -> FloatArray:
        """(n,) s, times at which each demonstration ends."""
        return np.array(
            [self.replay.time_s[self.replay.demonstration == i][-1] for i in range(len(self.demonstration_ids))]
        )

    @property
    def start_s(self) -> FloatArray:
        """(n,) s, times at which each demonstration begins."""
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
