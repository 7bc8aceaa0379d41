"""The kinds of features a task can name, and their evaluation over many trajectories in one replay.

A kind is a function from a Motion to one number per trajectory, with a unit; its keyword arguments are what params.yaml
gives beside `kind`, annotated as str, float, int or bool. Registering one is all it takes:

    @feature("clearance", unit="m")
    def clearance(motion: Motion, *, over: str) -> FloatArray:
        return (motion.end_effector - motion.position(over))[..., 2].min(axis=1)
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, get_type_hints

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError, ParameterError, SceneError, StageError, one_of
from pipeline.replay.replay import Motion, replay
from pipeline.replay.scene import Scene
from pipeline.trajectories import measures
from pipeline.vocabulary import COST, DIRECTIONS, OVER_TIME, SUM

Evaluate = Callable[..., FloatArray]
Unit = str | Callable[[Scene], str]


@dataclass(frozen=True)
class Kind:
    """A registered kind of feature.

    Attributes:
        name: what params.yaml calls it.
        unit: of its numbers, which may depend on the scene's joints.
        evaluate: its function.
        direction: one of `DIRECTIONS`: whether people are taken to want little of it, much, or either.
        over_time: one of `OVER_TIME`: how one number comes of a whole trajectory.
    """

    name: str
    unit: Unit
    evaluate: Evaluate
    direction: str = COST
    over_time: str = SUM


KINDS: dict[str, Kind] = {}


def feature(name: str, *, unit: Unit, direction: str = COST, over_time: str = SUM) -> Callable[[Evaluate], Evaluate]:
    """Register a kind of feature.

    Args:
        name: what params.yaml calls it under `kind`.
        unit: of the numbers returned; a function of the scene where it depends on the joints.
        direction: `cost` if people are taken to want little of it, `wish` if much, `either` if that is to be found out.
        over_time: how one number comes of a trajectory: `sum`, `mean`, `least` or `greatest` of its waypoints.

    Raises:
        ArgumentError: the name is taken, or a word is none of these.
    """
    for argument, word, allowed in (("direction", direction, DIRECTIONS), ("over_time", over_time, OVER_TIME)):
        if word not in allowed:
            raise ArgumentError(f"feature kind {name!r}: {argument} is {word!r}; allowed are {one_of(allowed)}.")

    def register(function: Evaluate) -> Evaluate:
        if name in KINDS:
            raise ArgumentError(f"feature kind {name!r} is registered already; taken are {one_of(KINDS)}.")
        KINDS[name] = Kind(name, unit, function, direction, over_time)
        return function

    return register


def _squared_joint_unit(scene: Scene) -> str:
    units = {"m^2" if slides else "rad^2" for slides in scene.slides}
    return " + ".join(sorted(units))


@feature("efficiency", unit=_squared_joint_unit)
def efficiency(motion: Motion) -> FloatArray:
    """Squared joint steps, summed: small for short and even paths."""
    return measures.squared_steps(motion.waypoints)


@feature("height", unit="m")
def height(motion: Motion, *, above: str = "world") -> FloatArray:
    """Height of the end effector over the origin of a body or site, summed over waypoints."""
    return measures.summed_height(motion.end_effector[..., 2] - motion.position(above)[..., 2])


@feature("proximity", unit="m")
def proximity(motion: Motion, *, object: str, radius_m: float = 0.4) -> FloatArray:
    """How far the end effector is inside a vertical cylinder around a body or site, summed over waypoints."""
    return measures.summed_closeness(motion.end_effector, motion.position(object), radius_m)


@feature("path_length", unit="m")
def path_length(motion: Motion) -> FloatArray:
    """Distance the end effector travels."""
    return measures.path_lengths(motion.end_effector)


@feature("tilt", unit="rad")
def tilt(motion: Motion, *, body: str) -> FloatArray:
    """Angle between a body's z axis and the vertical, summed over waypoints: 0 for a mug that stays upright."""
    return measures.summed_tilt(motion.rotation(body)[..., 2])


