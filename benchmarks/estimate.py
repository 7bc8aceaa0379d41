"""What a thousand million alternatives would take on a cluster: `python -m benchmarks.estimate`, a table in Markdown.

Nothing is measured here: unit costs come from benchmarks/results, where the commands `density`, `replay` and `tables` of this folder
keep them. Parts, grids and bandwidths are those that the program itself plans for such a set, of three clustered features.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.measuring import clustered, known
from pipeline.choice.kernel import cost_model
from pipeline.choice.kernel.fourier import Grid
from pipeline.choice.kernel.pairwise import LEAF, cut_off
from pipeline.choice.kernel.subsampled_likelihood import SCORE_ERROR, Drawn, SampledScore, Whole
from pipeline.choice.kernel.unique_rows import distinct_rows
from pipeline.choice.streaming import sketch_slabs
from pipeline.formats.parquet.partitions import PARTITIONS

COUNT, CORES, PARTITION, MEMORY_GB = 10**9, 512, 200_000, 14
WAYPOINTS, HYPOTHESES = 41, 171
NETWORK, DISK = 1e9, 10e9  # bytes a second, of a machine and of the disk that all share
ROWS = PARTITIONS * PARTITION  # of a part
PARTS = COUNT // ROWS
SCORED, SOME = 4000, 1000  # rows that are scored, and those that say about where
TABLES = ("alternatives", "features", "densities")
# how often the stages read the keys of each table, all together: calls of `read_part` by featurize, density and infer, counted
READ = {"alternatives": 1, "features": 5, "densities": 4}
EVERY, ALONE = "each core", "the stage"


class Planned(Exception):
    """The grid of the sketch that a search for the bandwidth asks for first."""


class Million(Whole):
    """A million rows that stand for all."""

    parts, memory_bytes = PARTS, MEMORY_GB * 1e9

    def __init__(self, rows: np.ndarray) -> None:
        super().__init__(distinct_rows(rows))
        self.total = self.distinct = COUNT
        drawn, nearer = self.drawn, (len(rows) / COUNT) ** (2 / 3)  # squared distances in three dimensions
        self.drawn = Drawn(drawn.first, drawn.first_counts, drawn.rows, drawn.often, drawn.own, drawn.nearest * nearer)

    def sketch(self, grid: Grid) -> Any:
        """None is made."""
        raise Planned(grid)


def planned_search(rows: np.ndarray) -> Grid:
    """The grid that the bandwidth's likelihood is looked for with."""
    try:
        SampledScore(Million(rows)).maximum()
    except Planned as planned:
        return planned.args[0]  # type: ignore[no-any-return]
    raise SystemExit("no sketch is planned")


