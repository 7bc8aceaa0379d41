"""Paths drawn for one trip, and the choice set that they make together with the path that was taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pipeline.arrays import FloatArray, IndexArray, IntArray
from pipeline.studies.trips.roads import Roads
from pipeline.trajectories.network_walks import END
from pipeline.trajectories.random_streams import child_rng


@dataclass(frozen=True)
class Sampler:
    """A random walk: how much of each feature a step costs it, and how strongly it avoids cost."""

    costs: tuple[float, float, float, float]
    bias: float


SAMPLERS: Mapping[str, Sampler] = MappingProxyType(
    {
        "fast": Sampler((1.0, 0.0, 0.0, 0.5), 5.0),
        "wide": Sampler((1.0, 0.0, 0.0, 0.5), 2.5),
        "few-links": Sampler((0.2, 0.1, 0.4, 0.5), 3.0),
    }
)


@dataclass(frozen=True)
class PathSet:
    """Distinct paths of one trip.

    Attributes:
        steps: (N, T) numbers of the steps, in order; `END` after the last one.
        features: (N, 4) totals over each path.
        links: (N, E) how often each path enters each link.
        log_q: (N,) log probability that one draw of the sampler is this path.
        drawn: (N,) how often it was drawn, the path that was taken once more.
        chosen: row of the path that was taken.
    """

    steps: IndexArray
    features: FloatArray
    links: sparse.csr_array
    log_q: FloatArray
    drawn: IntArray
    chosen: int


@dataclass(frozen=True)
class Way:
    """The steps of a sampler to one destination.

    Attributes:
        log_p: (A,) log probability of each step.
        table: of the same, as `Network.walk` takes it.
    """

    log_p: FloatArray
    table: FloatArray

    @classmethod
    def of(cls, roads: Roads, sampler: Sampler, destination: int) -> Way:
        """To `destination`, a link."""
        cost = roads.features @ np.array(sampler.costs)
        log_p = roads.network.log_step_probabilities(cost, destination, sampler.bias)
        return cls(log_p, roads.network.cumulative(log_p))


@dataclass(frozen=True)
class Draws:
    """What a sampler drew for one trip, with the path taken in the first row; sets of any size are made of it.

    Attributes:
        steps: (W + 1, T) as in `PathSet`.
        features: (W + 1, 4) totals over each path.
        log_q: (W + 1,) log probability of each under the sampler.
        labels: (W + 1,) numbers that are the same for the same paths.
        targets: (A,) link that each step enters.
    """

    steps: IndexArray
    features: FloatArray
    log_q: FloatArray
    labels: IndexArray
    targets: IndexArray

    def first(self, count: int) -> PathSet:
        """The set of the first `count` paths drawn, and of the path taken."""
        _, rows, drawn = np.unique(self.labels[: count + 1], return_index=True, return_counts=True)
        order = np.argsort(rows)  # the path taken first
        rows, drawn = rows[order], drawn[order].astype(np.int64)
        steps = self.steps[rows]
        return PathSet(steps, self.features[rows], _links(steps, self.targets), self.log_q[rows], drawn, 0)


def draw(roads: Roads, index: int, way: Way, count: int, seed: int, labels: tuple[str | int, ...]) -> Draws:
    """`count` paths for a trip.

    Args:
        roads: the network and the trips.
        index: of the trip in `roads`.
        way: of the sampler, to the trip's destination.
        count: how many are drawn.
        seed, labels: of the stream of random numbers.
    """
    path = roads.paths[index]
    rng = child_rng(seed, "trips", *labels, roads.trips[index])
    origins = np.full(count, roads.origins[index])
    walks = roads.network.walk(way.log_p, origins, int(roads.destinations[index]), rng, way.table)
    steps = np.full((count + 1, max(walks.steps.shape[1], len(path))), END, dtype=np.intp)
    steps[0, : len(path)] = path
    steps[1:, : walks.steps.shape[1]] = walks.steps
    log_q = np.append(way.log_p[path].sum(), walks.log_density)
    return Draws(steps, _totals(roads, steps), log_q, _labels(steps), roads.network.targets)


def _labels(steps: IndexArray) -> IndexArray:
    """(W,) a number for each row that is the same for the same steps in the same order."""
    hashes = _hashes(int(steps.max()) // 1024 * 1024 + 1024)
    labels = np.zeros(len(steps), dtype=np.uint64)
    for column in steps.T:
        label = labels * np.uint64(6364136223846793005) + hashes[np.maximum(column, 0)]
        labels = np.where(column == END, labels, label)
    return labels.astype(np.intp)


@cache
def _hashes(count: int) -> NDArray[np.uint64]:
    return np.random.Generator(np.random.PCG64(0)).integers(0, 2**63, count, dtype=np.uint64)


def _totals(roads: Roads, steps: IndexArray) -> FloatArray:
    totals = np.zeros((len(steps), roads.features.shape[1]))
    padded = np.vstack([roads.features, np.zeros(roads.features.shape[1])])  # END is the last row
    for column in steps.T:
        totals += padded[column]
    return totals


def _links(steps: IndexArray, targets: IndexArray) -> sparse.csr_array:
    taken = steps != END
    rows = np.repeat(np.arange(len(steps)), taken.sum(axis=1))
    used, columns = np.unique(targets[steps[taken]], return_inverse=True)
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(steps), len(used)))
