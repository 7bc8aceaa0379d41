"""The choice sets of all trips under each sampler, ready for estimation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.choice import select_bandwidth
from pipeline.choice.conditional_logit import ChoiceSets
from pipeline.errors import BandwidthError
from pipeline.studies.trips.drawn_paths import SAMPLERS, PathSet, draw, step_log_probabilities
from pipeline.studies.trips.path_models import (
    BY_SET,
    OWN_FEATURE,
    Kernels,
    log_weights,
    own_feature,
    within_spread,
)
from pipeline.studies.trips.roads import Roads

_Part: TypeAlias = tuple[FloatArray, dict[str, FloatArray], dict[str, FloatArray]]
PILOT = 60  # about how many trips the scale and the bandwidth are taken from
LARGEST_PILOT = 500  # paths of one trip


@dataclass(frozen=True)
class Drawn:
    """The sets of one sampler.

    Attributes:
        features: (N, 4) of all paths, set after set.
        sizes: (n,) of the sets; the first path of each was taken.
        own: (N,) by model, for models with a feature of their own.
        log_w: (N,) by model.
    """

    features: FloatArray
    sizes: IntArray
    own: Mapping[str, FloatArray]
    log_w: Mapping[str, FloatArray]

    def sets(self, model: str) -> ChoiceSets:
        """The sets as the model sees them."""
        starts = np.append(0, np.cumsum(self.sizes)[:-1])
        features = self.features
        if model in self.own:
            features = np.column_stack([features, self.own[model]])
        return ChoiceSets(features, starts, starts)


def draw_all(roads: Roads, size: int, sampling: int, seed: int) -> dict[str, Drawn]:
    """The sets of all trips under every sampler, for one sampling.

    Trips are drawn one after another. What stays is six numbers a path beside its features, not its links.

    Args:
        roads: the network and the trips.
        size: draws for each trip.
        sampling: number of the sampling; another one has other draws.
        seed: of the project.
    """
    kernels = pilot(roads, size, sampling, seed)
    rows: dict[str, dict[int, _Part]] = {name: {} for name in SAMPLERS}
    for index, sets in drawn_sets(roads, size, sampling, seed, _by_destination(roads)):
        pool = pooled(sets)
        for name, paths in sets.items():
            own = {model: own_feature(model, paths) for model in OWN_FEATURE}
            rows[name][index] = (paths.features, own, {m: log_weights(m, paths, pool, kernels) for m in BY_SET})
    return {name: _joined([part for _, part in sorted(parts.items())]) for name, parts in rows.items()}


def pilot(roads: Roads, size: int, sampling: int, seed: int) -> Kernels:
    """Scale and bandwidth, the same for all samplers: from what all of them draw for some of the trips.

    The scale is the spread within trips, the bandwidth the median of those that leave-one-out selects for each trip.
    """
    some = _by_destination(roads)[:: max(len(roads.trips) // PILOT, 1)]
    pools = [_some(pooled(sets)) for _, sets in drawn_sets(roads, size, sampling, seed, some)]
    scale = within_spread(np.concatenate(pools), np.array([len(pool) for pool in pools]))
    bandwidths = []
    for pool in pools:
        try:
            bandwidths.append(select_bandwidth(pool / scale).value)
        except BandwidthError:  # one path only
            continue
    return Kernels(scale, float(np.median(bandwidths)) if bandwidths else 1.0)


def drawn_sets(
    roads: Roads, size: int, sampling: int, seed: int, trips: Sequence[int]
) -> Iterator[tuple[int, dict[str, PathSet]]]:
    """What each sampler draws for some trips, given by their places in `roads`.

    Trips that follow one another to the same destination share the probabilities of its steps.
    """
    known: dict[int, dict[str, FloatArray]] = {}
    for index in trips:
        end = int(roads.destinations[index])
        if end not in known:
            known = {end: {name: step_log_probabilities(roads, one, end) for name, one in SAMPLERS.items()}}
        labels = {name: (name, size, sampling) for name in SAMPLERS}
        yield index, {n: draw(roads, index, known[end][n], size, seed, labels[n]) for n in SAMPLERS}


def pooled(sets: Mapping[str, PathSet]) -> FloatArray:
    """(P, 4) features of all sets together; the path that was taken, which is in each of them, stands once."""
    taken = next(iter(sets.values())).features[:1]
    return np.concatenate([taken, *(paths.features[1:] for paths in sets.values())])


def _by_destination(roads: Roads) -> list[int]:
    return [int(index) for index in np.argsort(roads.destinations, kind="stable")]


def _some(pool: FloatArray) -> FloatArray:
    """The pool, or evenly chosen rows of a large one."""
    return pool[:: -(-len(pool) // LARGEST_PILOT)]


def _joined(parts: list[_Part]) -> Drawn:
    return Drawn(
        np.concatenate([features for features, _, _ in parts]),
        np.array([len(features) for features, _, _ in parts]),
        {model: np.concatenate([own[model] for _, own, _ in parts]) for model in OWN_FEATURE},
        {model: np.concatenate([log_w[model] for _, _, log_w in parts]) for model in BY_SET},
    )
