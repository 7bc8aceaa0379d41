"""What the figures of the robustness study show besides its tables: means of a pair, accuracy, changed answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from pipeline.choice.metrics import angle_to
from pipeline.studies.robustness.tests import summarise
from pipeline.views.intervals import mean_interval
from pipeline.vocabulary import ALL, BATCH, INDEPENDENT, SAMPLER_SHIFT

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray

ACCURACY = ("map_angle_rad", "true_posterior", "truth_to_grid_rad")
POINT = ("regime", "model", "set_size")
SETTING = ("regime", "choice", "setting", "is_default", "model", "set_size")


@dataclass(frozen=True)
class Example:
    """Two posteriors of one demonstration in each regime.

    Attributes:
        posteriors: rows of the table `robustness_posteriors` for that demonstration and set size.
        set_ids: for each regime, the names of the two sets.
        demonstration_id: the demonstration.
        set_size: number of alternatives in each set.
    """

    posteriors: pl.DataFrame
    set_ids: dict[str, tuple[str, str]]
    demonstration_id: str
    set_size: int


def per_pair(points: pl.DataFrame, counted: pl.DataFrame, by: Sequence[str]) -> pl.DataFrame:
    """KLAggregate as the mean of a pair, which reads the same for any number of sets: it is the sum of ordered pairs.

    Args:
        points: a summary with `value`, `low`, `high` and `mean`, sums over the pairs of sets.
        counted: the table it summarises, which has the number of `sets`.
        by: columns by which that number may differ.
    """
    sets = counted.group_by(by).agg(pl.col("sets").max())
    pairs = pl.col("sets") * (pl.col("sets") - 1)
    joined = points.join(sets, on=list(by), how="left", maintain_order="left")
    return joined.with_columns(pl.col("value", "low", "high", "mean") / pairs).drop("sets")


def accuracy(
    robustness: pl.DataFrame, together: pl.DataFrame | None = None, truth: FloatArray | None = None
) -> pl.DataFrame:
    """Median accuracy over participants with its interval, and that of all together, by regime, model and set size.

    Args:
        robustness: the table of the study.
        together: rows of the table `robustness_posteriors` of all together; without them there is no interval of these.
        truth: (F,) what all together truly want.

    Returns:
        `measure` (one of ACCURACY), the columns of POINT and those of `summarise`; no rows if no truth is known.
    """
    with_truth = robustness.drop("kl_low", "kl_high").filter(pl.col("true_posterior").is_not_null())
    if with_truth.is_empty():
        return pl.DataFrame(schema={"measure": pl.String, **{name: robustness.schema[name] for name in POINT}})
    tables = [
        summarise(with_truth, POINT, measure).select(pl.lit(measure).alias("measure"), pl.all()) for measure in ACCURACY
    ]
    found = pl.concat(tables)
    if together is None or truth is None or together.is_empty():
        return found
    ends = _over_sets(together, truth).with_columns(pl.lit(BATCH).alias("demonstrations"))
    return found.join(
        ends, on=["measure", *POINT, "demonstrations"], how="left", maintain_order="left", suffix="_over_sets"
    ).with_columns(
        low=pl.coalesce("low", "low_over_sets"), high=pl.coalesce("high", "high_over_sets")
    ).drop("low_over_sets", "high_over_sets")  # fmt: skip


def _over_sets(together: pl.DataFrame, truth: FloatArray) -> pl.DataFrame:
    """The 95 % interval over sets of the mean accuracy of all together."""
    rows = []
    for key, part in together.group_by(POINT, maintain_order=True):
        sets = [one.sort("theta_id") for one in part.partition_by("set_id", maintain_order=True)]
        angles = np.array([angle_to(theta, truth) for theta in sets[0]["theta"].to_numpy()])
        probability = np.stack([one["posterior"].to_numpy() for one in sets])
        values = {
            "map_angle_rad": angles[probability.argmax(axis=1)],
            "true_posterior": probability[:, angles.argmin()],
        }
        for measure, most in (("map_angle_rad", np.pi), ("true_posterior", 1.0)):
            low, high = mean_interval(values[measure]) or (None, None)
            if low is not None and high is not None:
                low, high = max(0.0, low), min(float(most), high)
            rows.append((measure, *key, low, high))
    schema: dict[str, Any] = {"measure": pl.String, **{name: together.schema[name] for name in POINT}}
    schema |= {"low": pl.Float64, "high": pl.Float64}
    return pl.DataFrame(rows, schema=schema, orient="row")


def changed_answers(sensitivity: pl.DataFrame) -> pl.DataFrame:
    """Of all together, the share of sets whose most probable theta is another one than as the study chose.

    Returns:
        The columns of SETTING, `demonstrations`, `value`, `low` and `high`; the last two are null.
    """
    nothing = pl.lit(None, pl.Float64)
    return sensitivity.filter(pl.col("demonstration_id") == ALL).select(
        *SETTING, pl.lit(BATCH).alias("demonstrations"), value="map_changed", low=nothing, high=nothing
    )


def middle_size(table: pl.DataFrame) -> int:
    """The middle one of the set sizes, such as 100 of the paper's 10, 30, 100, 300 and 1000."""
    sizes = sorted(table["set_size"].unique())
    return int(sizes[len(sizes) // 2])


def example(posteriors: pl.DataFrame) -> Example:
    """The first demonstration with the first and the last set of each regime, at the middle set size.

    This rule leaves no freedom to pick an example that suits.

    Args:
        posteriors: the table `robustness_posteriors` of one task.
    """
    size = middle_size(posteriors)
    single = posteriors.filter((pl.col("demonstration_id") != ALL) & (pl.col("set_size") == size))
    first = str(single["demonstration_id"][0])
    rows = single.filter(demonstration_id=first)
    set_ids = {
        regime: rows.filter(regime=regime)["set_id"].unique(maintain_order=True).to_list()
        for regime in (INDEPENDENT, SAMPLER_SHIFT)
    }
    return Example(rows, {regime: (ids[0], ids[-1]) for regime, ids in set_ids.items()}, first, size)
