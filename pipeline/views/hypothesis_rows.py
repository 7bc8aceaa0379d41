"""Which hypotheses a chart of posteriors has rows for, and in which order: the same in the viewer and in figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray, IntArray

MOST_ROWS = 10  # so that they can be told apart in a small window
NEGLIGIBLE = 0.01  # a hypothesis to which every model gives less has no row


@dataclass(frozen=True, eq=False)
class HypothesisRows:
    """The rows of a chart.

    Attributes:
        order: (R,) the hypotheses with a row of their own, from top to bottom.
        others: number of hypotheses without one; they share the last row.
    """

    order: IntArray
    others: int

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.order) + (self.others > 0)

    @property
    def shared(self) -> int | None:
        """The row that the others share; None if there are none."""
        return len(self.order) if self.others else None

    @property
    def last(self) -> str:
        """The name of the row that the others share; empty if there are none."""
        if self.others < 2:
            return "the other one" * self.others
        return f"the other {self.others} together"

    def values(self, posterior: FloatArray) -> FloatArray:
        """(count,) probabilities of the rows; the last is that of all other hypotheses together, if there are any."""
        values = posterior[self.order]
        return np.append(values, max(0.0, 1.0 - values.sum())) if self.others else values

    def own(self, posterior: FloatArray) -> FloatArray:
        """(R,) probabilities of the hypotheses with a row of their own."""
        return posterior[self.order]

    @property
    def unshown(self) -> str:
        """That the others are not shown, for charts without their row; empty if there are none."""
        return f" ({self.last.replace(' together', '')} not shown)" if self.others else ""

    def names(self, labels: Sequence[str], truth: int | None = None) -> list[str]:
        """(count,) names of the rows; the hypothesis nearest to the truth is marked, if that is known."""
        names = [marked(labels[k]) if k == truth else labels[k] for k in self.order]
        return [*names, self.last] if self.others else names


def marked(label: str) -> str:
    """The name of the hypothesis that is nearest to the truth."""
    return f"true: {label}"


def rows_that_matter(posteriors: Mapping[str, FloatArray], truth: int | None = None) -> HypothesisRows:
    """The hypotheses that have a row, by the largest probability that any model gives them, the largest first.

    Args:
        posteriors: for each model, (K,) probabilities.
        truth: a hypothesis that has a row in any case.
    """
    highest = np.max(list(posteriors.values()), axis=0)
    order = np.argsort(-highest, kind="stable")
    worth = [int(k) for k in order if highest[k] >= NEGLIGIBLE][:MOST_ROWS] or [int(order[0])]
    if truth is not None and truth not in worth:
        worth = [*worth[: MOST_ROWS - 1], truth]
    return HypothesisRows(np.array(worth), highest.size - len(worth))
