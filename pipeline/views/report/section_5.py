"""The page on section 5 of the paper: its statistics beside those found here, and what the answers depend on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.studies.robustness.redraws import INFERRED
from pipeline.studies.robustness.tests import LOG, RAW
from pipeline.views.report.html import Part, Picture, Points, Report, Section, Table, Text
from pipeline.vocabulary import BATCH, EXPLORED, INDEPENDENT, LESS, SINGLE, model_name

PAPER: Mapping[str, tuple[str, str, str]] = {
    "laptop": (
        "model x size F(4, 44) = 40.37, p < .001",
        "LESS lower at 10, 30 and 100 (p < .001 each), level at 300 and 1,000 (p about 1)",
        "LESS higher",
    ),
    "table": ("main effect of the model, significant", "not printed", "LESS higher"),
    "human": ("model x size F(4, 44) = 2.85, p < .05", "a difference at 1,000 alone (p < .001)", "LESS higher"),
}
"""What section 5 prints, by what a task's name begins with: the analysis of variance, Tukey's test, all together."""
PROBABLE = 0.05
POINTS = {
    "task": pl.String, "sampler": pl.String, "percentile": pl.Float64, "ratio": pl.Float64, "ratio_low": pl.Float64,
    "ratio_high": pl.Float64, "lead": pl.Float64, "lead_low": pl.Float64, "lead_high": pl.Float64,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class TaskResults:
    """The tables of one task that the page shows.

    Attributes:
        real: whether people, and not simulated participants, demonstrated it.
        anova, post_hoc: of the default ten sets (robustness_anova, robustness_post_hoc); empty if they are not there.
        leads, held_out_leads, positions, draws_anova: of the redrawn sets.
        default_sampler: of the redrawn ones, that of the paper's regime.
        effort: name of the feature that is the effort; None if there is none.
    """

    real: bool
    anova: pl.DataFrame
    post_hoc: pl.DataFrame
    leads: pl.DataFrame
    held_out_leads: pl.DataFrame
    positions: pl.DataFrame
    draws_anova: pl.DataFrame
    default_sampler: str
    effort: str | None


def standing(results: Mapping[str, TaskResults]) -> pl.DataFrame:
    """Where people stand in each sampler's pool, beside both leads of LESS: the points of `standing_figure`."""
    rows = []
    for task, one in results.items():
        effort = one.positions.filter(pl.col("feature") == one.effort)
        least, largest = one.leads["set_size"].min(), one.leads["set_size"].max()
        for (sampler,), people in effort.group_by("sampler", maintain_order=True):
            ratio = one.leads.filter(sampler=sampler, model=LESS, set_size=least, demonstrations=SINGLE)
            lead = one.held_out_leads.filter(sampler=sampler, model=LESS, set_size=largest, beta=INFERRED)
            rows.append(
                {
                    "task": task, "sampler": str(sampler), "percentile": people["percentile"].median(),
                    "ratio": _value(ratio, "ratio"), "ratio_low": _value(ratio, "low"),
                    "ratio_high": _value(ratio, "high"), "lead": _value(lead, "lead"), "lead_low": _value(lead, "low"),
                    "lead_high": _value(lead, "high"),
                }
            )  # fmt: skip
    return pl.DataFrame(rows, schema=POINTS)


def section_5(results: Mapping[str, TaskResults], pictures: Mapping[str, bytes], made_by: str) -> Report:
    """The page.

    Args:
        results: by task.
        pictures: SVG by the name of the figure: `standing`, and `<task>_ratios` and so on for each task.
        made_by: versions and seed.
    """
    sections = [
        Section("In short", [Points(_in_short(results))]),
        Section("The paper's statistics, and these", [*_beside_the_paper(results)]),
    ]
    if "standing" in pictures:
        sections.append(
            Section(
                "What the answers depend on",
                [
                    Text(
                        "Each point is one task and one sampler. If leads follow from where people stand among the "
                        "alternatives, they say as much about the sampler as about people."
                    ),
                    Picture(
                        pictures["standing"],
                        "Left: how many times KLAggregate of LESS is Boltzmann's, with the smallest sets; below 1 LESS "
                        "is more robust. Right: how much better LESS predicts a person from the others, with the "
                        "largest sets. Bars are 95 % intervals over draws and people.",
                    ),
                    _positions(results),
                ],
            )
        )
    for task, one in results.items():
        sections.append(Section(_title(task, one), _of_task(task, one, pictures), opens=True))
    sections.append(Section("How it was made", [Points(_method(results))]))
    return Report("Section 5 of the paper, task by task", made_by, sections)


