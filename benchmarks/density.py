"""Kernel density and its bandwidth against scikit-learn and scipy: `python -m benchmarks.density [--ten-million]`.

The rows have three clustered features, and every case runs in a process of its own. Times are wall-clock seconds,
followed by processor seconds. Ratios are of processor seconds, which other work on the machine disturbs least. From
2.6e5 points on, ours uses two threads for some of its steps, both of which count; the peers use one. Peers that would
run for hours are measured up to 20,000 or 40,000 rows and extrapolated by their growth between the two largest sizes;
the table says so.

The measurements are kept in benchmarks/results/density.json; `--picture FILE` draws it without measuring again, and
`python -m benchmarks.estimate` computes from it what a thousand million alternatives would take.

The peer selects among 20 bandwidths around the best with GridSearchCV: five folds, all rows. Ours has no grid: it
maximises the leave-one-out likelihood of about 4000 rows against all, and returns a standard error.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import gaussian_kde
from sklearn.model_selection import GridSearchCV
from sklearn.neighbors import KernelDensity

from benchmarks.measuring import Growth, Run, clustered, measured, record, recorded, seconds, show
from pipeline.choice import choose_engine, log_density, select_bandwidth
from pipeline.choice.kernel.fourier import Grid, Sketch
from pipeline.choice.log_sum_exp import partial_normaliser

RELATIVE = 1e-6  # tolerance given to scikit-learn
BANDWIDTHS = 20
SIGMA = 0.05
OURS, SEARCH, ITS_DENSITY, SCIPY = (
    "ours, bandwidth and density", "scikit-learn, 20 bandwidths and density", "scikit-learn, density", "scipy, density",
)  # fmt: skip


def clocked(function: Callable[..., Any], *args: Any, **options: Any) -> tuple[float, float, Any]:
    """Seconds, processor seconds of all threads, and result of one call."""
    wall, processor = time.perf_counter(), time.process_time()
    result = function(*args, **options)
    return time.perf_counter() - wall, time.process_time() - processor, result


def density(count: int, sigma: float, engine: str = "auto") -> tuple[float, object]:
    rows = clustered(count)
    wall, processor, values = clocked(log_density, rows, sigma, engine=engine)
    chosen = choose_engine(rows, sigma).engine if engine == "auto" else engine
    return wall, (processor, chosen, worst_error(rows, sigma, values))


def select_then_density(count: int) -> tuple[float, object]:
    rows = clustered(count)
    selecting, processor, bandwidth = clocked(select_bandwidth, rows)
    wall, more, values = clocked(log_density, rows, bandwidth.value)
    return selecting + wall, (processor + more, bandwidth, selecting, worst_error(rows, bandwidth.value, values))


def worst_error(rows: np.ndarray, sigma: float, values: np.ndarray) -> float:
    """Largest relative error of the sums at 300 random rows against direct sums."""
    picked = np.random.default_rng(1).choice(len(rows), 300, replace=False)
    sums = np.array([np.exp(-0.5 * ((rows - rows[i]) ** 2).sum(axis=1) / sigma**2).sum() for i in picked])
    return float(np.abs(np.exp(values[picked]) / sums - 1).max())


def scikit_density(count: int, sigma: float) -> tuple[float, object]:
    rows = clustered(count)
    return _peer(lambda: KernelDensity(bandwidth=sigma, rtol=RELATIVE).fit(rows).score_samples(rows).sum())


def scikit_search(count: int, sigma: float) -> tuple[float, object]:
    """Twenty bandwidths around `sigma`, five folds, refitted; then the density of all rows."""
    rows = clustered(count)
    grid = {"bandwidth": sigma * np.geomspace(0.2, 5, BANDWIDTHS)}

    def search() -> float:
        fitted = GridSearchCV(KernelDensity(rtol=RELATIVE), grid, cv=5).fit(rows)
        return float(fitted.best_estimator_.score_samples(rows).sum())

    return _peer(search)


def scipy_density(count: int, sigma: float) -> tuple[float, object]:
    rows = clustered(count)
    # its factor multiplies the covariance of the data, so whitened rows are needed for a round kernel
    white = rows @ np.linalg.inv(np.linalg.cholesky(np.cov(rows.T))).T
    return _peer(lambda: gaussian_kde(white.T, bw_method=sigma)(white.T).sum())


def _peer(function: Callable[[], Any]) -> tuple[float, object]:
    wall, processor, _ = clocked(function)
    return wall, (processor,)


def transforms(count: int, sigma: float) -> tuple[float, object]:
    """Processor seconds of a sketch and of its sums at all rows, both without the grid, and per point of the grid."""
    rows = clustered(count)
    grid = Grid.covering(rows.min(axis=0), rows.max(axis=0), sigma, sigma, count)
    _, forward, sketch = clocked(Sketch.of, rows, grid)
    _, backward, _ = clocked(sketch.sums, rows, sigma)
    wall, grid_alone, _ = clocked(sketch.sums, rows[:1], sigma)
    grids = len(grid.parts(count))
    return wall, (forward - grids * grid_alone, backward - grids * grid_alone, grid_alone / grid.oversampled(1))


def normalised(count: int, hypotheses: int, demonstrations: int) -> tuple[float, object]:
    """Processor seconds of one part's sums of the log normalisers, with demonstrations that join the set."""
    rows, thetas = clustered(count), np.random.default_rng(2).normal(size=(hypotheses, 3))
    joined = np.zeros((demonstrations, count))
    wall, processor, _ = clocked(partial_normaliser, rows, np.zeros(count), thetas, [1.0], np.zeros(3), joined)
    return wall, (processor,)


