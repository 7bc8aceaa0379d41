"""What a trajectory outside a choice set does to the weights of LESS when it joins the set.

It adds its own kernel to the sum of every alternative, and its own sum is that of the alternatives' kernels at it, plus
s(0) = 1. All else, the bandwidth say, stays that of the alternatives alone. Sums over the set add up over its parts.
"""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice.kernel.density import log_density
from pipeline.choice.logspace import log_sum_exp


def join(rows: FloatArray, log_sums: FloatArray, points: FloatArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """The weights of some alternatives when each of n trajectories has joined the set by itself.

    log_w_j = -log(s_j + k(x, phi_j)), with s_j the alternative's kernel sum over the set without x.

    Args:
        rows: (M, F) scaled features of all alternatives of a set, or of a part of it.
        log_sums: (M,) log s_j, over the whole set.
        points: (n, F) scaled features of the trajectories.
        sigma: the kernel's bandwidth.

    Returns:
        (n, M) log weights, and (n,) log kernel sums over the rows at each trajectory, of which those over the whole
        set give `own_log_weights`.
    """
    log_kernels = np.stack([log_density(point[None], sigma, at=rows) for point in points])
    return 0.0 - np.logaddexp(log_sums, log_kernels), log_sum_exp(log_kernels, axis=1)


def own_log_weights(log_sums: FloatArray) -> FloatArray:
    """(n,) log weights of trajectories in the sets they have joined; `log_sums` (n,) are over the alternatives alone."""
    return np.asarray(0.0 - np.logaddexp(0.0, log_sums))
