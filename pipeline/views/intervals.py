"""What figures show besides the tables: intervals, comparisons of models, hypotheses in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from scipy.special import betaincinv, ndtri, stdtrit

from pipeline.choice import HeldOutScore, compare_held_out
from pipeline.errors import ArgumentError
from pipeline.vocabulary import BOLTZMANN

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray

LEVEL = 0.95


def binomial_interval(count: int, n: int, level: float = LEVEL) -> tuple[float, float]:
    """The exact confidence interval of a share (Clopper and Pearson, 1934).

    Its ends are the shares for which a count this large or larger, or this small or smaller, has probability
    (1 - level) / 2.

    >>> [round(end, 4) for end in binomial_interval(15, 37)]
    [0.2475, 0.579]

    Args:
        count: successes, 0..n.
        n: trials, at least 1.
        level: confidence level, between 0 and 1.

    Raises:
        ArgumentError: an argument is out of range.
    """
    if n < 1 or not 0 <= count <= n:
        raise ArgumentError(f"count is {count} of n = {n}; needed are n of at least 1 and a count from 0 to n.")
    if not 0 < level < 1:
        raise ArgumentError(f"level is {level}; it must lie between 0 and 1.")
    tail = (1 - level) / 2
    low = float(betaincinv(count, n - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, n - count, 1 - tail)) if count < n else 1.0
    return low, high


def with_share_intervals(predictions: pl.DataFrame) -> pl.DataFrame:
    """The table `human_choice_predictions` with `n`, `low` and `high`: the 95 % interval of the observed share.

    `n` is the number of choices of which it is a share. If nobody chose a group, the shares within it have no interval.
    """
    group = pl.when(pl.col("comparison") == "within").then(pl.col("group"))
    counted = predictions.with_columns(n=pl.col("count").sum().over("comparison", "model", group))
    ends = [binomial_interval(count, n) if n else (None, None) for count, n in counted.select("count", "n").iter_rows()]
    return counted.with_columns(
        pl.Series("low", [low for low, _ in ends], dtype=pl.Float64),
        pl.Series("high", [high for _, high in ends], dtype=pl.Float64),
    )


def with_mean_intervals(summary: pl.DataFrame) -> pl.DataFrame:
    """The table `grid_world_summary` with `low` and `high`: mean TruePosterior -+ 1.96 standard errors (95 %)."""
    half_width = pl.col("standard_error") * float(ndtri((1 + LEVEL) / 2))
    return summary.with_columns(low=pl.col("true_posterior") - half_width, high=pl.col("true_posterior") + half_width)


def mean_interval(values: FloatArray, level: float = LEVEL) -> tuple[float, float] | None:
    """The interval of a mean by Student's t; None with fewer than two values.

    >>> [round(end, 3) for end in mean_interval(np.array([1.0, 2.0, 3.0]))]
    [-0.484, 4.484]
    """
    if len(values) < 2:
        return None
    half_width = float(stdtrit(len(values) - 1, (1 + level) / 2) * np.std(values, ddof=1) / np.sqrt(len(values)))
    return float(np.mean(values)) - half_width, float(np.mean(values)) + half_width


def compare_models(held_out: pl.DataFrame) -> pl.DataFrame:
    """How well each model predicts one task's demonstrations.

    The catalog's view `model_comparison` computes the same in SQL, for all tasks; a test compares the two.

    Args:
        held_out: rows of the table `held_out` for one set.

    Returns:
        One row per model: `model`, `demonstrations`, `mean` log predictive probability per demonstration (nats),
        `standard_error`, and the mean paired `difference` to Boltzmann with `difference_standard_error`; both are 0 for
        Boltzmann itself and null if Boltzmann was not inferred.
    """
    scores = {
        str(model): HeldOutScore(rows.sort("demonstration_id")["log_predictive"].to_numpy())
        for (model,), rows in held_out.group_by("model", maintain_order=True)
    }
    reference = scores.get(BOLTZMANN)
    rows = []
    for model, score in scores.items():
        lead = None if reference is None else compare_held_out(score, reference)
        rows.append(
            {
                "model": model,
                "demonstrations": len(score.log_predictive),
                "mean": score.mean,
                "standard_error": score.standard_error,
                "difference": lead.mean if lead else None,
                "difference_standard_error": lead.standard_error if lead else None,
            }
        )
    return pl.DataFrame(rows, schema_overrides={"difference": pl.Float64, "difference_standard_error": pl.Float64})


def differences(held_out: pl.DataFrame) -> pl.DataFrame:
    """How much better each model predicts each demonstration than Boltzmann does.

    Args:
        held_out: rows of the table `held_out` for one set.

    Returns:
        One row per demonstration and model other than Boltzmann: `demonstration_id`, `model`, `difference` (nats).
    """
    keys = ["demonstration_id", "set_size", "set_id"]
    reference = held_out.filter(model=BOLTZMANN).select(*keys, reference="log_predictive")
    return (
        held_out.filter(pl.col("model") != BOLTZMANN)
        .join(reference, on=keys, maintain_order="left")
        .select("demonstration_id", "model", difference=pl.col("log_predictive") - pl.col("reference"))
    )


def path_shifts(count: int, most: float) -> FloatArray:
    """(count,) shifts of shortest paths through a grid, in cells, that keep paths with common steps apart.

    Such paths only go right and up, so a shift to the right and down separates them everywhere.

    Args:
        count: number of paths.
        most: the largest distance between neighbouring paths.
    """
    return np.asarray(min(most, 0.8 / count) * (np.arange(count) - (count - 1) / 2))


def near_or_far(thetas: FloatArray, objects: tuple[str, str] = ("A", "B")) -> list[tuple[str, ...]]:
    """The rewards of the grid world in words: a positive weight of the distance to an object is a wish to be far away.

    >>> import numpy as np
    >>> near_or_far(np.array([[-1.0, 1.0], [0.0, -1.0]]))
    [('near A', 'far from B'), ('near B',)]

    Args:
        thetas: (K, 2) weights of the mean distances.
        objects: names of the two objects.

    Returns:
        For each theta its wishes, one for every weight that is not zero.
    """
    return [
        tuple(
            f"{'far from' if weight > 0 else 'near'} {name}"
            for weight, name in zip(theta, objects, strict=True)
            if weight
        )
        for theta in thetas
    ]
