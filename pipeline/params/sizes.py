"""How much parameters ask for, predicted before anything is allocated."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod

from pipeline.errors import ParameterError
from pipeline.params.sections import Params

_JOINTS = 8  # assumed of an arm, whose scene is not known yet
_NUMBER = 8  # bytes
MOST = {
    "weight vectors": 2_000_000,  # as a grid is made, before directions are joined
    "rows of posteriors for each demonstration": 200_000_000,
    "numbers in one part": 4_000_000_000,
    "numbers of trajectories": 100_000_000_000,
    "near-copies in one set": 1_000_000,
    "grid worlds": 10_000_000,
}


def check_sizes(params: Params, source: str) -> None:
    """Refuse parameters that ask for more than any machine this is made for can hold.

    Raises:
        ParameterError: they do; the message says what they ask for, the memory that would take, and what to change.
    """
    for what, count, each, remedy in _asked(params):
        if count > MOST[what]:
            raise ParameterError(
                f"{source}: these parameters ask for {_counted(count)} {what}, which would take "
                f"{_memory(count * each)}; at most {_counted(MOST[what])} are possible; {remedy}"
            )


def _asked(params: Params) -> Iterator[tuple[str, int, int, str]]:
    """What, how many, bytes of each, and what to change."""
    sample, infer, waypoints = params.sample, params.infer, params.ingest.waypoints
    sets = sample.sets * len(sample.sizes) + 1
    for name, task in params.tasks.items():
        features = len(task.features)
        if isinstance(task.thetas, tuple):
            thetas = len(task.thetas)
        else:
            own = {} if task.thetas == "grid" else task.thetas
            thetas = prod(len(own.get(feature, infer.theta_values)) for feature in task.features)
        fewer = f"list fewer infer.theta_values or features of tasks.{name}, or give tasks.{name}.thetas"
        yield "weight vectors", thetas, features * _NUMBER, fewer
        rows = thetas * len(infer.betas) * len(infer.models) * sets
        fewer = f"list fewer infer.betas or infer.theta_values, lower sample.sets, or give tasks.{name}.thetas"
        yield "rows of posteriors for each demonstration", rows, (features + 3) * _NUMBER, fewer
    largest = max((sample.working_set, *sample.sizes))
    part = min(params.compute.partition, largest) * waypoints * _JOINTS
    yield "numbers in one part", part, _NUMBER, "lower compute.partition or ingest.waypoints"
    drawn = (sample.sets * sum(sample.sizes) + sample.working_set) * waypoints * _JOINTS
    yield "numbers of trajectories", drawn, _NUMBER, "lower sample.sets, sample.sizes, sample.working_set or waypoints"
    copied = params.robustness.duplicates
    yield (
        "near-copies in one set", copied.copied * max(copied.copies), waypoints * _NUMBER,
        "lower robustness.duplicates.copied or copies",
    )  # fmt: skip
    world = params.studies.grid_world
    yield (
        "grid worlds", world.seeds * world.demonstrations, 1000 * _NUMBER,
        "lower studies.grid_world.seeds or demonstrations",
    )  # fmt: skip


def _counted(count: int) -> str:
    return f"{count:,}" if count < 10**15 else f"10^{len(str(count)) - 1}"


def _memory(size: int) -> str:
    return f"{_counted(size // 10**9)} GB" if size >= 10**10 else f"{size / 1e9:.1f} GB"
