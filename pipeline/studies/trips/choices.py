"""The choice sets of all trips under each sampler, ready for estimation."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain, groupby
from typing import TypeAlias

import numpy as np

from pipeline.arrays import FloatArray, IndexArray, IntArray
from pipeline.choice import select_bandwidth
from pipeline.choice.conditional_logit import ChoiceSets
from pipeline.choice.nested_choice_sets import NestedChoiceSets
from pipeline.choice.nested_logit import nests_of
from pipeline.errors import BandwidthError
from pipeline.studies.trips.drawn_paths import SAMPLERS, PathSet, Way, draw
from pipeline.studies.trips.path_models import (
    BOLTZMANN_CORRECTED,
    CORRECTED,
    LESS,
    LESS_LINKS,
    LESS_POOLED,
    OWN_FEATURE,
    PLAIN,
    Kernels,
    log_weights,
    own_feature,
    within_spread,
)
from pipeline.studies.trips.roads import Roads

Sets: TypeAlias = dict[int, dict[str, PathSet]]
"""What each sampler drew for one trip, by how many draws there are and by sampler."""
PILOT = 60  # about how many trips the scale and the bandwidth are taken from
LARGEST_PILOT = 500  # paths of one trip
NEST_BANDWIDTHS = 2.0  # two paths of a nest are at most so many bandwidths of LESS apart
WORKERS = min(os.cpu_count() or 1, 4)
_AT_ONCE = 4  # destinations whose trips one call draws; Ctrl-C waits for a few of them
_FEW = 200  # trips that are drawn before further processes would have begun
_WEIGHED = (BOLTZMANN_CORRECTED, LESS, LESS_POOLED, LESS_LINKS)


@dataclass(frozen=True)
class Part:
    """The set of one trip, as in `Drawn`; the first path was taken."""

    features: FloatArray
    own: Mapping[str, FloatArray]
    log_w: Mapping[str, FloatArray]
    nests: IndexArray

    @classmethod
    def of(cls, paths: PathSet, pool: FloatArray, kernels: Kernels) -> Part:
        """The set with what the models need of it."""
        return cls(
            paths.features,
            {model: own_feature(model, paths) for model in OWN_FEATURE},
            {model: log_weights(model, paths, pool, kernels) for model in _WEIGHED},
            nests_of(paths.features / kernels.scale, NEST_BANDWIDTHS * kernels.features).index,
        )

    def with_first(self, row: int) -> Part:
        """The same set if another path had been taken."""
        return Part(
            np.roll(self.features, -row, axis=0),
            {model: np.roll(values, -row) for model, values in self.own.items()},
            {model: np.roll(values, -row) for model, values in self.log_w.items()},
            np.roll(self.nests, -row),
        )


@dataclass(frozen=True)
class Drawn:
    """The sets of one sampler.

    Attributes:
        features: (N, 4) of all paths, set after set.
        sizes: (n,) of the sets; the first path of each was taken.
        own: (N,) by model, for models with a feature of their own.
        log_w: (N,) by model; the corrected ones share theirs.
        nests: (N,) number of each path's nest in its set.
    """

    features: FloatArray
    sizes: IntArray
    own: Mapping[str, FloatArray]
    log_w: Mapping[str, FloatArray]
    nests: IndexArray

    def sets(self, model: str) -> ChoiceSets:
        """The sets as the model sees them."""
        starts = np.append(0, np.cumsum(self.sizes)[:-1])
        features = self.features
        if model in self.own:
            features = np.column_stack([features, self.own[model]])
        return ChoiceSets(features, starts, starts)

    def nested(self, model: str) -> NestedChoiceSets:
        """The sets with nests of similar paths."""
        return NestedChoiceSets(self.sets(model), self.nests)

    def log_weights(self, model: str) -> FloatArray:
        """(N,) what the model adds to the utilities."""
        if model in PLAIN:
            return np.zeros(len(self.features))
        return self.log_w[BOLTZMANN_CORRECTED if model in CORRECTED else model]


@dataclass(frozen=True)
class Sampling:
    """One sampling.

    Attributes:
        kernels: by size of the sets.
        drawn: by size and sampler.
    """

    kernels: Mapping[int, Kernels]
    drawn: Mapping[int, Mapping[str, Drawn]]


def drawers(trips: int) -> Executor:
    """What draws the paths of so many trips side by side: processes, because drawing is mostly Python."""
    if trips <= _FEW:
        return ThreadPoolExecutor(1)
    return ProcessPoolExecutor(WORKERS, mp_context=multiprocessing.get_context("spawn"))


def draw_all(roads: Roads, sizes: Sequence[int], sampling: int, seed: int, pool: Executor) -> Sampling:
    """The sets of all trips, by size and sampler, for one sampling.

    The largest sets are drawn, and smaller ones are their first draws. Trips are drawn destination by destination. What
    stays is seven numbers a path beside its features, not its links.

    Args:
        roads: the network and the trips.
        sizes: draws for each trip.
        sampling: number of the sampling; another one has other draws.
        seed: of the project.
        pool: from `drawers`.
    """
    destinations = by_destination(roads, range(len(roads.trips)))
    kernels = pilot(roads, sizes, sampling, seed, pool)
    rows: dict[tuple[int, str], dict[int, Part]] = {(size, name): {} for size in sizes for name in SAMPLERS}
    for found in pool.map(partial(_parts, roads, sampling, seed, kernels), batches(destinations)):
        for size, index, name, part in found:
            rows[size, name][index] = part
    drawn = {
        size: {name: joined([part for _, part in sorted(rows.pop((size, name)).items())]) for name in SAMPLERS}
        for size in sizes
    }
    return Sampling(kernels, drawn)


def batches(destinations: Sequence[list[int]]) -> list[list[list[int]]]:
    """The trips of several destinations each, one after the other."""
    return [list(destinations[first : first + _AT_ONCE]) for first in range(0, len(destinations), _AT_ONCE)]


def _parts(
    roads: Roads, sampling: int, seed: int, kernels: Mapping[int, Kernels], destinations: list[list[int]]
) -> list[tuple[int, int, str, Part]]:
    """By size, trip and sampler, the sets of the trips to some destinations."""
    return [
        (size, index, name, Part.of(paths, pooled(of_size), kernels[size]))
        for trips in destinations
        for index, sets in drawn_sets(roads, list(kernels), sampling, seed, trips)
        for size, of_size in sets.items()
        for name, paths in of_size.items()
    ]


def pilot(roads: Roads, sizes: Sequence[int], sampling: int, seed: int, pool: Executor) -> dict[int, Kernels]:
    """Scale and bandwidth by size, the same for all samplers: from what all of them draw for some of the trips.

    The scale is the spread within trips, the bandwidth the median of those that leave-one-out selects for each trip.
    """
    order = [index for trips in by_destination(roads, range(len(roads.trips))) for index in trips]
    some = by_destination(roads, order[:: max(len(order) // PILOT, 1)])
    found = list(chain(*pool.map(partial(_pools, roads, sizes, sampling, seed), batches(some))))
    return dict(zip(sizes, pool.map(_kernels, ([pools[size] for pools in found] for size in sizes)), strict=True))


def _pools(
    roads: Roads, sizes: Sequence[int], sampling: int, seed: int, destinations: list[list[int]]
) -> list[dict[int, FloatArray]]:
    """For each trip to some destinations, what all samplers draw together, by size."""
    return [
        {size: _some(pooled(of_size)) for size, of_size in sets.items()}
        for trips in destinations
        for _, sets in drawn_sets(roads, sizes, sampling, seed, trips)
    ]


def drawn_sets(
    roads: Roads, sizes: Sequence[int], sampling: int, seed: int, trips: Sequence[int]
) -> Iterator[tuple[int, Sets]]:
    """What each sampler draws for trips to one destination, given by their places in `roads`."""
    end = int(roads.destinations[trips[0]])
    ways = {name: Way.of(roads, sampler, end) for name, sampler in SAMPLERS.items()}
    for index in trips:
        draws = {name: draw(roads, index, way, max(sizes), seed, (name, sampling)) for name, way in ways.items()}
        yield index, {size: {name: drawn.first(size) for name, drawn in draws.items()} for size in sizes}


def pooled(sets: Mapping[str, PathSet]) -> FloatArray:
    """(P, 4) features of all sets together; the path that was taken, which is in each of them, stands once."""
    taken = next(iter(sets.values())).features[:1]
    return np.concatenate([taken, *(paths.features[1:] for paths in sets.values())])


def by_destination(roads: Roads, trips: Sequence[int]) -> list[list[int]]:
    """The trips, given by their places in `roads`, in one list for each destination."""
    order = sorted(trips, key=lambda index: (int(roads.destinations[index]), index))
    return [list(group) for _, group in groupby(order, key=lambda index: int(roads.destinations[index]))]


def _kernels(pools: list[FloatArray]) -> Kernels:
    scale = within_spread(np.concatenate(pools), np.array([len(pool) for pool in pools]))
    bandwidths = []
    for pool in pools:
        try:
            bandwidths.append(select_bandwidth(pool / scale).value)
        except BandwidthError:  # one path only
            continue
    return Kernels(scale, float(np.median(bandwidths)) if bandwidths else 1.0)


def _some(pool: FloatArray) -> FloatArray:
    """The pool, or evenly chosen rows of a large one."""
    return pool[:: -(-len(pool) // LARGEST_PILOT)]


def joined(parts: Sequence[Part]) -> Drawn:
    """The sets of trips one after the other."""
    return Drawn(
        np.concatenate([part.features for part in parts]),
        np.array([len(part.features) for part in parts]),
        {model: np.concatenate([part.own[model] for part in parts]) for model in OWN_FEATURE},
        {model: np.concatenate([part.log_w[model] for part in parts]) for model in _WEIGHED},
        np.concatenate([part.nests for part in parts]),
    )
