"""`lessbench enough`: whether a task's answer is steady, and how much more of what would make it so."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

import polars as pl

from pipeline.answers.enough import (
    Alternatives,
    Demonstrations,
    Evaluations,
    alternatives,
    demonstrations,
    evaluations,
)
from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.terminal import say
from pipeline.vocabulary import REGIMES, model_name
from pipeline.workspace.project import Project


@dataclass(frozen=True)
class Enough:
    """What a task has and needs; lists are empty where there is nothing to tell from.

    Attributes:
        task: its name.
        reason: why its choice space is not explored; None if it is.
        tolerance: nats a pair.
        width_deg: of the posterior of all demonstrations together.
        evaluations, alternatives, demonstrations: what is needed of each.
    """

    task: str
    reason: str | None
    tolerance: float
    width_deg: float
    evaluations: list[Evaluations]
    alternatives: list[Alternatives]
    demonstrations: list[Demonstrations]


def enough(project: Project, name: str, tolerance: float | None, width_deg: float) -> Enough:
    """Read it from the tables of a task.

    Raises:
        StageError: the task's choice space has not been looked at.
        TableError: a table is not what it should be.
    """
    project.params.task(name)
    path = project.table(name, "choice_space")
    if not path.exists():
        raise StageError(f"{path}: there is no such file; make it with `lessbench explore {name}`")
    space = read_table(path, "choice_space")
    wanted = tolerance or project.params.explore.tolerance
    reason = None if space["explored"].all() else str(space["reason"][0])
    robust, study = (project.table(name, table) for table in ("robustness_summary", "robustness_sets"))
    sampled: list[Alternatives] = []
    if robust.exists() and study.exists():
        counted = read_table(study, "robustness_sets").group_by("regime").agg(pl.col("set_id").n_unique()).rows()
        sampled = alternatives(read_table(robust, "robustness_summary"), dict(counted), wanted)
    if reason is not None:
        return Enough(name, reason, wanted, width_deg, [], sampled, [])
    convergence, posteriors = (
        read_table(project.table(name, table), table) for table in ("convergence", "explored_posteriors")
    )
    return Enough(
        name, None, wanted, width_deg, evaluations(convergence, wanted), sampled, demonstrations(posteriors, width_deg)
    )


def as_json(found: Enough) -> dict[str, Any]:
    """The same for JSON."""
    return {key: _finite(value) for key, value in asdict(found).items()}


def _finite(value: Any) -> Any:
    """The same with None for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def report(found: Enough) -> None:
    """Say it."""
    say(f"{found.task}: answers agree if they differ by at most {found.tolerance:g} nats a pair")
    say("explored choice space" + (f": not explored, {found.reason}" if found.reason else ""))
    for one in found.evaluations:
        say(f"  {model_name(one.model)}: {_explored(one)}")
    say("sampled sets" + ("" if found.alternatives else ": not known, as there is no robustness study"))
    for two in found.alternatives:
        say(f"  {model_name(two.model)}, {REGIMES[two.regime]}: {_sampled(two)}")
    if found.demonstrations:
        say(f"demonstrations, for a posterior no wider than {found.width_deg:g} degrees")
    for three in found.demonstrations:
        say(f"  {model_name(three.model)}: {_shown(three)}")
    say("Each number is an extrapolation by a rule, see docs/choice_space.md. More demonstrations make the answer")
    say("sharper, and also make differences between explorations or sets count for more.")


def _explored(one: Evaluations) -> str:
    change = "unknown" if one.change is None else f"{one.change:.2g}"
    said = (
        f"explorations of {one.done:,} evaluations differ by up to {one.disagreement:.2g} and changed by {change} in "
        f"the last round"
    )
    if one.converged:
        return f"{said}; enough"
    if one.further is None:
        return f"{said} ({one.whose}); how many more would do cannot be foreseen"
    return f"{said} ({one.whose}); about {one.further:,} more each would do"


def _sampled(one: Alternatives) -> str:
    said = f"sets of {one.size:,} differ by {one.disagreement:.2g}"
    if one.needed is None:
        return f"{said}, which does not fall with their size; no number of alternatives is enough"
    if one.needed <= one.size:
        return f"{said}; enough"
    return f"{said}, falling as the power {one.slope:.2f} of their size; about {one.needed:,} would do"


def _shown(one: Demonstrations) -> str:
    said = f"{one.done} give {one.width_deg:.1f} degrees"
    if one.needed is None:
        return f"{said}; hypotheses lie {one.spacing_deg:.1f} apart, so it cannot be narrower: list more theta_values"
    return f"{said}; enough" if one.needed <= one.done else f"{said}; about {one.needed - one.done:,} more would do"
