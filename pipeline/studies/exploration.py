"""Rows of the tables about an explored choice space: posteriors and convergence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray, IntArray
from pipeline.choice.convergence import Convergence
from pipeline.choice.logspace import log_sum_exp
from pipeline.studies.posteriors import Group
from pipeline.vocabulary import POOLED


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
    groups: Sequence[Group],
    record: Convergence,
    posteriors: Sequence[FloatArray],
    betas: FloatArray,
    costs: Sequence[Mapping[str, object]],
    about: Mapping[str, object],
) -> pl.DataFrame:
    """Rows of the table `convergence`.

    Args:
        groups: G groups that get a posterior.
        record: of their posteriors over theta.
        posteriors: (R, G, K, B) log posteriors over theta and beta, one array for each round.
        betas: (B,) inverse temperatures.
        costs: for each round, the columns that say what it took.
        about: columns that have one value in all rows, with that value.
    """
    tables, before = [], None
    for number, (values, cost) in enumerate(zip(posteriors, costs, strict=True)):
        now = _Answer.of(values, betas)
        so_far = Convergence(record.rounds[: number + 1], record.tolerance)
        further, nominal = so_far.further_evaluations, record.rounds[number].evaluations
        done = int(str(cost["evaluations"]))
        apart = record.rounds[number].disagreements
        said = {
            "round": number,
            "explorations": len(values),
            **cost,
            "tolerance": record.tolerance,
            "further_evaluations": None if further is None else -(-further * done // nominal),
        }
        columns = {
            "demonstration_id": [group[0] for group in groups],
            "participant": [group[1] for group in groups],
            "disagreement": apart,
            "learned": now.learned,
            "probability": now.probability(now.best),
            "mean_log10_beta": now.log10_beta,
            **now.since(before),
        }
        rows = pl.DataFrame(columns, schema_overrides=dict.fromkeys(CHANGES, pl.Float64)).with_columns(
            [_column(name, value) for name, value in {**about, **said}.items()]
        )
        within = (pl.col("disagreement") <= record.tolerance) & (pl.col("change") <= record.tolerance)
        tables.append(rows.with_columns(converged=within.fill_null(False)))
        before = now
    return pl.concat(tables)


CHANGES = ("change", "learned_change", "probability_change", "mean_log10_beta_change")
_NUMBERS = {"growth": pl.Float64, "effective_size": pl.Float64}


def _column(name: str, value: object) -> pl.Expr:
    number = pl.Int64 if isinstance(value, int) or name == "further_evaluations" else None
    return pl.lit(value, _NUMBERS.get(name, number)).alias(name)


@dataclass(frozen=True, eq=False)
class _Answer:
    """The pooled posteriors of G groups over theta (G, K), what is learned (G,) nats, the mean log10 beta (G,)."""

    log_p: FloatArray
    learned: FloatArray
    log10_beta: FloatArray

    @classmethod
    def of(cls, values: FloatArray, betas: FloatArray) -> _Answer:
        both = pooled(values)
        log_p = np.asarray(log_sum_exp(both, axis=2))
        p = np.exp(log_p)
        learned = np.log(p.shape[1]) + (p * np.where(p > 0, log_p, 0.0)).sum(axis=1)
        return cls(log_p, np.maximum(learned, 0.0), np.exp(np.asarray(log_sum_exp(both, axis=1))) @ np.log10(betas))

    @property
    def best(self) -> IntArray:
        """(G,) the most probable theta."""
        return np.asarray(self.log_p.argmax(axis=1))

    def probability(self, theta: IntArray) -> FloatArray:
        """(G,) of one theta for each group."""
        return np.minimum(np.exp(self.log_p[np.arange(len(theta)), theta]), 1.0)

    def since(self, before: _Answer | None) -> dict[str, FloatArray | list[None]]:
        """The columns of `CHANGES`."""
        if before is None:
            return {name: [None] * len(self.learned) for name in CHANGES}
        p = np.exp(self.log_p)
        changes = (
            np.maximum((p * np.where(p > 0, self.log_p - before.log_p, 0.0)).sum(axis=1), 0.0),
            self.learned - before.learned,
            self.probability(self.best) - before.probability(self.best),
            self.log10_beta - before.log10_beta,
        )
        return dict(zip(CHANGES, changes, strict=True))
