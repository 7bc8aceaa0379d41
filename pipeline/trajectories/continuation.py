"""How a motion may go on from its observed beginning: spliced alternatives and two simple predictions."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError


def spliced(observed: FloatArray, alternatives: FloatArray) -> FloatArray:
    """Trajectories that begin as observed and go on like each alternative.

    From the last observed waypoint h on, alternative i is followed at the distance at which the motion left it; that
    distance falls to zero at the end, smoothly, so that all end where the alternatives do:

        x_i(t) = q_i(t) + (x(h) - q_i(h)) (1 + 2 r) (1 - r)^2,    r = (t - h) / (T - 1 - h)

    The waypoints before are the observed ones, so the features of the spliced trajectory hold what has already been
    done, and a choice among them is a choice of how to go on: p(rest | beginning, omega) is the model's own softmax
    over trajectories that share the beginning.

    Args:
        observed: (h + 1, J) waypoints 0..h, in the same turns of continuous joints as the alternatives.
        alternatives: (N, T, J), T > h + 1.

    Returns:
        (N, T, J).

    Raises:
        ArgumentError: shapes do not fit.
    """
    seen, paths = _checked(observed, alternatives)
    last = len(seen) - 1
    r = np.linspace(0.0, 1.0, paths.shape[1] - last)
    decay = (1 + 2 * r) * (1 - r) ** 2  # leaves with the alternative's own velocity and arrives with it
    together = np.empty_like(paths)
    together[:, : last + 1] = seen
    together[:, last:] = paths[:, last:] + decay[:, None] * (seen[-1] - paths[:, last])[:, None]
    together[:, last] = seen[-1]
    return together


def straight_on(observed: FloatArray, goal: FloatArray, n_waypoints: int) -> FloatArray:
    """(T, J) the observed beginning (h + 1, J), then straight to the goal (J,) at even speed.

    Raises:
        ArgumentError: the beginning is not shorter than the motion, or shapes do not fit.
    """
    seen = np.asarray(observed, dtype=np.float64)
    if seen.ndim != 2 or not 1 <= len(seen) < n_waypoints or np.shape(goal) != seen.shape[1:]:
        raise ArgumentError(
            f"observed has shape {seen.shape} and goal {np.shape(goal)}; (h + 1, J) with h + 1 < "
            f"{n_waypoints} and (J,) are needed."
        )
    rest = np.linspace(seen[-1], goal, n_waypoints - len(seen) + 1)[1:]
    return np.concatenate([seen, rest])


def nearest(observed: FloatArray, others: FloatArray) -> int:
    """The row of `others` (N, T, J) whose beginning is nearest to the observed one, in root mean square distance.

    Raises:
        ArgumentError: shapes do not fit.
    """
    seen, paths = _checked(observed, others)
    return int(((paths[:, : len(seen)] - seen) ** 2).sum(axis=(1, 2)).argmin())


def prefix_log_kernel(observed: FloatArray, alternatives: FloatArray, width: float) -> FloatArray:
    """(N,) -d_i^2 / (2 width^2), d_i the root mean square distance between the beginnings.

    Added to the log weights of spliced alternatives it prefers those that began alike: people go on as they began.

    Raises:
        ArgumentError: shapes do not fit, or the width is not positive.
    """
    seen, paths = _checked(observed, alternatives)
    if not width > 0:
        raise ArgumentError(f"width is {width}; it must be positive.")
    squared = ((paths[:, : len(seen)] - seen) ** 2).sum(axis=2).mean(axis=1)
    return np.asarray(-squared / (2 * width**2))


def _checked(observed: FloatArray, alternatives: FloatArray) -> tuple[FloatArray, FloatArray]:
    seen, paths = np.asarray(observed, dtype=np.float64), np.asarray(alternatives, dtype=np.float64)
    if paths.ndim != 3 or seen.ndim != 2 or seen.shape[1] != paths.shape[2] or not 1 <= len(seen) < paths.shape[1]:
        raise ArgumentError(
            f"observed has shape {seen.shape} and alternatives {paths.shape}; (h + 1, J) and (N, T, J) with h "
            "+ 1 < T are needed."
        )
    return seen, paths
