"""Where demonstrations stand among the alternatives, and whether any theta explains them better than chance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.vocabulary import ALL, model_name


def support_rows(
    people: pl.DataFrame, demonstrations: FloatArray, alternatives: Sequence[FloatArray], features: Sequence[str]
) -> pl.DataFrame:
    """The rows of support.parquet.

    Args:
        people: n rows with `demonstration_id` and `participant`.
        demonstrations: (n, F) features, not scaled.
        alternatives: for each demonstration, the (N, F) features of the alternatives it is compared with.
        features: their F names.
    """
    rows = []
    for about, phi, others in zip(people.iter_rows(named=True), demonstrations, alternatives, strict=True):
        low, high = others.min(axis=0), others.max(axis=0)
        rank = np.mean((others < phi) + 0.5 * (others == phi), axis=0)
        for column, feature in enumerate(features):
            value = phi[column]
            rows.append(
                {
                    "demonstration_id": about["demonstration_id"],
                    "participant": about["participant"],
                    "feature": feature,
                    "value": float(value),
                    "low": float(low[column]),
                    "high": float(high[column]),
                    "rank": float(rank[column]),
                    "outside": bool(value < low[column] or value > high[column]),
                }
            )
    return pl.DataFrame(rows)


def beyond(support: pl.DataFrame) -> list[str]:
    """One sentence for each feature in which demonstrations are outside, with the names of some of them."""
    sentences = []
    total = support["demonstration_id"].n_unique()
    for (feature,), rows in support.group_by("feature", maintain_order=True):
        outside = rows.filter("outside")
        if outside.height:
            first = outside.row(0, named=True)
            side = "below" if first["value"] < first["low"] else "above"
            edge = first["low"] if side == "below" else first["high"]
            be = "is" if outside.height == 1 else "are"
            names = ", ".join(outside["demonstration_id"][:3]) + (", ..." if outside.height > 3 else "")
            sentences.append(
                f"{outside.height} of {total} demonstrations {be} outside the sampled alternatives' range in {feature} "
                f"({names}; {first['demonstration_id']} has {first['value']:.3g}, {side} their {edge:.3g}), so what "
                "they say about it is extrapolated"
            )
    return sentences


def at_edge(marginal: FloatArray, betas: Sequence[float], model: str) -> str | None:
    """A sentence if the most probable beta is the first or last of its grid; None if it is within, or the only one.

    Args:
        marginal: (B,) posterior over beta.
        betas: (B,) the grid, ascending or not.
        model: in words.
    """
    if len(betas) < 2:
        return None
    best = betas[int(np.argmax(marginal))]
    if min(betas) < best < max(betas):
        return None
    return edge_sentence(model, best, "least" if best == min(betas) else "greatest")


def edge_sentence(model: str, beta: float, edge: str) -> str:
    """What it means that `beta` is the most probable and the `least` or `greatest` of the grid."""
    return (
        f"under {model} the most probable beta of all together, {beta:g}, is the {edge} of infer.betas, so that the "
        "best one may be beyond it; widen the grid and see whether the answer changes"
    )


def chance_notes(fits: pl.DataFrame) -> list[str]:
    """A sentence for each model under which no theta explains all demonstrations together better than chance."""
    together = fits.filter(demonstration_id=ALL, participant=ALL, better=False)
    return [_sentence(row) for row in together.iter_rows(named=True)]


def _sentence(row: Mapping[str, Any]) -> str:
    gain = row["log_likelihood"] - row["log_chance"]
    return (
        f"under {model_name(row['model'])} no theta of the grid explains the {row['demonstrations']} demonstrations "
        f"better than chance (log likelihood {gain:+.1f} against that of theta = 0, needed is +{row['needed']:.1f}), "
        "so do not read the posterior as a preference; if people may want more of a feature, give it positive values "
        "in the task's thetas"
    )
