"""What people are predicted to do, as rows of tables: features, the end effector over time, the likeliest motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.choice.prediction import PredictiveCheck, most_probable, predicted_interval
from pipeline.vocabulary import model_name

RADIUS = 0.1  # in scaled features: motions nearer than this are of one kind
LIKELIEST = 5


@dataclass(frozen=True, eq=False)
class Offer:
    """What someone chooses from.

    Attributes:
        ids: (N,) alternatives.
        raw: (N, F) features.
        scaled: (N, F) the same divided by their scales.
        positions: (N, T, 3) m, of the end effector.
    """

    ids: Sequence[str]
    raw: FloatArray
    scaled: FloatArray
    positions: FloatArray


def feature_rows(names: Sequence[str], offer: Offer, probabilities: FloatArray) -> pl.DataFrame:
    """Rows of the table `predictions`, but for who is predicted."""
    found = predicted_interval(offer.raw, probabilities)
    return pl.DataFrame({"feature": list(names), "low": found.lower, "median": found.median, "high": found.upper})


def motion_rows(offer: Offer, probabilities: FloatArray) -> pl.DataFrame:
    """Rows of the table `predicted_motion`, but for who is predicted."""
    found = predicted_interval(offer.positions, probabilities)
    rows = pl.DataFrame({"low": found.lower, "median": found.median, "high": found.upper})
    return rows.with_columns(waypoint=pl.int_range(pl.len(), dtype=pl.Int64))


def likely_rows(offer: Offer, probabilities: FloatArray) -> pl.DataFrame:
    """Rows of the table `likely_paths`, but for who is predicted."""
    found = most_probable(offer.scaled, probabilities, LIKELIEST, RADIUS)
    return pl.DataFrame(
        {
            "rank": np.arange(1, len(found.rows) + 1),
            "alternative_id": [offer.ids[row] for row in found.rows],
            "probability": np.minimum(found.probability, 1.0),
        }
    )


def check_rows(people: pl.DataFrame, names: Sequence[str], check: PredictiveCheck, model: str) -> pl.DataFrame:
    """Rows of the table `predictive_checks`, but for the task.

    Args:
        people: `demonstration_id` and `participant` of the n demonstrations.
        names: of the F features.
        check: of shape (n, F).
        model: label.
    """
    columns = [
        people.with_columns(
            feature=pl.lit(name),
            place=pl.Series(check.place[:, column].clip(0, 1)),
            p_value=pl.Series(check.p_value[:, column].clip(0, 1)),
            model=pl.lit(model),
        )
        for column, name in enumerate(names)
    ]
    return pl.concat(columns)


def beyond_sentences(checks: pl.DataFrame, level: float = 0.05) -> list[str]:
    """Which features more demonstrations lie beyond what was predicted than chance allows for.

    Args:
        checks: rows of the table `predictive_checks`, of one task.
        level: of the p values.
    """
    said = []
    counted = checks.group_by("model", "feature", maintain_order=True).agg(
        (pl.col("p_value") < level).sum().alias("beyond"), pl.len().alias("count")
    )
    for model, feature, beyond, count in counted.iter_rows():
        if beyond > 2 * level * count + 1:
            said.append(
                f"{beyond} of {count} demonstrations lie beyond p = {level:g} in {feature} of what {model_name(model)} "
                f"predicts from the others; about {level * count:.1g} would by chance"
            )
    return said
