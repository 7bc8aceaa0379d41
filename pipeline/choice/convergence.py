"""When independent explorations agree, and how many more evaluations they would need to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.validation import positive
from pipeline.errors import ArgumentError

TEN = 90  # ordered pairs of ten posteriors: the scale of the paper's KLAggregate


def disagreement(log_posteriors: ArrayLike) -> FloatArray:
    """Mean Kullback-Leibler divergence over ordered pairs of explorations, for each question asked (nats).

    Args:
        log_posteriors: (R, G, K) of R >= 2 explorations: for each of G questions, log probabilities of K hypotheses.

    Returns:
        (G,). Times 90 it is KLAggregate of ten such explorations.

    Raises:
        ArgumentError: fewer than two explorations, or no distributions.
    """
    log_p = np.asarray(log_posteriors, dtype=np.float64)
    if log_p.ndim != 3 or len(log_p) < 2 or not np.allclose(log_sum_exp(log_p, axis=2), 0.0, atol=1e-6):
        raise ArgumentError(
            f"log_posteriors has shape {log_p.shape}; two or more explorations are needed, (R, G, K) log probabilities."
        )
    count = len(log_p)
    # sum_ab KL(a, b) = R sum_a P_a log P_a - sum_k (sum_a P_a)(sum_b log P_b)
    p = np.exp(log_p)
    finite = np.where(p > 0, log_p, 0.0)
    impossible = ((p.sum(axis=0) > 0) & np.isneginf(log_p).any(axis=0)).any(axis=1)
    total = count * (p * finite).sum(axis=(0, 2)) - (p.sum(axis=0) * finite.sum(axis=0)).sum(axis=1)
    return np.where(impossible, np.inf, np.maximum(total, 0.0) / (count * (count - 1)))


@dataclass(frozen=True, eq=False)
class Round:
    """What explorations say after so many evaluations each.

    Attributes:
        evaluations: of each exploration.
        log_posteriors: (R, G, K).
    """

    evaluations: int
    log_posteriors: FloatArray

    @property
    def disagreements(self) -> FloatArray:
        """(G,) see `disagreement`."""
        return disagreement(self.log_posteriors)


@dataclass(frozen=True, eq=False)
class Convergence:
    """Whether explorations agree, in numbers.

    Attributes:
        rounds: one or more, evaluations increasing.
        tolerance: largest mean divergence per pair (nats) that counts as agreement.
    """

    rounds: tuple[Round, ...]
    tolerance: float

    @property
    def disagreement(self) -> float:
        """The largest over the questions, in the last round."""
        return float(self.rounds[-1].disagreements.max())

    @property
    def change(self) -> float:
        """Largest divergence of the pooled answer from that of the round before; infinite without one.

        Explorations can agree and be wrong together while they are still too short. This is what shows it.
        """
        if len(self.rounds) < 2:
            return np.inf
        now, before = (_pooled(entry.log_posteriors) for entry in self.rounds[-1:-3:-1])
        return float((np.exp(now) * (now - before)).sum(axis=1).max())

    @property
    def reached(self) -> bool:
        """Agreement *and* no change at the last doubling."""
        return self.disagreement <= self.tolerance and self.change <= self.tolerance

    @property
    def further_evaluations(self) -> int | None:
        """Extrapolated evaluations that each exploration still needs; None where the rounds show no decrease.

        Both numbers are taken to fall as a power of the evaluations, between the last two rounds (for the change, as
        one over the evaluations). This is an extrapolation, not a promise.
        """
        if self.reached:
            return 0
        if len(self.rounds) < 2:
            return None
        before, now = self.rounds[-2:]
        ratio = now.evaluations / before.evaluations
        first, last = float(before.disagreements.max()), self.disagreement
        needed = 1.0
        if last > self.tolerance:
            if not last < first:
                return None
            slope = np.log(first / last) / np.log(ratio)
            needed = (last / self.tolerance) ** (1 / slope)
        needed = max(needed, self.change / self.tolerance)
        return int(np.ceil(now.evaluations * (needed - 1))) if needed < 1e6 else None


def run_until(
    step: Callable[[int], FloatArray], evaluations: int, tolerance: float, most_evaluations: int
) -> Convergence:
    """Double the evaluations until explorations agree, or until there may be no more.

    Args:
        step: from the evaluations that each exploration is to have had in all to the log posteriors (R, G, K).
        evaluations: of the first round.
        tolerance: see `Convergence`.
        most_evaluations: of one exploration.

    Returns:
        The record; its `reached` says which of the two it was.

    Raises:
        ArgumentError: a number is not positive.
    """
    positive("tolerance", tolerance)
    if not 0 < evaluations <= most_evaluations:
        raise ArgumentError(
            f"evaluations is {evaluations}; it must be between 1 and most_evaluations, {most_evaluations}."
        )
    rounds: list[Round] = []
    while True:
        rounds.append(Round(evaluations, step(evaluations)))
        record = Convergence(tuple(rounds), tolerance)
        if record.reached or 2 * evaluations > most_evaluations:
            return record
        evaluations *= 2


def _pooled(log_posteriors: FloatArray) -> FloatArray:
    """(G, K) log of the mean posterior over explorations."""
    return np.asarray(log_sum_exp(log_posteriors, axis=0) - np.log(len(log_posteriors)))
