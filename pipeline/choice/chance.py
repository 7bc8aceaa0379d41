"""How much better than chance hypotheses must explain people before that is more than luck."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.stats import binom, chi2

from pipeline.arrays import FloatArray

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
