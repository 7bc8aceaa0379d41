"""The features that a task names, bound to its scene and evaluated over many trajectories in one replay."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, get_type_hints

import numpy as np

import pipeline.replay.kinds.of_motion
import pipeline.replay.kinds.summed  # noqa: F401  # they register what they define
from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError, ParameterError, SceneError, StageError, WorkbenchError, one_of
from pipeline.plug_ins import FEATURES, installed_names
from pipeline.replay.kinds.own import installed_kind
from pipeline.replay.kinds.register import KINDS, Kind, feature
from pipeline.replay.replay import Motion, replay
from pipeline.replay.scene import Scene

_TRIED = 4  # waypoints of the trajectory at rest: no kind needs more
__all__ = ["KINDS", "FeatureSet", "bind_features", "feature"]


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

    def only(self, column: int) -> FeatureSet:
        """One of the features alone."""
        mine = slice(column, column + 1)
        return replace(
            self, names=self.names[mine], units=self.units[mine], directions=self.directions[mine],
            over_time=self.over_time[mine], _functions=self._functions[mine],
        )  # fmt: skip

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
            values[:, column] = self._checked(name, self._computed(name, function, motion), motion)
        return values

    def _computed(self, name: str, function: Callable[[Motion], FloatArray], motion: Motion) -> FloatArray:
        try:
            return function(motion)
        except WorkbenchError:
            raise
        except Exception as error:  # of a kind that somebody else wrote
            raise StageError(
                f"feature {name!r} cannot be computed, as its kind fails with {type(error).__name__}: {error}; mend "
                "that kind."
            ) from error

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
    name = str(arguments.pop("kind", None))
    kind = KINDS.get(name) or installed_kind(name)
    if kind is None:
        allowed_kinds = one_of({*KINDS, *installed_names(FEATURES)})
        raise ParameterError(f"{path}.kind is {spec.get('kind')!r}; allowed are {allowed_kinds}.")
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
    rest = np.tile(features.scene.home[features.scene.qpos_addresses], (1, _TRIED, 1))
    (motion,) = replay(features.scene, rest)
    for name, function in zip(features.names, features._functions, strict=True):
        try:
            features._checked(name, features._computed(name, function, motion), motion)
        except ArgumentError as error:
            raise ParameterError(f"{section}.{name}: {error}") from error
        except SceneError as error:
            raise SceneError(f"{section}.{name}: {error}") from error
