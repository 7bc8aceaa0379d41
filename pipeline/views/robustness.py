"""What the figures of the robustness study show besides its tables: accuracy, entropies, one example."""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

from pipeline.studies.robustness.tests import summarise
from pipeline.vocabulary import ALL, INDEPENDENT, SAMPLER_SHIFT

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


def accuracy(robustness: pl.DataFrame) -> pl.DataFrame:
    """Median accuracy over participants with its interval, and that of all together, by regime, model and set size.

    Args:
        robustness: the table of the study.

    Returns:
        `measure` (one of ACCURACY), the columns of POINT and those of `summarise`; no rows if no truth is known.
    """
    with_truth = robustness.drop("kl_low", "kl_high").filter(pl.col("true_posterior").is_not_null())
    if with_truth.is_empty():
        return pl.DataFrame(schema={"measure": pl.String, **{name: robustness.schema[name] for name in POINT}})
    tables = [
        summarise(with_truth, POINT, measure).select(pl.lit(measure).alias("measure"), pl.all()) for measure in ACCURACY
    ]
    return pl.concat(tables)


def entropies(sensitivity: pl.DataFrame) -> pl.DataFrame:
    """The table `sensitivity_summary` for the entropy of posteriors over theta; joint posteriors are left out."""
    return summarise(sensitivity.drop("kl_low", "kl_high").filter(pl.col("setting") != "joint"), SETTING, "entropy")


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