def keep(name: str, count: int, run: Run) -> Run:
    """Record a measurement for the picture."""
    record(
        "density",
        {
            f"{name}, N = {count}, s": run.seconds,
            f"{name}, N = {count}, processor s": run.result[0],
            f"{name}, N = {count}, MB": run.memory / 1e6,
        },
    )
    return run


def grown(name: str, function: object, sizes: list[int], sigma: float, target: int) -> tuple[float, str]:
    """Processor seconds at `target` rows, and whether they were measured or extrapolated."""
    runs = [keep(name, size, measured(function, size, sigma)).result[0] for size in sizes]
    if sizes[-1] == target:
        return runs[-1], "measured"
    growth = Growth.fitted(sizes, runs)
    measurements = ", ".join(f"{size:,}: {seconds(run)}" for size, run in zip(sizes, runs, strict=True))
    return growth.at(target), f"extrapolated with N^{growth.exponent:.2f} from {measurements}"


def clock_times(run: Run) -> str:
    return f"{seconds(run.seconds)} ({seconds(run.result[0])})"


def megabytes(run: Run) -> str:
    return f"{run.memory / 1e6:,.0f} MB"


def measure(ten_million: bool, in_full: bool) -> None:
    columns = ("measure", "ours (processor)", "peak memory", "worst error", "peer (processor)", "ratio", "how")
    chosen = select_bandwidth(clustered(100_000)).value
    rows = []
    for sigma in (SIGMA, chosen):
        ours = measured(density, 100_000, sigma, times=3)
        sizes = [10_000, 20_000, 100_000 if in_full else 40_000]
        name = ITS_DENSITY if sigma == SIGMA else f"{ITS_DENSITY}, bandwidth selected"
        peer, how = grown(name, scikit_density, sizes, sigma, 100_000)
        rows.append(
            (
                f"density, N = 1e5, bandwidth {sigma:.4f} ({ours.result[1]})", clock_times(ours), megabytes(ours),
                f"{ours.result[2]:.0e}", f"scikit-learn {seconds(peer)}", f"{peer / ours.result[0]:,.0f} x", how,
            )
        )  # fmt: skip
    chains = {
        count: keep(OURS, count, measured(select_then_density, count, times=times))
        for count, times in ((10_000, 3), (100_000, 3), (1_000_000, 1))
    }
    if ten_million:
        chains[10_000_000] = keep(OURS, 10_000_000, measured(select_then_density, 10_000_000))
    sizes = [5_000, 10_000, 20_000, *([40_000, 100_000] if in_full else [])]
    peer, how = grown(SEARCH, scikit_search, sizes, chosen, 100_000)
    for count, run in chains.items():
        processor, bandwidth, selecting, error = run.result
        compared = (
            (f"scikit-learn {seconds(peer)}", f"{peer / processor:,.0f} x", how) if count == 100_000 else ("",) * 3
        )
        rows.append(
            (
                f"bandwidth, then density, N = {count:.0e} ({bandwidth.value:.4f} +- {bandwidth.value_error or 0:.4f})",
                f"{clock_times(run)}, of which bandwidth {seconds(selecting)}", megabytes(run), f"{error:.0e}",
                *compared,
            )
        )  # fmt: skip
    show("Three clustered features", columns, rows)

    last = max(chains)
    rows = []
    for name, time_of in (("wall-clock", lambda run: run.seconds), ("processor", lambda run: run.result[0])):
        times = [time_of(chains[count]) for count in (100_000, last)]
        exponent = Growth.fitted([100_000, last], times).exponent
        rows.append((f"bandwidth, then density, {name}", *map(seconds, times), f"{exponent:.2f}"))
    show("Growth", ("measure", "1e+05", f"{last:.0e}", "exponent"), rows)

    exact = measured(density, 20_000, SIGMA, "exact", times=3)
    table = []
    for name, function in ((SCIPY, scipy_density), (ITS_DENSITY, scikit_density)):
        other = keep(name, 20_000, measured(function, 20_000, SIGMA, times=3))
        ratio = other.result[0] / exact.result[0]
        table.append((name, seconds(other.result[0]), seconds(exact.result[0]), f"{ratio:.1f} x"))
    keep(SCIPY, 10_000, measured(scipy_density, 10_000, SIGMA))
    show(
        "Exact engine, all pairs, N = 2e4, bandwidth 0.05, processor seconds",
        ("peer", "its time", "ours", "ratio"),
        table,
    )

    million = 1_000_000
    forward, backward, point = measured(transforms, million, 0.02).result
    parts = measured(normalised, million, 171, 20).result[0]
    record(
        "density",
        {
            "grid of a transform, ns per point": point * 1e9,
            "sketch, us per row beside the grid": forward / million * 1e6,
            "density at rows, us per row beside the grid": backward / million * 1e6,
            "posterior, 20 demonstrations, ns per row and hypothesis": parts / million / 171 * 1e9,
        },
    )


def draw(path: Path) -> None:
    """Draw time and memory against N on logarithmic axes: measured points, and the peers' growth beyond them."""
    from benchmarks.scale_picture import draw_scale

    draw_scale(recorded("density"), path, (OURS, SEARCH, ITS_DENSITY, SCIPY))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ten-million", action="store_true", help="also 1e7 rows: some minutes, 4 GB")
    parser.add_argument(
        "--in-full", action="store_true", help="scikit-learn's density and search at 1e5 rows too: half an hour"
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw what was measured last, without measuring")
    options = parser.parse_args()
    if options.picture:
        draw(options.picture)
    else:
        measure(options.ten_million, options.in_full)


if __name__ == "__main__":
    main()
