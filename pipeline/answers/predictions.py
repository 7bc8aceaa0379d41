"""What people are predicted to do, as rows of tables: features, the end effector over time, the likeliest motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import polars as pl
from scipy import sparse
from scipy.spatial import cKDTree

from pipeline.arrays import FloatArray
from pipeline.choice.explored import Region
from pipeline.choice.prediction import PredictiveCheck, most_probable, neighbourhoods, predicted_interval
from pipeline.choice.weights.draws import SortedColumns
from pipeline.vocabulary import model_name

RADIUS = 0.1  # in scaled features: motions nearer than this are of one kind
LIKELIEST = 5


@dataclass(frozen=True, eq=False)
class Offer:
    """What someone chooses from.

    Attributes:
        waypoints: (N, T, J) trajectories.
        raw: (N, F) features.
        scaled: (N, F) the same divided by their scales.
        positions: (N, T, 3) m, of the end effector.
        log_w: (N,) log weights under a model.
    """

    waypoints: FloatArray
    raw: FloatArray
    scaled: FloatArray
    positions: FloatArray
    log_w: FloatArray

    @cached_property
    def sorted_features(self) -> SortedColumns:
        """The raw features."""
        return SortedColumns.of(self.raw)

    @cached_property
    def sorted_positions(self) -> SortedColumns:
        """The positions as (N, 3 T)."""
        return SortedColumns.of(self.positions.reshape(len(self.positions), -1))

    @cached_property
    def near(self) -> sparse.csr_array:
        """Which are of one kind."""
        return neighbourhoods(self.scaled, RADIUS)


def log_mass_of_cells(draws: Region, cells: FloatArray) -> FloatArray:
    """(N,) log of the weight of the draws that lie nearer to one of the cells' features (N, F) than to the others.

    So that what Boltzmann's draws foretell is shown by the trajectories that stand for the cells. It is -inf where no
    draw lies.
    """
    _, nearest = cKDTree(cells).query(draws.features)
    peak = draws.log_w.max()
    mass = np.bincount(nearest, weights=np.exp(draws.log_w - peak), minlength=len(cells))
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(mass) + peak)


def feature_rows(names: Sequence[str], offer: Offer, probabilities: FloatArray) -> pl.DataFrame:
    """Rows of the table `predictions`, but for who is predicted."""
    found = predicted_interval(offer.raw, probabilities, columns=offer.sorted_features)
    return pl.DataFrame({"feature": list(names), "low": found.lower, "median": found.median, "high": found.upper})


def motion_rows(offer: Offer, probabilities: FloatArray) -> pl.DataFrame:
    """Rows of the table `predicted_motion`, but for who is predicted."""
    found = predicted_interval(offer.positions, probabilities, columns=offer.sorted_positions)
    rows = pl.DataFrame({"low": found.lower, "median": found.median, "high": found.upper})
    return rows.with_columns(waypoint=pl.int_range(pl.len(), dtype=pl.Int64))


def likely_rows(offer: Offer, probabilities: FloatArray) -> pl.DataFrame:
    """Rows of the table `likely_paths`, but for who is predicted."""
    found = most_probable(offer.scaled, probabilities, LIKELIEST, RADIUS, offer.near)
    return pl.DataFrame(
        {
            "rank": np.arange(1, len(found.rows) + 1),
            "probability": np.minimum(found.probability, 1.0),
            "waypoints": offer.waypoints[found.rows],
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
