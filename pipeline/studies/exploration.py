"""Rows of the tables about an explored choice space: posteriors, convergence, agreement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice.convergence import Convergence, disagreement
from pipeline.choice.logspace import log_sum_exp
from pipeline.studies.posteriors import Group
from pipeline.vocabulary import ALL, POOLED


def exploration_name(number: int) -> str:
    """What the column `exploration` has."""
    return f"{number:02d}"


def explored_posterior_rows(
    groups: Sequence[Group], values: FloatArray, thetas: FloatArray, betas: FloatArray, about: Mapping[str, object]
) -> Iterator[pl.DataFrame]:
    """Rows of the table `explored_posteriors`, one exploration after another and then the mean over them.

    Args:
        groups: G groups.
        values: (R, G, K, B) log posteriors.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        about: columns that have one value in all rows, with that value.
    """
    count, k, b = len(groups), len(thetas), len(betas)
    group = np.repeat(np.arange(count), k * b)
    names = [*map(exploration_name, range(len(values))), POOLED]
    for name, log_p in zip(names, [*values, pooled(values)], strict=True):
        yield pl.DataFrame(
            {
                "demonstration_id": pl.Series([one[0] for one in groups]).gather(group),
                "participant": pl.Series([one[1] for one in groups]).gather(group),
                "theta_id": np.tile(np.repeat(np.arange(k), b), count),
                "theta": np.tile(np.repeat(thetas, b, axis=0), (count, 1)),
                "beta": np.tile(betas, count * k),
                "log_posterior": np.minimum(log_p.ravel(), 0.0),
                "posterior": np.exp(np.minimum(log_p.ravel(), 0.0)),
            }
        ).with_columns(pl.lit(value).alias(column) for column, value in {**about, "exploration": name}.items())


def pooled(values: FloatArray) -> FloatArray:
    """Log of the mean over explorations, the first axis."""
    return np.asarray(log_sum_exp(values, axis=0) - np.log(len(values)))


def convergence_rows(
    groups: Sequence[Group], record: Convergence, costs: Sequence[Mapping[str, object]], about: Mapping[str, object]
) -> pl.DataFrame:
    """Rows of the table `convergence`.

    Args:
        groups: that get a posterior.
        record: its posteriors are over theta.
        costs: for each round, the columns that say what it took.
        about: columns that have one value in all rows, with that value.
    """
    single = [row for row, (demonstration, _, _) in enumerate(groups) if demonstration != ALL]
    rows = []
    for number, cost in enumerate(costs):
        so_far = Convergence(record.rounds[: number + 1], record.tolerance)
        apart = record.rounds[number].disagreements
        further, nominal = so_far.further_evaluations, record.rounds[number].evaluations
        done = int(str(cost["evaluations"]))
        rows.append(
            {
                "round": number,
                "explorations": len(record.rounds[number].log_posteriors),
                **cost,
                "disagreement": so_far.disagreement,
                "disagreement_single": float(np.median(apart[single])),
                "disagreement_all": float(apart[-1]),
                "change": so_far.change if number else None,
                "tolerance": record.tolerance,
                "converged": so_far.reached,
                "further_evaluations": None if further is None else -(-further * done // nominal),
            }
        )
    types = {"growth": pl.Float64, "effective_size": pl.Float64, "change": pl.Float64, "further_evaluations": pl.Int64}
    return pl.DataFrame(rows, schema_overrides=types).with_columns(
        pl.lit(value).alias(column) for column, value in about.items()
    )


def agreement_rows(
    groups: Sequence[Group],
    rounds: Sequence[FloatArray],
    betas: FloatArray,
    tolerance: float,
    about: Mapping[str, object],
) -> pl.DataFrame:
    """Rows of the table `agreement`.

    Args:
        groups: G groups.
        rounds: (R, G, K, B) log posteriors, one for each round.
        betas: (B,) inverse temperatures.
        tolerance: what agrees.
        about: columns that have one value in all rows, with that value.
    """
    tables, before = [], None
    for number, values in enumerate(rounds):
        thetas = np.asarray(log_sum_exp(values, axis=3))
        apart, now = disagreement(thetas), pooled(thetas)
        p = np.exp(now)
        best = p.argmax(axis=1)[:, None]
        strict = np.exp(np.asarray(log_sum_exp(pooled(values), axis=1))) @ np.log10(betas)
        learned = np.maximum(np.log(p.shape[1]) + (p * np.where(p > 0, now, 0.0)).sum(axis=1), 0.0)
        columns: dict[str, object] = {
            "demonstration_id": [group[0] for group in groups],
            "participant": [group[1] for group in groups],
            "disagreement": apart,
            "learned": learned,
            "probability": np.minimum(np.take_along_axis(p, best, axis=1)[:, 0], 1.0),
            "mean_log10_beta": strict,
        }
        if before is not None:
            change = np.maximum((p * np.where(p > 0, now - before["now"], 0.0)).sum(axis=1), 0.0)
            columns |= {
                "change": change,
                "learned_change": learned - before["learned"],
                "probability_change": np.take_along_axis(p - np.exp(before["now"]), best, axis=1)[:, 0],
                "mean_log10_beta_change": strict - before["strict"],
                "converged": (apart <= tolerance) & (change <= tolerance),
            }
        before = {"now": now, "learned": learned, "strict": strict}
        tables.append(pl.DataFrame(columns).with_columns(round=pl.lit(number, pl.Int64)))
    missing = ["change", "learned_change", "probability_change", "mean_log10_beta_change"]
    rows = pl.concat(tables, how="diagonal")
    rows = rows.with_columns(pl.lit(None, pl.Float64).alias(one) for one in missing if one not in rows.columns)
    if "converged" not in rows.columns:
        rows = rows.with_columns(converged=pl.lit(False))
    return rows.with_columns(
        pl.col("converged").fill_null(False), *(pl.lit(value).alias(column) for column, value in about.items())
    )