def main() -> None:
    costs = {**known("replay"), **known("tables"), **known("density")}
    rows = clustered(1_000_000)
    lower, upper = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
    # from a million on, the selected bandwidth narrows with the seventh root
    sigma = 0.0207 / (COUNT / 1e6) ** (1 / 7)
    slabs = sketch_slabs(lower, upper, sigma, COUNT, ROWS, MEMORY_GB * 1e9)
    if slabs is None or len(slabs) > 1:
        raise SystemExit("the estimate is for one slab")
    grid, scored, each = slabs[0].grid, planned_search(rows), ROWS * -(-PARTS // CORES)
    widest = 0.075  # about sqrt(2) times the best of 1000 rows
    tried = [widest / 2 ** (step / 2) for step in range(10)]
    finest = [sigma * math.exp(step) for step in (0.15, 0.05, -0.05, -0.15)]

    def served(one: float) -> bool:
        needed = Grid.covering(lower, upper, one, widest, COUNT, SCORE_ERROR).modes
        return all(mode <= known_mode for mode, known_mode in zip(needed, scored.modes, strict=True))

    wide, narrow = [one for one in tried + finest if served(one)], [one for one in tried if not served(one)]
    both = 2 * cost_model.transform_bytes(scored, SCORED) <= MEMORY_GB * 1e9
    distances = cost_model.some_distances(distinct_rows(rows).rows)

    def by_neighbours(sigmas: list[float], points: int) -> float:
        """Seconds of one part."""
        if not sigmas:
            return 0.0
        share = cost_model.share_compared(distances, cut_off(COUNT, max(sigmas), SCORE_ERROR), LEAF / ROWS)
        return cost_model.pass_seconds(np.array([points] * len(sigmas)), share * ROWS)

    lonely = by_neighbours(narrow, SOME) + by_neighbours([one for one in finest if not served(one)], SCORED)
    point = costs["grid of a transform, ns per point"] * 1e-9
    fft, smaller = grid.oversampled(ROWS) * point, scored.oversampled(ROWS) * point
    summed = sum(scored.cropped(one).oversampled(SCORED) * point for one in wide) / (2 if both else 1)
    size, smaller_size = (16.0 * math.prod(of.shape) for of in (grid, scored))
    rounds = math.ceil(math.log2(PARTS))
    sketch, back = costs["sketch, us per row beside the grid"], costs["density at rows, us per row beside the grid"]
    draw, replay = (
        costs["drawing, mixture, us per trajectory"],
        costs["replay and 3 features, us per configuration, one core"],
    )
    posterior = costs["posterior, 20 demonstrations, ns per row and hypothesis"]
    keys = sum(times * costs[f"{name}, keys read, us per row"] for name, times in READ.items())
    steps = [
        ("sampling", EVERY, f"{draw:.3g} us x {each:,}", draw * each * 1e-6),
        ("replay, features", EVERY, f"{replay:.3g} us x {WAYPOINTS} x {each:,}", replay * WAYPOINTS * each * 1e-6),
        (
            "sketch for the bandwidth", EVERY, f"{sketch:.3g} us x {each:,} + grid {smaller:.3g} s",
            sketch * each * 1e-6 + smaller,
        ),
        (f"{len(wide)} bandwidths by it{', two at a time' if both else ''}", ALONE, "grids", summed),
        (f"{len(tried + finest) - len(wide)} by neighbours", EVERY, "predicted", lonely),
        ("sketch", EVERY, f"{sketch:.3g} us x {each:,} + grid {fft:.3g} s", sketch * each * 1e-6 + fft),
        (
            f"adding up {PARTS} sketches, twice", EVERY,
            f"{rounds} rounds of {(size + smaller_size) / 1e6:,.0f} MB at {NETWORK / 1e9:g} GB/s",
            rounds * (size + smaller_size) / NETWORK,
        ),
        (
            "reading the sketch", EVERY, f"{PARTS} x {size / 1e6:,.0f} MB at {DISK / 1e9:g} GB/s for all", PARTS * size / DISK,
        ),
        ("density at all rows", EVERY, f"{back:.3g} us x {each:,} + grid {fft:.3g} s", back * each * 1e-6 + fft),
        ("posterior", EVERY, f"{posterior:.3g} ns x {HYPOTHESES} x {each:,}", posterior * HYPOTHESES * each * 1e-9),
        ("keys of all rows, by all stages", ALONE, f"{keys:.3g} us x 1e9", keys * 1e-6 * COUNT),
    ]  # fmt: skip
    for name in TABLES:
        took = costs[f"{name}, written, us per row"]
        steps.append((f"writing {name}", ALONE, f"{took:.3g} us x 1e9", took * 1e-6 * COUNT))
    print("| step | on | what | seconds |\n|---|---|---|---|")
    sums = [(f"all of {who}", "", "", sum(took for _, by, _, took in steps if by == who)) for who in (EVERY, ALONE)]
    for step, by, arithmetic, took in [*steps, *sums]:
        print(f"| {step} | {by} | {arithmetic} | {took:,.0f} |")
    stored = sum(costs[f"{name}, bytes per row"] for name in TABLES) * COUNT
    print(
        f"\n{COUNT:.0e} alternatives, {stored / 1e12:.2g} TB of tables, compute.partition {PARTITION:,}, compute.memory_gb "
        f"{MEMORY_GB}, {CORES} cores; bandwidth {sigma:.4f}, grid {' x '.join(map(str, grid.shape))} of "
        f"{grid.oversampled(ROWS) * 16 / 1e9:.1f} GB oversampled, that of the search {' x '.join(map(str, scored.shape))}; unit "
        f"costs of {costs['date']}, {costs['machine']}"
    )


if __name__ == "__main__":
    main()