def _title(task: str, one: TaskResults) -> str:
    return f"{task}: {'people' if one.real else 'simulated participants'}"


def _in_short(results: Mapping[str, TaskResults]) -> list[str]:
    said = []
    for task, one in results.items():
        single = one.leads.filter(model=LESS, demonstrations=SINGLE, sampler=one.default_sampler).sort("set_size")
        lower = [f"{row['set_size']:,}" for row in single.iter_rows(named=True) if row["high"] < 1]
        higher = [f"{row['set_size']:,}" for row in single.iter_rows(named=True) if row["low"] > 1]
        ratio = _sentence(lower, higher, "is more robust", "is less robust", "sets of")
        ahead = one.held_out_leads.filter(model=LESS, beta=INFERRED).filter(pl.col("sampler") != EXPLORED)
        largest = ahead.filter(pl.col("set_size") == pl.col("set_size").max()) if ahead.height else ahead
        better = [row["sampler"].replace("_", " ") for row in largest.iter_rows(named=True) if row["low"] > 0]
        worse = [row["sampler"].replace("_", " ") for row in largest.iter_rows(named=True) if row["high"] < 0]
        prediction = _sentence(better, worse, "predicts better", "predicts worse", "alternatives from")
        said.append(
            f"{_title(task, one)}. Single demonstrations, sets from {one.default_sampler.replace('_', ' ')}, over all "
            f"draws and people: LESS {ratio}. Held out, by sampler: LESS {prediction}."
        )
    return said


def _sentence(better: Sequence[str], worse: Sequence[str], good: str, bad: str, place: str) -> str:
    parts = [f"{word} with {place} {', '.join(where)}" for word, where in ((good, better), (bad, worse)) if where]
    return " and ".join(parts) if parts else "cannot be told from Boltzmann"


def _beside_the_paper(results: Mapping[str, TaskResults]) -> list[Part]:
    rows = []
    for task, one in results.items():
        paper = next((words for start, words in PAPER.items() if task.startswith(start)), ("", "", ""))
        draws = one.draws_anova.filter(sampler=one.default_sampler, measure=RAW) if one.draws_anova.width else None
        effects = [
            _effect(one.anova.filter(regime=INDEPENDENT, measure=RAW, effect=effect), draws, effect, words)
            for effect, words in (("model", "model"), ("model:set_size", "model x size"))
            if one.anova.width
        ]
        rows += [
            [task, "analysis of variance", paper[0], "; ".join(filter(None, effects))],
            ["", "Tukey's test by size", paper[1], _tukey(one)],
            ["", "all together", paper[2], _batch(one)],
        ]
    return [
        Text(
            "The paper does one draw of ten sets. Here the statistics of the default draw stand first, then over the "
            "redrawn sets: a single F or p describes the draw that it comes from."
        ),
        Table(
            "KLAggregate over ten sets of one sampler. F over the draws: median, and 5 to 95 % of the draws.",
            ["task", "", "the paper", "here"],
            rows,
        ),
    ]


def _effect(default: pl.DataFrame, draws: pl.DataFrame | None, effect: str, words: str) -> str:
    if default.is_empty():
        return ""
    row = default.row(0, named=True)
    said = f"{words} F({row['df_effect']}, {row['df_error']}) = {row['f']:.3g}, {_p(row['p_value'])}"
    if draws is None or draws.is_empty():
        return said
    mine = draws.filter(effect=effect)
    low, middle, high = (float(value) for value in np.quantile(mine["f"].to_numpy(), (0.05, 0.5, 0.95)))
    share = float((mine["p_value"].to_numpy() < PROBABLE).mean())
    return f"{said} (draws: {middle:.3g}, {low:.3g} to {high:.3g}; p < .05 in {share:.0%})"


def _tukey(one: TaskResults) -> str:
    if not one.post_hoc.width:
        return ""
    parts = []
    pairs = one.post_hoc.filter(regime=INDEPENDENT, measure=RAW)
    for row in pairs.sort("set_size").iter_rows(named=True):
        lead = one.leads.filter(
            model=LESS, sampler=one.default_sampler, set_size=row["set_size"], demonstrations=SINGLE
        )
        less, other = (
            (row["mean_a"], row["mean_b"]) if row["model_a"] == LESS else (row["mean_b"], row["mean_a"])
        )  # fmt: skip
        shared = _value(lead, "share_tukey")
        over = "" if shared is None else f", p < .05 in {shared:.0%} of the draws"
        parts.append(f"{row['set_size']:,}: {less:.2g} against {other:.2g}, {_p(row['p_value'])}{over}")
    return "; ".join(parts)


