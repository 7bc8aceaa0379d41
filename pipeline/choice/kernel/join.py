"""The weights of LESS when a trajectory from outside joins a choice set.

The trajectory adds its kernel to the sum of every alternative. Its own sum is that of the alternatives' kernels at its
features, plus s(0) = 1. Everything else, such as the bandwidth, stays as it is for the alternatives alone. The sum over
a set is the sum over its parts.
"""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice.kernel.density import log_density
from pipeline.choice.logspace import log_sum_exp


def join(rows: FloatArray, log_sums: FloatArray, points: FloatArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """The log weights of alternatives after each of n trajectories has joined the set by itself.

    log_w_j = -log(s_j + k(x, phi_j)), with s_j the alternative's kernel sum over the set without x.

    Args:
        rows: (M, F) scaled features of all alternatives of a set, or of a part of it.
        log_sums: (M,) log s_j, kernel sums over the whole set.
        points: (n, F) scaled features of the trajectories.
        sigma: the kernel's bandwidth.

    Returns:
        (n, M) log weights, and (n,) log kernel sums over `rows` at each trajectory. Summed over all parts of the set,
        the latter are what `own_log_weights` takes.
    """
    log_kernels = np.stack([log_density(point[None], sigma, at=rows) for point in points])
    return 0.0 - np.logaddexp(log_sums, log_kernels), log_sum_exp(log_kernels, axis=1)


def own_log_weights(log_sums: FloatArray) -> FloatArray:
    """(n,) log weights of n trajectories in the sets they joined, from log kernel sums (n,) over the alternatives."""
    return np.asarray(0.0 - np.logaddexp(0.0, log_sums))
