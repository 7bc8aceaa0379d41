"""Quality-diversity search: fill a map of the feature space from seeds, rarely visited cells first.

Source: Mouret and Clune, "Illuminating search spaces by mapping elites", arXiv 1504.04909; parents by few visits as in
the curiosity and count-based selections that Cully and Demiris compare (IEEE Trans. Evolutionary Computation, 2018).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.trajectories.exploration.archive import Archive, Cells
from pipeline.trajectories.exploration.choice_space import ChoiceSpace
from pipeline.trajectories.exploration.variation import Variation

Interest = Callable[[FloatArray], FloatArray]
"""(N, F) features to (N,) positive weights: how much a cell matters to whoever asks."""

BATCH = 2000
USUAL = Variation()
_INTEREST_EVERY = 25  # batches between two evaluations of the interest, unless the map has grown by a tenth
_GROWN = 1.1


@dataclass(frozen=True)
class Growth:
    """The map after some evaluations: cells reached, and the share of children that were members of the space."""

    evaluations: int
    cells: int
    admitted: float


@dataclass(frozen=True, eq=False)
class Exploration:
    """A covered feature space.

    Attributes:
        archive: its elites.
        growth: how it grew, one entry after each batch.
    """

    archive: Archive
    growth: tuple[Growth, ...]

    @property
    def evaluations(self) -> int:
        """Trajectories looked at."""
        return self.growth[-1].evaluations

    @property
    def growth_at_last_doubling(self) -> float:
        """New cells of the second half of the evaluations, as a share of all."""
        half = [entry.cells for entry in self.growth if 2 * entry.evaluations <= self.evaluations]
        return 1 - half[-1] / self.growth[-1].cells if half else 1.0

    def merged(self, *others: Exploration) -> Exploration:
        """Islands over the same cells as one exploration."""
        parts = (self, *others)
        archive = self.archive.merged(*(other.archive for other in others))
        evaluations = sum(part.evaluations for part in parts)
        admitted = sum(part.evaluations * part.growth[-1].admitted for part in parts) / evaluations
        return Exploration(archive, (Growth(evaluations, len(archive), admitted),))


def explore(
    space: ChoiceSpace,
    seeds: FloatArray,
    rng: np.random.Generator,
    evaluations: int,
    cells: Cells,
    *,
    interest: Interest | None = None,
    variation: Variation = USUAL,
    start: Exploration | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Exploration:
    """Cover what the space can reach.

    Half of the parents are drawn with a chance proportional to (1 + visits)^-1/2, so that the search goes where it has
    been least. Where `interest` is given, the other half are drawn with a chance that is also proportional to its root.

    Args:
        space: the choice space.
        seeds: (N, K, J) coefficients to begin with; those outside the space are left out.
        rng: the stream of this exploration; equal streams and arguments give equal maps.
        evaluations: trajectories to look at, seeds included; rounded up to whole batches of 2,000.
        cells: how feature space is cut.
        interest: see above.
        variation: how children are made.
        start: an exploration over the same cells to go on with, which is changed; `evaluations` counts its own too.
        progress: called with (evaluations so far, cells so far) after each batch.

    Raises:
        ArgumentError: no seed is a member of the space.
    """
    features, inside = space.evaluate(seeds)
    if not inside.any():
        raise ArgumentError(
            f"seeds has {len(seeds)} trajectories and none is in the choice space; raise its effort bound."
        )
    archive = Archive(cells, (space.modes, space.joints), features.shape[1]) if start is None else start.archive
    archive.add(seeds[inside], features[inside])
    growth = [] if start is None else list(start.growth)
    done, admitted, weights = len(seeds), float(inside.sum()), np.empty(0)
    if start is not None:
        done, admitted = done + start.evaluations, admitted + start.evaluations * growth[-1].admitted
    growth.append(Growth(done, len(archive), admitted / done))
    for batch in range(max(0, -(-(evaluations - done) // BATCH))):
        if interest is not None and (batch % _INTEREST_EVERY == 0 or len(archive) > _GROWN * len(weights)):
            weights = np.sqrt(interest(archive.features))
        parents = _parents(rng, archive, weights)
        others = archive.z[rng.integers(len(archive), size=(3, BATCH))]
        children = variation.children(rng, archive.z[parents], others, space.width_rad)
        features, inside = space.evaluate(children)
        archive.add(children[inside], features[inside])
        done, admitted = done + BATCH, admitted + float(inside.sum())
        growth.append(Growth(done, len(archive), admitted / done))
        if progress is not None:
            progress(done, len(archive))
    return Exploration(archive, tuple(growth))


def _parents(rng: np.random.Generator, archive: Archive, weights: FloatArray) -> NDArray[np.intp]:
    """(BATCH,) rows of the archive; those that have joined since `weights` were computed wait for the next."""
    rare = 1 / np.sqrt(1 + archive.visits)
    if not len(weights):
        return _drawn(rng, rare, BATCH)
    wanted = rare[: len(weights)] * weights
    return np.concatenate([_drawn(rng, rare, BATCH - BATCH // 2), _drawn(rng, wanted, BATCH // 2)])


def _drawn(rng: np.random.Generator, chances: FloatArray, count: int) -> NDArray[np.intp]:
    total = np.cumsum(chances)
    rows = np.searchsorted(total, rng.random(count) * total[-1], side="right")
    return np.asarray(np.minimum(rows, len(chances) - 1))


def seeds_around(space: ChoiceSpace, waypoints: Sequence[FloatArray]) -> FloatArray:
    """Coefficients (N, K, J) of trajectories (n, T, J) each: samplers' draws, planned optima, demonstrations."""
    return np.concatenate([space.encode(np.asarray(paths, dtype=np.float64)) for paths in waypoints])
