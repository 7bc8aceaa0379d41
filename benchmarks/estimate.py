"""What a thousand million alternatives would take on a cluster, in Markdown: `python -m benchmarks.estimate`.

Nothing is measured here: unit costs come from benchmarks/results, where the benchmarks `density`, `replay` and `tables`
keep them. Parts, grids and bandwidths are those that the program plans for such a set with three clustered features.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.explained import explain
from benchmarks.measuring import clustered, recorded
from pipeline.choice.kernel import cost_model
from pipeline.choice.kernel.fourier import Grid
from pipeline.choice.kernel.pairwise import LEAF, cut_off
from pipeline.choice.kernel.row_sample import RowsInMemory
from pipeline.choice.kernel.sampled_sums import SCORE_ERROR
from pipeline.choice.kernel.subsampled_likelihood import SampledScore
from pipeline.choice.kernel.unique_rows import distinct_rows
from pipeline.choice.streaming import sketch_slabs
from pipeline.formats.parquet.partitions import PARTITIONS

COUNT, CORES, PARTITION, MEMORY_GB = 10**9, 512, 200_000, 14
WAYPOINTS, HYPOTHESES = 41, 171
NETWORK, DISK = 1e9, 10e9  # bytes per second: network of one machine, and the disk that all share
ROWS = PARTITIONS * PARTITION  # rows in a part
PARTS = COUNT // ROWS
SCORED, QUARTER = 4000, 1000  # rows that are scored, and those that are scored first
TABLES = ("alternatives", "features", "densities")
# How often the processes of featurize, density and infer read the keys of each table, apart from their workers: each
# stage reads them once to check them, and density once more to copy them into its table.
READ = {"alternatives": 1, "features": 3, "densities": 1}
EACH = ROWS * -(-PARTS // CORES)  # rows that one core processes
EVERY, ALONE = "each core", "the stage"
WIDEST = 0.075  # the bandwidth that is tried first: about sqrt(2) times the best for 1000 rows
SIGMA = 0.0207 / (COUNT / 1e6) ** (1 / 7)  # the selected bandwidth, which narrows with the seventh root of the number
Costs = Mapping[str, float]


@dataclass(frozen=True)
class Step:
    """A line of the table: what is done, by each core or by the stage alone, the arithmetic, and the seconds."""

    name: str
    who: str
    arithmetic: str
    seconds: float


class Million(RowsInMemory):
    """A million rows that represent all rows."""

    parts, memory_bytes = PARTS, MEMORY_GB * 1e9

    def __init__(self, rows: np.ndarray) -> None:
        super().__init__(distinct_rows(rows))
        self.total = self.distinct = COUNT
        # in three dimensions, squared distances to nearest rows shrink with the power 2/3 of the number of rows
        self.drawn = replace(self.drawn, nearest=self.drawn.nearest * (len(rows) / COUNT) ** (2 / 3))


@dataclass(frozen=True)
class Planned:
    """What the program plans for such a set.

    Attributes:
        rows: a million rows that represent all rows.
        grid: grid of the sketch for the densities.
        search: grid of the sketch for the search of the bandwidth.
    """

    rows: np.ndarray
    grid: Grid
    search: Grid

    @classmethod
    def by_the_program(cls, rows: np.ndarray) -> Planned:
        """Let the program plan both grids."""
        slabs = sketch_slabs(rows.min(axis=0).tolist(), rows.max(axis=0).tolist(), SIGMA, COUNT, ROWS, MEMORY_GB * 1e9)
        if slabs is None or len(slabs) > 1:
            raise SystemExit("the estimate is for one slab")
        first = SampledScore(Million(rows)).first_plan()
        if first is None:
            raise SystemExit("no sketch is planned")
        return cls(rows, slabs[0].grid, first.grid)

    def serves(self, sigma: float) -> bool:
        """Whether the sketch of the search has all modes that this bandwidth needs."""
        lower, upper = self.rows.min(axis=0).tolist(), self.rows.max(axis=0).tolist()
        needed = Grid.covering(lower, upper, sigma, WIDEST, COUNT, SCORE_ERROR).modes
        return all(mode <= largest for mode, largest in zip(needed, self.search.modes, strict=True))


def drawing(costs: Costs) -> list[Step]:
    """Sampling the alternatives and computing their features."""
    draw = costs["drawing, mixture, us per trajectory"]
    replay = costs["replay and 3 features, us per configuration, one core"]
    return [
        Step("sampling", EVERY, f"{draw:.3g} us x {EACH:,}", draw * EACH * 1e-6),
        Step("replay, features", EVERY, f"{replay:.3g} us x {WAYPOINTS} x {EACH:,}", replay * WAYPOINTS * EACH * 1e-6),
    ]


def searching(planned: Planned, costs: Costs) -> list[Step]:
    """Selecting the bandwidth: ten are tried on a quarter of the scored rows, four on all of them."""
    first = [WIDEST / 2 ** (step / 2) for step in range(10)]
    finest = [SIGMA * math.exp(step) for step in (0.15, 0.05, -0.05, -0.15)]
    by_sketch = [sigma for sigma in first + finest if planned.serves(sigma)]
    first_by_neighbours = [sigma for sigma in first if not planned.serves(sigma)]
    finest_by_neighbours = [sigma for sigma in finest if not planned.serves(sigma)]
    sketch, point = costs["sketch, us per row beside the grid"], costs["grid of a transform, ns per point"] * 1e-9
    grid_s = planned.search.oversampled(ROWS) * point
    two_fit = 2 * cost_model.transform_bytes(planned.search, SCORED) <= MEMORY_GB * 1e9
    sums_s = sum(planned.search.cropped(sigma).oversampled(SCORED) * point for sigma in by_sketch) / (1 + two_fit)
    distances = cost_model.some_distances(distinct_rows(planned.rows).rows)
    neighbours_s = neighbours_seconds(distances, first_by_neighbours, QUARTER)
    neighbours_s += neighbours_seconds(distances, finest_by_neighbours, SCORED)
    arithmetic = f"{sketch:.3g} us x {EACH:,} + grid {grid_s:.3g} s"
    narrow = len(first_by_neighbours) + len(finest_by_neighbours)
    return [
        Step("sketch for the bandwidth", EVERY, arithmetic, sketch * EACH * 1e-6 + grid_s),
        Step(f"{len(by_sketch)} bandwidths by it{', two at a time' if two_fit else ''}", ALONE, "grids", sums_s),
        Step(f"{narrow} by neighbours", EVERY, "predicted", neighbours_s),
    ]


def neighbours_seconds(distances: np.ndarray, sigmas: list[float], points: int) -> float:
    """Predicted seconds for one part, for several bandwidths at this many points."""
    if not sigmas:
        return 0.0
    share = cost_model.share_compared(distances, cut_off(COUNT, max(sigmas), SCORE_ERROR), LEAF / ROWS)
    return cost_model.pass_seconds(np.array([points] * len(sigmas)), share * ROWS)


def summing(planned: Planned, costs: Costs) -> list[Step]:
    """Computing the kernel sums at all rows."""
    sketch, back = costs["sketch, us per row beside the grid"], costs["density at rows, us per row beside the grid"]
    grid_s = planned.grid.oversampled(ROWS) * costs["grid of a transform, ns per point"] * 1e-9
    size, smaller = (16.0 * math.prod(grid.shape) for grid in (planned.grid, planned.search))
    rounds = math.ceil(math.log2(PARTS))
    return [
        Step("sketch", EVERY, f"{sketch:.3g} us x {EACH:,} + grid {grid_s:.3g} s", sketch * EACH * 1e-6 + grid_s),
        Step(
            f"adding up {PARTS} sketches, twice", EVERY,
            f"{rounds} rounds of {(size + smaller) / 1e6:,.0f} MB at {NETWORK / 1e9:g} GB/s",
            rounds * (size + smaller) / NETWORK,
        ),
        Step(
            "reading the sketch", EVERY, f"{PARTS} x {size / 1e6:,.0f} MB at {DISK / 1e9:g} GB/s for all",
            PARTS * size / DISK,
        ),
        Step(
            "density at all rows", EVERY, f"{back:.3g} us x {EACH:,} + grid {grid_s:.3g} s", back * EACH * 1e-6 + grid_s
        ),
    ]  # fmt: skip


def inferring_and_storing(costs: Costs) -> list[Step]:
    """Computing the posterior, and reading and writing the tables of all stages."""
    posterior = costs["posterior, 20 demonstrations, ns per row and hypothesis"]
    keys = sum(times * costs[f"{name}, keys read, us per row"] for name, times in READ.items())
    written = {name: costs[f"{name}, written, us per row"] for name in TABLES}
    return [
        Step("posterior", EVERY, f"{posterior:.3g} ns x {HYPOTHESES} x {EACH:,}", posterior * HYPOTHESES * EACH * 1e-9),
        Step("keys of all rows, by all stages", ALONE, f"{keys:.3g} us x 1e9", keys * 1e-6 * COUNT),
        *(
            Step(f"writing {name}", ALONE, f"{took:.3g} us x 1e9", took * 1e-6 * COUNT)
            for name, took in written.items()
        ),
    ]


def main() -> None:
    costs = {**recorded("replay"), **recorded("tables"), **recorded("density")}
    planned = Planned.by_the_program(clustered(1_000_000))
    steps = [*drawing(costs), *searching(planned, costs), *summing(planned, costs), *inferring_and_storing(costs)]
    sums = [
        Step(f"all of {who}", "", "", sum(step.seconds for step in steps if step.who == who)) for who in (EVERY, ALONE)
    ]
    print("| step | on | what | seconds |\n|---|---|---|---|")
    for step in [*steps, *sums]:
        print(f"| {step.name} | {step.who} | {step.arithmetic} | {step.seconds:,.0f} |")
    stored = sum(costs[f"{name}, bytes per row"] for name in TABLES) * COUNT
    grid, search = (" x ".join(map(str, each.shape)) for each in (planned.grid, planned.search))
    print(
        f"\n{COUNT:.0e} alternatives, {stored / 1e12:.2g} TB of tables, compute.partition {PARTITION:,}, "
        f"compute.memory_gb {MEMORY_GB}, {CORES} cores; bandwidth {SIGMA:.4f}, grid {grid} of "
        f"{planned.grid.oversampled(ROWS) * 16 / 1e9:.1f} GB oversampled, that of the search {search}; unit "
        f"costs of {costs['date']}, {costs['machine']}"
    )


if __name__ == "__main__":
    explain(__doc__)
    main()
