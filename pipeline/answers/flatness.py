"""Is a histogram of places between 0 and 1 flat, as those of the truth in calibrated posteriors are?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError

_FALSE_ALARM = 0.01


@dataclass(frozen=True, eq=False)
class Flatness:
    """A histogram of places between 0 and 1 against what chance allows.

    Attributes:
        counts: (B,) in equal bins.
        lower, upper: counts within which every bin of all histograms that are looked at together falls with
            probability 0.995 or more, if all are flat.
        p_value: of Pearson's chi-square against flatness.
        together: how many histograms are looked at together.
    """

    counts: FloatArray
    lower: float
    upper: float
    p_value: float
    together: int = 1

    @property
    def flat(self) -> bool:
        """Whether every bin is within the band, and the bins together are as even as chance makes them.

        Of histograms that are all flat, one or more is not found flat with probability 0.01 at most: half of it is for
        single bins, and half for the chi-square of all bins, which sees a slope or a bowl that no single bin shows.
        """
        inside = np.all((self.counts >= self.lower) & (self.counts <= self.upper))
        return bool(inside and self.p_value >= _FALSE_ALARM / 2 / self.together)


def flatness(places: ArrayLike, bins: int = 10, together: int = 1) -> Flatness:
    """Whether places of the truth are uniform, as those of a calibrated posterior are.

    Args:
        places: (R,) between 0 and 1.
        bins: B, of equal width.
        together: how many histograms are looked at together; each is judged as mildly as all of them need
            (Bonferroni).

    Raises:
        ArgumentError: there are fewer than five places for each bin, or one is not between 0 and 1.
    """
    values = np.asarray(places, dtype=np.float64)
    if values.ndim != 1 or bins < 2 or len(values) < 5 * bins:
        raise ArgumentError(
            f"places has shape {values.shape}; one axis with at least {5 * bins} for {bins} bins is needed."
        )
    if not np.all((values >= 0) & (values <= 1 + 1e-9)):
        raise ArgumentError("places must lie between 0 and 1.")
    counts = np.bincount(np.minimum((values * bins).astype(int), bins - 1), minlength=bins).astype(np.float64)
    number = np.arange(len(values) + 1)
    cumulative = special.bdtr(number, len(values), 1 / bins)
    tail = _FALSE_ALARM / 2 / (2 * bins * together)
    lower, upper = np.searchsorted(cumulative, [tail, 1 - tail])
    expected = len(values) / bins
    chi_square = float(((counts - expected) ** 2).sum() / expected)
    return Flatness(counts, float(lower), float(upper), float(special.chdtrc(bins - 1, chi_square)), together)
