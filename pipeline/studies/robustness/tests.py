"""The statistics of the robustness study: analysis of variance, post-hoc tests, and the values in its figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.studies.statistics import repeated_measures_anova, tukey_hsd
from pipeline.vocabulary import ALL, BATCH, SINGLE

RAW, LOG = "kl_aggregate", "log_kl_aggregate"
FACTORS = ("model", "set_size")
ANOVA = {
    "regime": pl.String, "measure": pl.String, "effect": pl.String, "f": pl.Float64, "df_effect": pl.Int64,
    "df_error": pl.Int64, "p_value": pl.Float64, "p_greenhouse_geisser": pl.Float64, "partial_eta_squared": pl.Float64,
}  # fmt: skip
POST_HOC = {
    "regime": pl.String, "measure": pl.String, "set_size": pl.Int64, "model_a": pl.String, "model_b": pl.String,
    "mean_a": pl.Float64, "mean_b": pl.Float64, "difference": pl.Float64, "ci_low": pl.Float64, "ci_high": pl.Float64,
    "q": pl.Float64, "df": pl.Int64, "p_value": pl.Float64,
}  # fmt: skip
"""Columns of the two tables of `analyse_regime`."""


def analyse_regime(robustness: pl.DataFrame, regime: str) -> tuple[pl.DataFrame, pl.DataFrame] | None:
    """Analysis of variance of KLAggregate, model x size within participants, and Tukey's test at each size.

    Both are done for KLAggregate, as in the paper, and for its logarithm, whose spread does not grow with its size.
    Several demonstrations of one participant count as their mean. A factor with one level is left out.

    Args:
        robustness: the table of the study.
        regime: the regime whose rows are analysed.

    Returns:
        Two tables: `regime`, `measure` and the columns of `repeated_measures_anova`; and `regime`, `measure` and those
        of `tukey_hsd`, for pairs of models at one `set_size`. None if there is nothing to test: fewer than two
        participants, one model, or no difference between the posteriors.
    """
    rows = robustness.filter((pl.col("regime") == regime) & (pl.col("demonstration_id") != ALL))
    effects, pairs = [], []
    for measure in (RAW, LOG):
        table = rows.with_columns(pl.col(RAW).log().alias(LOG)).group_by("participant", *FACTORS, maintain_order=True)
        means = table.agg(pl.col(measure).mean())
        within = [factor for factor in FACTORS if means[factor].n_unique() > 1]
        try:
            anova = repeated_measures_anova(means, measure, within, "participant")
            same = "set_size" if "set_size" in within else None
            tukey = tukey_hsd(means, measure, within, "participant", same=same)
        except ArgumentError:
            return None
        labels = (pl.lit(regime).alias("regime"), pl.lit(measure).alias("measure"))
        effects.append(anova.select(*labels, pl.all()))
        pairs.append(_same_size(tukey, means["set_size"][0]).select(*labels, pl.all()))
    return pl.concat(effects), pl.concat(pairs)


def summarise(table: pl.DataFrame, by: Sequence[str], value: str) -> pl.DataFrame:
    """The values in a figure: the median over participants with its interval, and the value of all together.

    Args:
        table: has `demonstration_id`, `participant` and the columns below; `kl_low` and `kl_high`, if present, are the
            interval of the value of all together.
        by: columns that identify a point of the figure.
        value: column that is summarised; several demonstrations of one participant count as their mean.

    Returns:
        The columns `by`, `demonstrations` (`single` or `batch`), `participants` (1 for `batch`), `value`, `low` and
        `high` (95 % interval; null if there is none), and `mean` over participants.
    """
    per_participant = (
        table.filter(pl.col("demonstration_id") != ALL)
        .group_by(*by, "participant", maintain_order=True)
        .agg(pl.col(value).mean())
    )
    rows = []
    for key, group in per_participant.group_by(by, maintain_order=True):
        values = group[value].to_numpy()
        low, high = median_interval(values) or (None, None)
        labels = {"demonstrations": SINGLE, "participants": len(values)}
        rows.append(
            dict(zip(by, key, strict=True)) | labels
            | {"value": float(np.median(values)), "low": low, "high": high, "mean": float(values.mean())}
        )  # fmt: skip
    floats = dict.fromkeys(("value", "low", "high", "mean"), pl.Float64)
    singles = pl.DataFrame(rows, schema_overrides={**{name: table.schema[name] for name in by}, **floats})
    ends = [
        pl.col(column).alias(name) if column in table.columns else pl.lit(None, pl.Float64).alias(name)
        for column, name in (("kl_low", "low"), ("kl_high", "high"))
    ]
    together = table.filter(pl.col("demonstration_id") == ALL).select(
        *by,
        pl.lit(BATCH).alias("demonstrations"),
        pl.lit(1, pl.Int64).alias("participants"),
        pl.col(value).alias("value"),
        *ends,
        pl.col(value).alias("mean"),
    )
    return pl.concat([singles, together.select(singles.columns)])


def median_interval(values: FloatArray, level: float = 0.95) -> tuple[float, float] | None:
    """The interval of a median from order statistics, for any distribution.

    The median lies between the k-th smallest and the k-th largest of n values with probability
    1 - 2 sum_{i < k} C(n, i) 2^-n. The largest k is taken for which that reaches `level`; for 12 values and 95 % it is
    3, with 96.1 %.

    Returns:
        The ends of the interval; None if even k = 1 does not reach `level`, for 95 % with fewer than six values.
    """
    from scipy.stats import binom

    k = int(binom.ppf((1 - level) / 2, len(values), 0.5))
    if 2 * float(binom.cdf(k - 1, len(values), 0.5)) > 1 - level:
        k -= 1
    if k < 1:
        return None
    ordered = np.sort(values)
    return float(ordered[k - 1]), float(ordered[-k])


def _same_size(tukey: pl.DataFrame, only_size: int) -> pl.DataFrame:
    """The table with one column for the size of both cells; it is `only_size` if the size is not a factor."""
    if "model_a" not in tukey.columns:
        raise ArgumentError("the table has one model; a comparison needs two.")
    size = pl.col("set_size_a").cast(pl.Int64) if "set_size_a" in tukey.columns else pl.lit(only_size, pl.Int64)
    return tukey.select(size.alias("set_size"), pl.exclude("set_size_a", "set_size_b")).sort(
        "set_size", maintain_order=True
    )
