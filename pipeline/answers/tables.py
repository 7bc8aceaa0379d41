"""Rows of the tables that hold an answer, and the lines in which it is said everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl

from pipeline.answers.verdict import Trust, Verdict
from pipeline.answers.words import SURE, Preference, sentence
from pipeline.arrays import FloatArray
from pipeline.choice.weights import GroupDraws, WeightDraws, weighted_quantiles
from pipeline.vocabulary import ALL

GROUP, NEXT, PERSON, ALONE, TOGETHER = "group", "next", "person", "alone", "together"
MOST_LINES = 10
_LEVELS = (0.05, 0.5, 0.95)
_SUMMARY = ("quantity", "feature", "mean", "low", "median", "high", "positive")


def answer_rows(task: str, found: Sequence[Preference], verdict: Verdict, over: str | None = None) -> pl.DataFrame:
    """Rows of the table `answers`.

    Args:
        task: its name.
        found: the preferences.
        verdict: whether to trust them.
        over: what they rest on, if that is not the explored choice space.
    """
    said = sentence(found) + (f" ({over})" if over else "")
    rows: list[tuple[object, ...]] = [("answer", "answer", said, None, None, None, None, None, verdict.trust.value)]
    for one in found:
        outcome = "yes" if one.stated else "no"
        trust = Trust.TRUST.value
        rows.append(("preference", one.feature, str(one), outcome, one.probability, SURE, None, None, trust))
    for line in verdict.lines:
        rule = line.rule
        bounds = (_bound(rule.least), _bound(rule.most), rule.gravest)
        rows.append(("check", line.name, str(line), line.outcome.value, line.number, *bounds, line.trust.value))
    schema = {
        "kind": pl.String, "line": pl.String, "statement": pl.String, "outcome": pl.String, "number": pl.Float64,
        "least": pl.Float64, "most": pl.Float64, "gravest": pl.Float64, "trust": pl.String,
    }  # fmt: skip
    return pl.DataFrame(rows, schema=schema, orient="row").with_columns(
        task=pl.lit(task), place=pl.int_range(pl.len(), dtype=pl.Int64)
    )


def _bound(value: float) -> float | None:
    return value if math.isfinite(value) else None


def answer_lines(rows: pl.DataFrame, most: int = MOST_LINES) -> list[str]:
    """What is said of a task wherever its answer is told: what they wanted, how sure, whether to trust it and why not.

    Args:
        rows: of the table `answers`, of one task.
        most: lines; what does not fit is counted.
    """
    rows = rows.sort("place")
    (head,) = rows.filter(kind="answer").iter_rows(named=True)
    lines = [f"{head['task']}: {head['statement']}"]
    lines += [f"  {text}" for text in rows.filter(kind="preference")["statement"]][: most - 3]
    checks = rows.filter(kind="check")
    reasons = [
        f"  {text}"
        for trust in (Trust.NOT, Trust.CAREFUL)
        for text in checks.filter(trust=trust.value)["statement"].to_list()
    ]
    lines.append(head["trust"])
    left = most - len(lines)
    if len(reasons) > left:
        reasons = [*reasons[: left - 1], f"  and {len(reasons) - left + 1} more"]
    return lines + reasons


def answer_markdown(rows: pl.DataFrame) -> list[str]:
    """The lines of `answer_lines` for a panel of text."""
    lines = answer_lines(rows)
    return [f"- {line.strip()}" if line.startswith("  ") else f"\n**{line}**\n" for line in lines]


def draw_rows(model: str, names: Sequence[str], group: GroupDraws, following: WeightDraws) -> pl.DataFrame:
    """Rows of the table `weights` but for the task.

    Args:
        model: label.
        names: (P,) of the people, in the order of the draws.
        group: joint draws.
        following: those of someone new, which belong to them.
    """
    parts = [(GROUP, ALL, group.group), (NEXT, ALL, following)]
    parts += [(PERSON, name, group.person(index)) for index, name in enumerate(names)]
    return pl.concat(
        pl.DataFrame({"omega": draws.omega, "log_weight": draws.log_weight, "spread": group.spread}).with_columns(
            model=pl.lit(model), kind=pl.lit(kind), participant=pl.lit(who), draw=pl.int_range(pl.len(), dtype=pl.Int64)
        )
        for kind, who, draws in parts
    )


def summary_rows(
    model: str, features: Sequence[str], parts: Sequence[tuple[str, str, WeightDraws]], group: GroupDraws
) -> pl.DataFrame:
    """Rows of the table `weights_summary` but for the task; `parts` are kind, participant and draws."""
    tables = []
    for kind, who, draws in parts:
        rows = _quantities(features, draws)
        if kind == GROUP:
            rows.append(("spread", ALL, *_spread(group.spread, draws.weight), None))
        schema: Mapping[str, object] = {
            name: pl.String if name in ("quantity", "feature") else pl.Float64 for name in _SUMMARY
        }
        table = pl.DataFrame(rows, schema=schema, orient="row")  # type: ignore[arg-type]
        tables.append(table.with_columns(model=pl.lit(model), kind=pl.lit(kind), participant=pl.lit(who)))
    return pl.concat(tables)


def _quantities(features: Sequence[str], draws: WeightDraws) -> list[tuple[object, ...]]:
    positive, mean_direction = draws.positive, draws.direction
    rows: list[tuple[object, ...]] = []
    for column, feature in enumerate(features):
        rows.append(("weight", feature, *_spread(draws.omega[:, column], draws.weight), float(positive[column])))
        rows.append(("direction", feature, *_spread(draws.directions[:, column], draws.weight), None))
    rows.append(("beta", ALL, *_spread(draws.beta, draws.weight), None))
    angles = np.degrees(draws.angles(mean_direction))
    mean = float(draws.weight @ angles)
    median, cap = (float(np.degrees(draws.cap(level))) for level in (0.5, 0.9))
    rows.append(("angle", ALL, mean, 0.0, median, cap, None))
    return rows


def _spread(values: FloatArray, weight: FloatArray) -> tuple[float, float, float, float]:
    """Mean, and the ends and the middle of the central interval of probability 0.9."""
    low, median, high = (float(value) for value in weighted_quantiles(values[:, None], weight, _LEVELS)[:, 0])
    return float(weight @ values), low, median, high


def group_of(rows: pl.DataFrame, kind: str = GROUP, participant: str = ALL) -> WeightDraws:
    """Draws of someone's weights from rows of the table `weights` of one model."""
    mine = rows.filter(kind=kind, participant=participant).sort("draw")
    log_weight = mine["log_weight"].to_numpy()
    return WeightDraws(mine["omega"].to_numpy(), log_weight, math.nan, math.nan)