@dataclass(frozen=True, eq=False)
class FeatureSet:
    """The features of a task, bound to its scene.

    Attributes:
        scene: what they are evaluated in.
        names: F names, the columns of a feature table.
        units: F units, such as "m".
        directions: F words of `DIRECTIONS`.
        over_time: F words of `OVER_TIME`.
    """

    scene: Scene
    names: tuple[str, ...]
    units: tuple[str, ...]
    directions: tuple[str, ...]
    over_time: tuple[str, ...]
    _functions: tuple[Callable[[Motion], FloatArray], ...]

    def evaluate(self, waypoints: FloatArray) -> FloatArray:
        """All features of all trajectories, in one replay.

        Args:
            waypoints: (N, T, J) rad or m, the joints in the order of `scene.joints`, continuous joints unwrapped.

        Returns:
            (N, F) in `units`.

        Raises:
            ArgumentError: see `pipeline.replay.replay`.
            StageError: a feature is not one finite number per trajectory.
        """
        motions = replay(self.scene, waypoints)
        values = np.empty((len(waypoints), len(self.names)))
        for motion in motions:
            values[motion.first : motion.first + len(motion.waypoints)] = self.of(motion)
        return values

    def of(self, motion: Motion) -> FloatArray:
        """All features of the n trajectories of one replay, (n, F); errors as in `evaluate`."""
        values = np.empty((len(motion.waypoints), len(self.names)))
        for column, (name, function) in enumerate(zip(self.names, self._functions, strict=True)):
            values[:, column] = self._checked(name, function(motion), motion)
        return values

    def _checked(self, name: str, result: FloatArray, motion: Motion) -> FloatArray:
        result = np.asarray(result)
        if result.shape != (len(motion.waypoints),):
            raise StageError(
                f"feature {name!r} returned shape {result.shape}; it must return one number for each of the "
                f"{len(motion.waypoints)} trajectories."
            )
        wrong = np.flatnonzero(~np.isfinite(result))
        if wrong.size:
            raise StageError(
                f"feature {name!r} is {result[wrong[0]]} for trajectory {motion.first + wrong[0]}; "
                f"every feature must be finite."
            )
        return result


def bind_features(scene: Scene, specs: Mapping[str, Mapping[str, object]], section: str = "features") -> FeatureSet:
    """Check the features that a task names against their kinds and the scene, once.

    Args:
        scene: from `load_scene`.
        specs: name -> {"kind": one of KINDS, and the kind's keyword arguments}; at least one.
        section: what messages call the mapping, `preferences` if paths are planned for them.

    Raises:
        ParameterError: no feature, an unknown kind, an argument that is unknown, missing, of another type or out of
            range; the message gives its path and what is allowed.
        SceneError: an argument names a body or site that the scene lacks.
    """
    if not specs:
        raise ParameterError(f"{section} is empty; name at least one.")
    bound = [_bind(f"{section}.{name}", specs[name]) for name in specs]
    units = [kind.unit if isinstance(kind.unit, str) else kind.unit(scene) for kind, _ in bound]
    features = FeatureSet(
        scene, tuple(specs), tuple(units), tuple(kind.direction for kind, _ in bound),
        tuple(kind.over_time for kind, _ in bound), tuple(function for _, function in bound),
    )  # fmt: skip
    _try_out(features, section)
    return features


def _bind(path: str, spec: Mapping[str, object]) -> tuple[Kind, Callable[[Motion], FloatArray]]:
    arguments = dict(spec)
    kind = KINDS.get(str(arguments.pop("kind", None)))
    if kind is None:
        raise ParameterError(f"{path}.kind is {spec.get('kind')!r}; allowed are {one_of(KINDS)}.")
    allowed = {
        parameter.name: parameter
        for parameter in inspect.signature(kind.evaluate).parameters.values()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }
    for argument in arguments:
        if argument not in allowed:
            raise ParameterError(
                f"{path}.{argument} is unknown to {kind.name}; allowed are {one_of(allowed) or '(none)'}."
            )
    types = get_type_hints(kind.evaluate)
    for argument, parameter in allowed.items():
        if argument in arguments:
            arguments[argument] = _typed(f"{path}.{argument}", arguments[argument], types.get(argument, Any))
        elif parameter.default is inspect.Parameter.empty:
            raise ParameterError(f"{path}.{argument} is missing; {kind.name} needs it.")
    return kind, partial(kind.evaluate, **arguments)


def _typed(path: str, value: object, wanted: Any) -> object:
    """The value, an int widened to float where a float is wanted; bool is not a number here."""
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if wanted is not Any and type(value) is not wanted:
        raise ParameterError(f"{path} is {value!r}; it must be of type {wanted.__name__}.")
    return value


def _try_out(features: FeatureSet, section: str) -> None:
    """Evaluate each feature at rest: unknown names and values out of range show before any work is done."""
    rest = np.tile(features.scene.home[features.scene.qpos_addresses], (1, 2, 1))
    (motion,) = replay(features.scene, rest)
    for name, function in zip(features.names, features._functions, strict=True):
        try:
            features._checked(name, function(motion), motion)
        except ArgumentError as error:
            raise ParameterError(f"{section}.{name}: {error}") from error
        except SceneError as error:
            raise SceneError(f"{section}.{name}: {error}") from error
