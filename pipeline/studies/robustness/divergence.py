"""How much the posteriors of a demonstration differ between samplings, and how close they are to the truth."""

from __future__ import annotations

import numpy as np
import polars as pl
from scipy.special import entr

from pipeline.arrays import FloatArray
from pipeline.choice.metrics import divergences
from pipeline.studies.robustness.problem import Demonstrations, unit
from pipeline.vocabulary import ALL


def jackknife_interval(pairs: FloatArray, level: float = 0.95) -> tuple[float, float] | None:
    """Jackknife interval of KLAggregate, from leaving out one sampling at a time.

    KLAggregate is R (R - 1) times a U statistic of order two, for which the jackknife is valid. The interval is that of
    Student's t, with R - 1 degrees of freedom, for the logarithm, so that it stays positive.

    Args:
        pairs: (R, R) divergences of ordered pairs.
        level: confidence level.

    Returns:
        The ends of the interval; None with fewer than three samplings, or if KLAggregate is zero without one of them.
    """
    from scipy.special import stdtrit

    count = len(pairs)
    if count < 3:
        return None
    left_out = (pairs.sum() - pairs.sum(axis=0) - pairs.sum(axis=1)) * count / (count - 2)
    if not (left_out > 0).all():
        return None
    logs = np.log(left_out)
    error = np.sqrt((count - 1) / count * ((logs - logs.mean()) ** 2).sum())
    half_width = float(stdtrit(count - 1, (1 + level) / 2)) * error
    centre = np.log(pairs.sum())
    return float(np.exp(centre - half_width)), float(np.exp(centre + half_width))


def measures(
    marginals: FloatArray, demonstrations: Demonstrations, angles: tuple[FloatArray | None, ...]
) -> pl.DataFrame:
    """Robustness and accuracy of the posteriors of each demonstration and of all together.

    Args:
        marginals: (R, n + 1, K) log posteriors over theta from R samplings, all demonstrations together last.
        demonstrations: the n demonstrations.
        angles: `Problem.truth_angles`, of length n + 1.

    Returns:
        n + 1 rows: `demonstration_id`, `participant`, `sets` (R), `kl_aggregate` and its interval over samplings
        `kl_low`, `kl_high`, `kl_mean` (per ordered pair); means over the samplings: `entropy` (nats), `true_posterior`
        (of the theta of the grid that is nearest in angle to the truth) and `map_angle_rad` (between the most
        probable theta and the truth); `truth_to_grid_rad` (between the truth and that nearest theta). The last three
        are null where the truth is not known.
    """
    count = len(marginals)
    pairs = divergences(np.moveaxis(marginals, 1, 0))
    totals = pairs.sum(axis=(1, 2))
    entropies = entr(np.exp(marginals)).sum(axis=2).mean(axis=0)
    best = marginals.argmax(axis=2)
    rows = []
    for g, angle in enumerate(angles):
        low, high = jackknife_interval(pairs[g]) or (None, None)
        rows.append(
            {
                "demonstration_id": (*demonstrations.ids, ALL)[g],
                "participant": (*demonstrations.participants, ALL)[g],
                "sets": count,
                "kl_aggregate": float(totals[g]),
                "kl_low": low,
                "kl_high": high,
                "kl_mean": float(totals[g]) / (count * (count - 1)),
                "entropy": float(entropies[g]),
                "true_posterior": None if angle is None else float(np.exp(marginals[:, g, angle.argmin()]).mean()),
                "map_angle_rad": None if angle is None else float(angle[best[:, g]].mean()),
                "truth_to_grid_rad": None if angle is None else float(angle.min()),
            }
        )
    floats = ("kl_low", "kl_high", "true_posterior", "map_angle_rad", "truth_to_grid_rad")
    return pl.DataFrame(rows, schema_overrides=dict.fromkeys(floats, pl.Float64))


def true_direction(weights: dict[str, float], names: tuple[str, ...], scales: FloatArray) -> FloatArray | None:
    """The reward weights of a simulated participant, as a direction on the robot's scaled features.

    theta_f = w_f s_f, scaled to unit length, where w_f is the reward per raw unit of feature f and s_f its scale: the
    reward w_f phi_f is theta_f (phi_f / s_f). Features and weights are matched by name. A feature without a weight gets
    theta 0; a weight for a feature that the robot does not have is ignored.

    Args:
        weights: reward per raw unit, by feature.
        names: the F features of the robot.
        scales: (F,) what the raw features are divided by.

    Returns:
        (F,) of length one; None if all weights of the robot's features are zero.
    """
    theta = np.array([weights.get(name, 0.0) for name in names]) * scales
    return unit(theta) if theta.any() else None
