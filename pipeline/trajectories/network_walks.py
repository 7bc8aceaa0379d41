"""Paths in a network by a random walk that leans towards its destination, with the exact density of each path.

p(step k -> l) is proportional to exp(-bias * detour), where detour = cost(k -> l) + D(l) - D(k) >= 0 and D is the least
cost to the destination. The density of a path is the product over its steps. Every path has a positive one, also those
with cycles; without bias all steps are equally likely, and with much of it only the cheapest path is left.

Source: in the manner of Frejinger, Bierlaire and Ben-Akiva (2009), Sampling of alternatives for route choice modeling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from pipeline.arrays import FloatArray, IndexArray
from pipeline.errors import ArgumentError

MOST_STEPS = 100_000
END = -1
"""Fills the rows of shorter paths."""


@dataclass(frozen=True)
class Walks:
    """Paths that were drawn.

    Attributes:
        steps: (W, T) numbers of the steps, in order; `END` after the last one.
        log_density: (W,) log probability that the sampler draws this path.
    """

    steps: IndexArray
    log_density: FloatArray


class Network:
    """The steps between states.

    Args:
        sources: (A,) state that each step leaves, in increasing order.
        targets: (A,) state that it reaches.
    """

    def __init__(self, sources: IndexArray, targets: IndexArray) -> None:
        if not (np.diff(sources) >= 0).all():
            raise ArgumentError("sources must not decrease; sort the steps by the state that they leave.")
        self.sources, self.targets = sources, targets
        self.states = int(max(sources.max(), targets.max())) + 1
        self.first = np.searchsorted(sources, np.arange(self.states + 1))
        self.ways_out = np.diff(self.first)
        self._ending = ~np.isin(targets, sources)

    def least_costs(self, cost: FloatArray, destination: int) -> FloatArray:
        """(states,) least cost to a destination; infinite where there is no way.

        Args:
            cost: (A,) of the steps, not negative.
            destination: a state.
        """
        used = ~self._ending | (self.targets == destination)
        reverse = sparse.csr_array(
            (cost[used] + 1e-12, (self.targets[used], self.sources[used])), shape=(self.states, self.states)
        )  # a step that costs nothing would be taken for none
        return np.asarray(csgraph.dijkstra(reverse, indices=np.array([destination]))[0])

    def log_step_probabilities(self, cost: FloatArray, destination: int, bias: float) -> FloatArray:
        """(A,) log probability of each step from the state that it leaves; -inf for a step into another destination.

        Args:
            cost: (A,) of the steps, not negative.
            destination: a state.
            bias: of the walk, per unit of cost.
        """
        least = self.least_costs(cost, destination)
        usable = np.isfinite(least[self.targets]) & np.isfinite(least[self.sources])
        utility = np.full(len(cost), -np.inf)
        detour = cost[usable] + least[self.targets[usable]] - least[self.sources[usable]]
        utility[usable] = -bias * np.maximum(detour, 0.0)
        sums = np.bincount(self.sources, np.exp(utility), minlength=self.states)
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(usable, utility - np.log(sums)[self.sources], -np.inf))

    def walk(
        self,
        log_p: FloatArray,
        origins: IndexArray,
        destination: int,
        rng: np.random.Generator,
        table: FloatArray | None = None,
    ) -> Walks:
        """Independent paths, one from each of `origins`.

        Args:
            log_p: (A,) from `log_step_probabilities` of the same destination.
            origins: (W,) states, as often as a path from each is wanted.
            destination: a state.
            rng: source of chance.
            table: `cumulative(log_p)`, if it is at hand.

        Raises:
            ArgumentError: there is no way, or a walk does not come to an end.
        """
        table, count = self.cumulative(log_p) if table is None else table, len(origins)
        state = np.array(origins, dtype=np.intp)
        walking = np.arange(count)
        log_density = np.zeros(count)
        steps: list[IndexArray] = []
        while len(walking):
            if len(steps) == MOST_STEPS or not table[state, -1].all():
                lost = origins[walking[np.argmin(table[state, -1])]]
                raise ArgumentError(f"a walk from state {lost} does not reach state {destination}; raise the bias.")
            way = (rng.random(len(walking))[:, None] >= table[state]).sum(axis=1)
            step = self.first[state] + np.minimum(way, self.ways_out[state] - 1)
            column = np.full(count, END, dtype=np.intp)
            column[walking] = step
            steps.append(column)
            log_density[walking] += log_p[step]
            state = self.targets[step]
            going = state != destination
            walking, state = walking[going], state[going]
        return Walks(np.stack(steps, axis=1), log_density)

    def cumulative(self, log_p: FloatArray) -> FloatArray:
        """(states, most ways out) cumulative probabilities of the steps out of each state, the last ones 1."""
        way = np.arange(len(log_p)) - self.first[self.sources]
        table = np.zeros((self.states, int(self.ways_out.max())))
        table[self.sources, way] = np.exp(log_p)
        np.cumsum(table, axis=1, out=table)
        reached = table[:, -1] > 0.5
        table[reached] /= table[reached, -1:]
        return table
