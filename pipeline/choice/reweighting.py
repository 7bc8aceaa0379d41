"""From draws under many tilts to the weight of each draw under none: the density of states over what was drawn.

The draws come from mu exp(omega_s . phi) / Z_s for S tilts. The estimate of mu that makes all draws together most
likely puts on draw n the weight
    w_n = 1 / sum_s N_s exp(omega_s . phi_n - log Z_s),  Z_s = sum_n w_n exp(omega_s . phi_n),
the multistate Bennett acceptance ratio (Shirts and Chodera 2008, equations 11 and 13). The log Z_s are the minimum of a
convex function, found by Newton's method. Once the weights are known, Z(omega) of *any* omega is a weighted sum, and
the draws with their log weights are a choice set over which Boltzmann is what it would be over all trajectories.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.validation import matrix, vector
from pipeline.errors import ArgumentError, StageError

TOLERANCE = 1e-8  # largest relative error of an expected count
_ITERATIONS = 200
_LONGEST_STEP = 2.0  # nat
MOST_ROWS = 60_000


@dataclass(frozen=True, eq=False)
class BaseWeights:
    """A sample of the base measure that also reaches where the base measure hardly does.

    Attributes:
        features: (M, F).
        log_w: (M,) log weights, whose exponentials sum to one.
        log_normalisers: (S,) log Z of the tilts, that of the first being zero.
    """

    features: FloatArray
    log_w: FloatArray
    log_normalisers: FloatArray

    def log_normaliser(self, omegas: ArrayLike) -> FloatArray:
        """log Z(omega) = log E_mu[exp(omega . phi)] of each row of (H, F)."""
        tilts = matrix("omegas", omegas, columns=self.features.shape[1])
        return np.array([log_sum_exp(self.features @ omega + self.log_w) for omega in tilts])

    def effective_sizes(self, omegas: ArrayLike) -> FloatArray:
        """Kish's effective number of draws behind each log Z(omega); a small one says that the tilt is out of reach."""
        tilts = matrix("omegas", omegas, columns=self.features.shape[1])
        terms = (self.features @ omega + self.log_w for omega in tilts)
        return np.array([np.exp(2 * log_sum_exp(term) - log_sum_exp(2 * term)) for term in terms])


def base_weights(
    features: ArrayLike,
    omegas: ArrayLike,
    counts: ArrayLike,
    start: ArrayLike | None = None,
    most_rows: int = MOST_ROWS,
) -> BaseWeights:
    """Pool draws from many tilts of one base measure.

    Args:
        features: (M, F) of the draws, tilt by tilt.
        omegas: (S, F) tilts, the first of them zero.
        counts: (S,) draws of each tilt, summing to M.
        start: (S,) first guess of log Z; zeros if not given.
        most_rows: more draws than these are thinned evenly, every k-th of each tilt, as neighbours are alike.

    Raises:
        ArgumentError: shapes do not fit.
        StageError: no convergence, as where the draws of some tilts do not overlap with the others.
    """
    rows, tilts = matrix("features", features), matrix("omegas", omegas)
    sizes = vector("counts", counts, length=len(tilts)).astype(np.intp)
    if sizes.sum() != len(rows) or sizes.min() < 1 or tilts.shape[1] != rows.shape[1] or tilts[0].any():
        raise ArgumentError(
            f"counts sums to {sizes.sum()} for {len(rows)} rows of features, the least count is {sizes.min()}, and the "
            f"first omega is {tilts[0].tolist()}; one positive count per tilt is needed, summing to the rows, and a "
            "first omega of zero."
        )
    log_z = np.zeros(len(tilts)) if start is None else vector("start", start, length=len(tilts)).copy()
    every = -(-len(rows) // most_rows)
    ends = np.cumsum(sizes)
    kept = np.concatenate([np.arange(end - size, end)[::-every][::-1] for size, end in zip(sizes, ends, strict=True)])
    rows, number = rows[kept], -(-sizes // every).astype(np.float64)
    tilted = rows @ tilts.T
    for _ in range(_ITERATIONS):
        shares, log_total = _shares(tilted, number, log_z)
        expected = shares.sum(axis=0)
        if np.abs(expected / number - 1).max() < TOLERANCE:
            log_w = -log_total
            return BaseWeights(rows, np.asarray(log_w - log_sum_exp(log_w)), log_z - log_z[0])
        hessian = np.diag(expected) - shares.T @ shares
        step = np.zeros(len(tilts))
        step[1:] = np.linalg.lstsq(hessian[1:, 1:], (expected - number)[1:], rcond=1e-12)[0]
        log_z += step * min(1.0, _LONGEST_STEP / max(np.abs(step).max(), 1e-300))
    raise StageError(
        f"the draws of {len(tilts)} tilts could not be pooled in {_ITERATIONS} steps (expected counts are off by up to "
        f"{np.abs(expected / number - 1).max():.2g}); their tilts lie too far apart, so take smaller steps in beta."
    )


def _shares(tilted: FloatArray, number: FloatArray, log_z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(M, S) how much each tilt accounts for each draw, and log sum_s N_s exp(omega_s . phi_n - log Z_s), (M,)."""
    terms = tilted + (np.log(number) - log_z)
    total = log_sum_exp(terms, axis=1)
    return np.exp(terms - total[:, None]), total
