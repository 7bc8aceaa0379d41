"""How much more of what would make a task's answer steady: evaluations, alternatives, demonstrations.

Each number is an extrapolation by a stated rule and not a promise.
- Evaluations: disagreement and change fall as a power of the evaluations, see `pipeline.choice.convergence`.
- Alternatives: the mean divergence of a pair of sampled sets falls as a power of the set size, fitted by least squares
  to the logarithms of all sizes of the robustness study. Where it does not fall, no number of alternatives is enough.
- Demonstrations: the posterior's width, the root mean square angle of theta from its mean direction, falls as one over
  the square root of their number, as it does for any model that can be told from its neighbours (Bernstein and von
  Mises). It cannot fall below the spacing of the hypotheses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, log

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.vocabulary import ALL, BOLTZMANN, INDEPENDENT, LESS, POOLED, SAMPLER_SHIFT, SINGLE

MOST = 10**12  # a larger number says no more than that none is enough


@dataclass(frozen=True)
class Evaluations:
    """What explorations of one model need.

    Attributes:
        model: which.
        done: evaluations of each exploration in the last round.
        disagreement, change: the largest of that round, nats; None in a first round.
        whose: demonstration or participant with the largest.
        converged: whether both are within the tolerance.
        further: evaluations that each still needs; None: none can be foreseen.
    """

    model: str
    done: int
    disagreement: float
    change: float | None
    whose: str
    converged: bool
    further: int | None


@dataclass(frozen=True)
class Alternatives:
    """What sampled sets of one regime and model need.

    Attributes:
        regime, model: which.
        size: of the largest sets.
        disagreement: mean divergence of a pair of them (nats), the median over single demonstrations.
        slope: the power with which it falls.
        needed: size of sets that would be within the tolerance; None: it does not fall.
    """

    regime: str
    model: str
    size: int
    disagreement: float
    slope: float
    needed: int | None


@dataclass(frozen=True)
class Demonstrations:
    """What a posterior of all demonstrations together needs.

    Attributes:
        model: which.
        done: demonstrations.
        width_deg: root mean square angle of theta from its mean direction.
        spacing_deg: median angle from one hypothesis to the nearest other.
        needed: demonstrations in all for the wanted width; None: it is below the spacing of the hypotheses.
    """

    model: str
    done: int
    width_deg: float
    spacing_deg: float
    needed: int | None


def evaluations(convergence: pl.DataFrame, tolerance: float) -> list[Evaluations]:
    """What each model of the table `convergence` needs."""
    found = []
    for (model,), rows in convergence.group_by("model", maintain_order=True):
        rounds = [part for _, part in rows.sort("round").group_by("round", maintain_order=True)]
        last = rounds[-1]
        worst = last.with_columns(most=pl.max_horizontal("disagreement", "change")).sort("most", descending=True)
        apart, change = (float(last[name].max() or 0.0) for name in ("disagreement", "change"))  # type: ignore[arg-type]
        known = last["change"].null_count() == 0
        done = int(last["evaluations"][0])
        settled = known and max(apart, change) <= tolerance
        person, key = worst.row(0, named=True)["participant"], worst.row(0, named=True)["demonstration_id"]
        whose = "all together" if person == ALL else f"all of {person}" if key == ALL else str(key)
        found.append(
            Evaluations(
                str(model), done, apart, change if known else None, whose, settled,
                0 if settled else _further(rounds, tolerance, apart, change) if known else None,
            )
        )  # fmt: skip
    return found


def _further(rounds: Sequence[pl.DataFrame], tolerance: float, apart: float, change: float) -> int | None:
    """See `Convergence.further_evaluations`, for any tolerance."""
    before, done = (int(part["evaluations"][0]) for part in rounds[-2:])
    first, times = float(rounds[-2]["disagreement"].max()), 1.0  # type: ignore[arg-type]
    if apart > tolerance:
        if not apart < first:
            return None
        times = (apart / tolerance) ** (log(done / before) / log(first / apart))
    more = done * (max(times, change / tolerance) - 1)
    return ceil(more) if more < MOST else None


def alternatives(summary: pl.DataFrame, sets: Mapping[str, int], tolerance: float) -> list[Alternatives]:
    """What sets of one sampler and of several need.

    Args:
        summary: the table `robustness_summary`.
        sets: by regime, how many sets of a size were compared.
        tolerance: nats a pair.
    """
    found = []
    for regime in (INDEPENDENT, SAMPLER_SHIFT):
        for model in (BOLTZMANN, LESS):
            rows = summary.filter(regime=regime, model=model, demonstrations=SINGLE).sort("set_size")
            if sets.get(regime, 0) < 2 or rows.height < 2 or not (rows["value"] > 0).all():
                continue
            size, apart = rows["set_size"].to_numpy(), rows["value"].to_numpy() / (sets[regime] * (sets[regime] - 1))
            slope = -float(np.polyfit(np.log(size), np.log(apart), 1)[0])
            last = float(apart[-1])
            needed = None
            if last <= tolerance:
                needed = int(size[-1])
            elif slope > 0 and log(last / tolerance) / slope < log(MOST):
                needed = ceil(size[-1] * (last / tolerance) ** (1 / slope))
            found.append(Alternatives(regime, model, int(size[-1]), last, slope, needed))
    return found


def demonstrations(posteriors: pl.DataFrame, width_deg: float) -> list[Demonstrations]:
    """What each model of the table `explored_posteriors` needs for a posterior of this width."""
    done = posteriors.filter(pl.col("demonstration_id") != ALL)["demonstration_id"].n_unique()
    found = []
    together = posteriors.filter(exploration=POOLED, demonstration_id=ALL, participant=ALL)
    for (model,), rows in together.group_by("model", maintain_order=True):
        marginal = rows.group_by("theta_id", maintain_order=True).agg(pl.first("theta"), pl.sum("posterior"))
        thetas = marginal["theta"].to_numpy()
        width, spacing = width_of(thetas, marginal["posterior"].to_numpy()), _spacing(thetas)
        needed: int | None = ceil(done * (width / width_deg) ** 2)
        if width <= width_deg:
            needed = done
        elif width_deg < spacing:
            needed = None
        found.append(Demonstrations(str(model), done, width, spacing, needed))
    return found


def width_of(thetas: FloatArray, p: FloatArray) -> float:
    """Root mean square angle (degrees) of directions (K, F) with probabilities (K,) from their mean direction."""
    unit = thetas / np.linalg.norm(thetas, axis=1, keepdims=True)
    mean = p @ unit
    length = np.linalg.norm(mean)
    if not length > 0:
        return 180.0
    angles = np.degrees(np.arccos(np.clip(unit @ mean / length, -1, 1)))
    return float(np.sqrt(p @ angles**2 / p.sum()))


def _spacing(thetas: FloatArray) -> float:
    unit = thetas / np.linalg.norm(thetas, axis=1, keepdims=True)
    cosines = np.clip(unit @ unit.T, -1, 1)
    np.fill_diagonal(cosines, -1)
    return float(np.median(np.degrees(np.arccos(cosines.max(axis=1)))))
