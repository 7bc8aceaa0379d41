"""Whether any theta of the grid explains people better than chance, that is, than features that do not matter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
from scipy.optimize import brentq
from scipy.stats import binom, chi2

from pipeline.arrays import FloatArray
from pipeline.studies.posteriors import Group
from pipeline.vocabulary import ALL, model_name

LEVEL = 0.95


def needed_gain(thetas: FloatArray) -> float:
    """How far (nats) the best log likelihood must lie above that of theta = 0 to be more than luck.

    If theta = 0 is the truth, twice the gain is about chi-square, with one degree of freedom for each feature whose
    weight may have both signs; one whose weight has a single sign gains something in half of all cases (chi-bar-square,
    Self & Liang, 1987, case 9, taking the features as uncorrelated).

    Args:
        thetas: (K, F) the hypotheses.
    """
    low, high = (thetas < 0).any(axis=0), (thetas > 0).any(axis=0)
    free, halves = int((low & high).sum()), int((low ^ high).sum())
    if not free + halves:  # theta = 0 alone, which cannot gain
        free = 1
    shares = binom.pmf(np.arange(halves + 1), halves, 0.5)

    def excess(twice: float) -> float:
        luck = [chi2.sf(twice, free + count) if free + count else 0.0 for count in range(halves + 1)]
        return float(shares @ luck) - (1 - LEVEL)

    return float(brentq(excess, 1e-9, chi2.ppf(LEVEL, free + halves) + 1e-9)) / 2


def fit_rows(
    groups: Sequence[Group], values: FloatArray, by_chance: FloatArray, thetas: FloatArray, about: Mapping[str, object]
) -> pl.DataFrame:
    """Rows of the table `fits`.

    Args:
        groups: from `groups_of`.
        values: (n, K, B) log likelihoods of the demonstrations.
        by_chance: (n,) those under theta = 0.
        thetas: (K, F) reward weights.
        about: columns that have one value in all rows, with that value.
    """
    best = np.array([values[rows].sum(axis=0).max() for _, _, rows in groups])
    chance = np.array([by_chance[rows].sum() for _, _, rows in groups])
    needed = needed_gain(thetas)
    return pl.DataFrame(
        {
            "demonstration_id": [group[0] for group in groups],
            "participant": [group[1] for group in groups],
            "demonstrations": [len(group[2]) for group in groups],
            "log_likelihood": best,
            "log_chance": chance,
            "needed": needed,
            "better": best - chance >= needed,
        }
    ).with_columns(pl.lit(value).alias(column) for column, value in about.items())


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
