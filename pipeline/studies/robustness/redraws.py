"""Sets as a random factor: how far a lead is that of the ten sets, and of the people, that happened to be drawn.

KLAggregate compares the posteriors from the sets of one draw. Here the sets of every sampler are drawn again and again,
so that there is a KLAggregate for every draw and person. The lead of a model over Boltzmann, the logarithm of the ratio
of their KLAggregates, then has an interval over draws *and* people, next to the paper's tests, which are done for each
draw. The same draws say how well each model predicts a person from the others, and where people stand among the
alternatives, on which both depend.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice import log_likelihood, select_bandwidth
from pipeline.choice.explored import PooledLESS, log_states, region_log_likelihood
from pipeline.choice.held_out import held_out_from
from pipeline.choice.nested_logit import nested_log_likelihood, nests_of
from pipeline.studies.robustness.divergence import measures
from pipeline.studies.robustness.problem import (
    ChoiceSets,
    Demonstrations,
    Problem,
    Score,
    boltzmann_score,
    less_score,
    log_likelihoods,
    log_posteriors,
    select_bandwidths,
    theta_marginals,
)
from pipeline.studies.robustness.tests import RAW, analyse_regime
from pipeline.studies.statistics import crossed_lead
from pipeline.vocabulary import ALL, BATCH, BOLTZMANN, EXPLORED, LESS, LESS_POOLED, NESTED_LOGIT, SINGLE

NEST_BANDWIDTHS = 2.0  # two alternatives of a nest are at most so many bandwidths of LESS apart
DISSIMILARITY = 0.5  # of every nest, halfway between Boltzmann and nests that count once
NO_LESS = 1e-12  # nats; KLAggregates below it are rounding
BY = ("sampler", "model", "set_size")
INFERRED = "inferred"  # in the column `beta`, next to the numbers to which it is fixed
HELD_OUT_LEADS = {
    "sampler": pl.String, "model": pl.String, "set_size": pl.Int64, "beta": pl.String, "draws": pl.Int64,
    "participants": pl.Int64, "lead": pl.Float64, "low": pl.Float64, "high": pl.Float64, "sd_people": pl.Float64,
    "sd_draws": pl.Float64, "p_paired": pl.Float64, "share_ahead": pl.Float64, "people_ahead": pl.Int64,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Redraw:
    """One draw of the sets of one sampler.

    Attributes:
        sampler: its name.
        draw: number of the draw.
        sets: of every size.
        pool: by anchor (P, F) scaled features of further alternatives of this draw: a density for small sets, and what
            people are ranked in.
    """

    sampler: str
    draw: int
    sets: tuple[ChoiceSets, ...]
    pool: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Measured:
    """What comes of a draw, or of all draws together.

    Attributes:
        divergences: `sampler`, `draw`, `model`, `set_size` and the columns of `measures`.
        scores: `sampler`, `draw`, `model`, `set_size`, `beta` (a number, or INFERRED with theta),
            `demonstration_id`, `participant` and `score`, the held-out log probability, mean over the sets of the draw.
        positions: `sampler`, `draw`, `demonstration_id`, `participant`, `feature`, `percentile` (0 to 1) in the pool.
    """

    divergences: pl.DataFrame
    scores: pl.DataFrame
    positions: pl.DataFrame

    @classmethod
    def together(cls, parts: Sequence[Measured]) -> Measured:
        """All of them."""
        return cls(
            pl.concat([part.divergences for part in parts]),
            pl.concat([part.scores for part in parts]),
            pl.concat([part.positions for part in parts]),
        )


def measure(
    redraw: Redraw,
    people: Demonstrations,
    names: Sequence[str],
    thetas: FloatArray,
    betas: FloatArray,
    bandwidth: str | float,
) -> Measured:
    """Posteriors and held-out scores under every model from the sets of one draw.

    Args:
        redraw: the sets.
        people: the demonstrations, in the features `names`, scaled.
        names: of the F features.
        thetas: (K, F).
        betas: (B,).
        bandwidth: how LESS selects its bandwidth, or that bandwidth.

    Raises:
        StageError: a demonstration has no alternatives.
        BandwidthError: a set or the pool has fewer than two distinct rows.
    """
    problem = Problem(people, {redraw.sampler: redraw.sets}, thetas, betas)
    selected = select_bandwidths(redraw.sets, bandwidth)
    scores: dict[str, Score] = {
        BOLTZMANN: boltzmann_score(problem),
        LESS: less_score(problem, selected.__getitem__),
        LESS_POOLED: _pooled_score(problem, redraw.pool, bandwidth),
        NESTED_LOGIT: _nested_score(problem, selected),
    }
    divergences, held_out = [], []
    for size, samplings in problem.by_size(redraw.sampler):
        for model, score in scores.items():
            values = log_likelihoods(problem, samplings, score)
            about = {"sampler": redraw.sampler, "draw": redraw.draw, "model": model, "set_size": size}
            labels = _labels(about)
            table = measures(theta_marginals(log_posteriors(values)), people, problem.truth_angles)
            divergences.append(table.select(*labels, pl.all()))
            if len(people.ids) > 1:
                held_out.append(_held_out(values, people, betas).select(*labels, pl.all()))
    return Measured(
        pl.concat(divergences), pl.concat(held_out) if held_out else no_scores(), _positions(redraw, people, names)
    )


def no_scores() -> pl.DataFrame:
    """The held-out scores of nobody."""
    return pl.DataFrame(
        schema={
            "sampler": pl.String, "draw": pl.Int64, "model": pl.String, "set_size": pl.Int64, "beta": pl.String,
            "demonstration_id": pl.String, "participant": pl.String, "score": pl.Float64,
        }
    )  # fmt: skip


def _pooled_score(problem: Problem, pool: Mapping[str, FloatArray], bandwidth: str | float) -> Score:
    """LESS whose density is that of the set and the pool together."""
    widths = {anchor: select_bandwidth(rows, bandwidth).value for anchor, rows in pool.items()}

    def score(demonstrations: FloatArray, sets: ChoiceSets, anchor: str) -> FloatArray:
        rows = sets.features[anchor]
        model = PooledLESS(np.concatenate([rows, pool[anchor]]), widths[anchor])
        return log_likelihood(model, demonstrations, rows, problem.thetas, problem.betas)

    return score


def _nested_score(problem: Problem, selected: Mapping[ChoiceSets, Mapping[str, float]]) -> Score:
    def score(demonstrations: FloatArray, sets: ChoiceSets, anchor: str) -> FloatArray:
        rows = sets.features[anchor]
        nests = nests_of(rows, NEST_BANDWIDTHS * selected[sets][anchor])
        return nested_log_likelihood(demonstrations, rows, nests, problem.thetas, problem.betas, DISSIMILARITY)

    return score


def _labels(about: Mapping[str, object]) -> list[pl.Expr]:
    return [pl.lit(value, pl.Int64 if isinstance(value, int) else pl.String).alias(key) for key, value in about.items()]


def _held_out(values: FloatArray, people: Demonstrations, betas: FloatArray) -> pl.DataFrame:
    """Held-out scores, mean over the R sets, from log likelihoods (R, n, K, B)."""
    n = len(people.ids)
    choices = [(INFERRED, slice(None)), *((f"{beta:g}", slice(b, b + 1)) for b, beta in enumerate(betas))]
    parts = [
        pl.DataFrame(
            {
                "beta": [beta] * n,
                "demonstration_id": people.ids,
                "participant": people.participants,
                "score": np.mean([held_out_from(one[:, :, part]).log_predictive for one in values], axis=0),
            }
        )
        for beta, part in choices
    ]
    return pl.concat(parts)


def _positions(redraw: Redraw, people: Demonstrations, names: Sequence[str]) -> pl.DataFrame:
    rows = []
    for anchor, pool in redraw.pool.items():
        for i in people.rows(anchor):
            below = (pool < people.features[i]).mean(axis=0) + (pool == people.features[i]).mean(axis=0) / 2
            rows += [
                {
                    "sampler": redraw.sampler,
                    "draw": redraw.draw,
                    "demonstration_id": people.ids[i],
                    "participant": people.participants[i],
                    "feature": name,
                    "percentile": float(share),
                }
                for name, share in zip(names, below, strict=True)
            ]
    return pl.DataFrame(rows)


def paper_tests(divergences: pl.DataFrame) -> tuple[pl.DataFrame, pl.DataFrame]:
    """The paper's tests of LESS against Boltzmann, for every sampler and draw.

    Returns:
        `sampler`, `draw` and the columns of `repeated_measures_anova`; and `sampler`, `draw` and those of `tukey_hsd`.
    """
    effects, pairs = list[pl.DataFrame](), list[pl.DataFrame]()
    compared = divergences.filter(pl.col("model").is_in((BOLTZMANN, LESS)))
    for (sampler, draw), rows in compared.group_by("sampler", "draw", maintain_order=True):
        found = analyse_regime(rows.with_columns(regime=pl.lit("")), "")
        if found is None:
            continue
        labels = [pl.lit(sampler).alias("sampler"), pl.lit(draw).alias("draw")]
        for into, table in zip((effects, pairs), found, strict=True):
            into.append(table.drop("regime").select(*labels, pl.all()))
    return (
        pl.concat(effects) if effects else pl.DataFrame(),
        pl.concat(pairs) if pairs else pl.DataFrame(),
    )


def leads(divergences: pl.DataFrame, post_hoc: pl.DataFrame) -> pl.DataFrame:
    """How many times lower or higher than Boltzmann's the KLAggregate of each other model is.

    Args:
        divergences: see `Measured`.
        post_hoc: the second table of `paper_tests`; may be empty.

    Returns:
        For every sampler, model, size and `demonstrations` (single or batch): `draws`, `participants`, `ratio` (of the
        geometric means, below 1 where the model is steadier than Boltzmann), its 95 % interval `low`, `high` over draws
        and people (over draws alone for batch), `sd_people` and `sd_draws` of the log ratio, `p_paired` (paired t test
        over people of their means over the draws), `share_lower` (of the draws in which the mean log ratio is below
        0), and for LESS `share_tukey` (of the draws in which Tukey's test at this size has p < .05).
    """
    logs = divergences.with_columns(pl.col(RAW).clip(NO_LESS).log())
    keys = ("sampler", "draw", "set_size", "participant")
    kinds = {SINGLE: logs.filter(pl.col("demonstration_id") != ALL), BATCH: logs.filter(demonstration_id=ALL)}
    rows = []
    for kind, table in kinds.items():
        means = table.group_by("model", *keys, maintain_order=True).agg(pl.col(RAW).mean())
        base = means.filter(model=BOLTZMANN).drop("model").rename({RAW: "base"})
        pairs = means.filter(pl.col("model") != BOLTZMANN).join(base, on=keys, maintain_order="left")
        pairs = pairs.with_columns(lead=pl.col(RAW) - pl.col("base"))
        for (sampler, model, size), part in pairs.group_by(BY, maintain_order=True):
            lead = crossed_lead(_crossed(part, "lead"))
            significant = (
                post_hoc.filter(sampler=sampler, set_size=size, measure=RAW)["p_value"] < 0.05
                if kind == SINGLE and model == LESS and not post_hoc.is_empty()
                else None
            )
            rows.append(
                {
                    "sampler": sampler, "model": model, "set_size": size, "demonstrations": kind,
                    "draws": lead.draws, "participants": lead.people, "ratio": float(np.exp(lead.mean)),
                    "low": float(np.exp(lead.low)), "high": float(np.exp(lead.high)), "sd_people": lead.sd_people,
                    "sd_draws": lead.sd_draws, "p_paired": lead.p_paired, "share_lower": lead.share_below,
                    "share_tukey": None if significant is None else float(significant.to_numpy().mean()),
                }
            )  # fmt: skip
    return pl.DataFrame(rows, schema_overrides=dict.fromkeys(("sd_people", "p_paired", "share_tukey"), pl.Float64))


def held_out_leads(scores: pl.DataFrame) -> pl.DataFrame:
    """By how many nats a person each other model predicts people better than Boltzmann.

    Args:
        scores: see `Measured`.

    Returns:
        For every sampler, model, size and `beta`: `draws`, `participants`, `lead` (nats a
        person, above 0 where the model predicts better), its 95 % interval `low`, `high` over draws and people,
        `sd_people`, `sd_draws`, `p_paired`, `share_ahead` (of the draws) and `people_ahead` (how many, on average over
        the draws).
    """
    keys = ("sampler", "draw", "set_size", "beta", "participant")
    means = scores.group_by("model", *keys, maintain_order=True).agg(pl.col("score").mean())
    base = means.filter(model=BOLTZMANN).drop("model").rename({"score": "base"})
    pairs = means.filter(pl.col("model") != BOLTZMANN).join(base, on=keys, maintain_order="left")
    pairs = pairs.with_columns(lead=pl.col("score") - pl.col("base"))
    rows = []
    for (sampler, model, size, beta), part in pairs.group_by(*BY, "beta", maintain_order=True):
        values = _crossed(part, "lead")
        lead = crossed_lead(values)
        rows.append(
            {
                "sampler": sampler, "model": model, "set_size": size, "beta": beta, "draws": lead.draws,
                "participants": lead.people, "lead": lead.mean, "low": lead.low, "high": lead.high,
                "sd_people": lead.sd_people, "sd_draws": lead.sd_draws, "p_paired": lead.p_paired,
                "share_ahead": 1 - lead.share_below, "people_ahead": int((values.mean(axis=0) > 0).sum()),
            }
        )  # fmt: skip
    return pl.DataFrame(rows, schema=HELD_OUT_LEADS)


def positions(table: pl.DataFrame) -> pl.DataFrame:
    """Where people stand in the pools of each sampler: mean percentile over draws, and how often beyond the pool."""
    return table.group_by("sampler", "demonstration_id", "participant", "feature", maintain_order=True).agg(
        pl.col("percentile").mean(), ((pl.col("percentile") <= 0) | (pl.col("percentile") >= 1)).mean().alias("beyond")
    )


def by_demonstration(scores: pl.DataFrame) -> pl.DataFrame:
    """Held-out scores of every demonstration, mean over the draws."""
    keys = ("sampler", "model", "set_size", "beta", "demonstration_id", "participant")
    return scores.group_by(*keys, maintain_order=True).agg(
        pl.col("score").mean(), pl.col("score").std().alias("sd_draws")
    )


def density_likelihood(
    model: str, phi: FloatArray, rows: FloatArray, log_w: FloatArray, cell: float, thetas: FloatArray, betas: FloatArray
) -> FloatArray:
    """(n, K, B) log densities of demonstrations over an explored choice space, with respect to the scaled features.

    Boltzmann's, which are with respect to the base measure, get the density of states there, so that models compare.

    Args:
        model: BOLTZMANN or LESS.
        phi: (n, F) scaled features of the demonstrations.
        rows: (M, F) what stands for the space.
        log_w: (M,) its log weights under the model.
        cell: width of a cell, and of the kernel.
        thetas: (K, F).
        betas: (B,).
    """
    values = region_log_likelihood(phi, rows, log_w, thetas, betas)
    return values + log_states(phi, rows, log_w, cell)[:, None, None] if model == BOLTZMANN else values


def explored_scores(
    people: Demonstrations, likelihoods: Mapping[str, Sequence[FloatArray]], betas: FloatArray
) -> pl.DataFrame:
    """Held-out scores over the explored choice space, in the columns of `Measured.scores`.

    Args:
        people: the demonstrations.
        likelihoods: by model and exploration (n, K, B) log densities with respect to the scaled features.
        betas: (B,).
    """
    if len(people.ids) < 2:
        return no_scores()
    parts = []
    for model, explorations in likelihoods.items():
        for number, values in enumerate(explorations):
            about = {"sampler": EXPLORED, "draw": number, "model": model, "set_size": 0}
            labels = _labels(about)
            parts.append(_held_out(values[None], people, betas).select(*labels, pl.all()))
    return pl.concat(parts) if parts else no_scores()


def _crossed(rows: pl.DataFrame, value: str) -> FloatArray:
    """(draws, people) of one column."""
    people = rows["participant"].n_unique()
    return rows.sort("draw", "participant")[value].to_numpy().reshape(-1, people)