def _batch(one: TaskResults) -> str:
    rows = one.leads.filter(model=LESS, sampler=one.default_sampler, demonstrations=BATCH).sort("set_size")
    return "; ".join(f"{row['set_size']:,}: {_interval(row, 'ratio')} times" for row in rows.iter_rows(named=True))


def _positions(results: Mapping[str, TaskResults]) -> Table:
    rows = []
    for task, one in results.items():
        table = one.positions.group_by("sampler", "feature", maintain_order=True).agg(
            pl.col("percentile").min().alias("least"),
            pl.col("percentile").median().alias("median"),
            pl.col("percentile").max().alias("most"),
        )
        for (feature,), part in table.group_by("feature", maintain_order=True):
            for row in part.iter_rows(named=True):
                rows.append(
                    [task, feature, row["sampler"].replace("_", " "),
                     f"{100 * row['median']:.0f} ({100 * row['least']:.0f} to {100 * row['most']:.0f})"]
                )  # fmt: skip
    return Table(
        "Where people stand in the pool of each sampler, as a percentile of the alternatives: median over people, and "
        "the least and greatest. 100 is beyond all alternatives.",
        ["task", "feature", "sampler", "percentile"],
        rows,
    )


def _of_task(task: str, one: TaskResults, pictures: Mapping[str, bytes]) -> list[Part]:
    parts: list[Part] = [
        Picture(
            pictures[f"{task}_ratios"],
            "Single demonstrations: KLAggregate of each model as a multiple of Boltzmann's, by sampler. Below 1 the "
            "model is more robust than Boltzmann. Bars are 95 % intervals over draws and people.",
        ),
        Picture(
            pictures[f"{task}_batch"],
            "All demonstrations together, likewise. Bars are 95 % intervals over draws.",
        ),
    ]
    if f"{task}_held_out" in pictures:
        parts.append(
            Picture(
                pictures[f"{task}_held_out"],
                "How much better than Boltzmann each model predicts a person from the others. Above 0 it predicts "
                "better.",
            )
        )
    parts.append(_ratios(one))
    explored = one.held_out_leads.filter(sampler=EXPLORED, beta=INFERRED)
    for row in explored.iter_rows(named=True):
        parts.append(
            Text(
                f"Over the explored choice space, where no sampler is left, {model_name(row['model'])} leads by "
                f"{_interval(row, 'lead')} nat a person, ahead for {row['people_ahead']} of {row['participants']}."
            )
        )
    return parts


def _ratios(one: TaskResults) -> Table:
    sizes = sorted(one.leads["set_size"].unique())
    rows = []
    single = one.leads.filter(demonstrations=SINGLE)
    for sampler, model in single.select("sampler", "model").unique(maintain_order=True).iter_rows():
        part = single.filter(sampler=sampler, model=model)
        by_size = {row["set_size"]: _interval(row, "ratio") for row in part.iter_rows(named=True)}
        rows.append([sampler.replace("_", " "), model_name(model), *(by_size.get(size, "") for size in sizes)])
    return Table(
        "The same numbers: ratio of KLAggregates with its 95 % interval, single demonstrations, by set size.",
        ["sampler", "model", *(f"{size:,}" for size in sizes)],
        rows,
    )


def _method(results: Mapping[str, TaskResults]) -> list[str]:
    first = next(iter(results.values())).leads.row(0, named=True)
    return [
        f"The sets of each sampler were drawn {first['draws']} times, and paths planned anew in each draw. Ratios are "
        "geometric means; intervals take draws and people as crossed random effects.",
        "The paper's tests are done for each draw as in the paper: repeated measures, model x size, and Tukey's test. "
        "Tukey's error is pooled over all sizes and hides differences that a paired test sees, so a large p there is "
        "not read as no difference; the column p_paired of redraws_leads has the paired test.",
        "LESS with the density of a larger pool takes as many more alternatives of the same draw as the largest sets "
        "have. Nested logit has nests no wider than two bandwidths and a dissimilarity of 0.5. Both settings, and all "
        "samplers, were fixed before the first run.",
        "Every number can be asked for: the tables redraws, redraws_leads, redraws_anova, redraws_post_hoc, "
        "redraws_held_out, redraws_held_out_leads and redraws_positions are in the catalog.",
        f"Tests of {LOG} are in the tables too.",
    ]


def _value(rows: pl.DataFrame, column: str) -> float | None:
    return None if rows.is_empty() else rows[column][0]


def _interval(row: Mapping[str, float], value: str) -> str:
    return f"{row[value]:.2f} ({row['low']:.2f} to {row['high']:.2f})"


def _p(p: float) -> str:
    return "p < .001" if p < 0.001 else f"p = {p:.2g}"
