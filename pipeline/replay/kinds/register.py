"""The register of the kinds of features that a task can name.

A kind is a function from a Motion to one number per trajectory. It says its unit, what people are taken to want of it,
and how its number comes of a trajectory. Its keyword arguments are what params.yaml gives beside `kind`, annotated as
str, float, int or bool. Registering one is all it takes:

    @feature("reach", unit="m", direction="either", over_time="greatest")
    def reach(motion: Motion, *, of: str) -> FloatArray:
        return motion.position(of)[..., 0].max(axis=1)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError, one_of
from pipeline.replay.scene import Scene
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
