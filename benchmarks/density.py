"""Kernel density and its bandwidth against scikit-learn and scipy: `python -m benchmarks.density [--ten-million]`.

Three clustered features. Every case runs in a process of its own, one core. Peers that would run for hours are measured
up to 40,000 rows and extrapolated by their own growth between the two largest sizes; the table says which.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from scipy.stats import gaussian_kde
from sklearn.model_selection import GridSearchCV
from sklearn.neighbors import KernelDensity

from benchmarks.measuring import Growth, Run, clustered, measured, seconds, show, timed
from pipeline.choice import choose_engine, log_density, select_bandwidth

RELATIVE = 1e-6  # tolerance given to scikit-learn
BANDWIDTHS = 20


def density(count: int, sigma: float, engine: str = "auto") -> tuple[float, object]:
    rows = clustered(count)
    took, values = timed(log_density, rows, sigma, engine=engine)
    chosen = choose_engine(rows, sigma).engine if engine == "auto" else engine
    return took, (chosen, worst_error(rows, sigma, values))


def select_then_density(count: int) -> tuple[float, object]:
    rows = clustered(count)
    selecting, bandwidth = timed(select_bandwidth, rows)
    took, values = timed(log_density, rows, bandwidth.value)
    engine = choose_engine(rows, bandwidth.value).engine
    return selecting + took, (bandwidth, selecting, engine, worst_error(rows, bandwidth.value, values))


def worst_error(rows: np.ndarray, sigma: float, values: np.ndarray) -> float:
    """Largest relative error of the sums at 300 random rows against direct sums."""
    picked = np.random.default_rng(1).choice(len(rows), 300, replace=False)
    sums = np.array([np.exp(-0.5 * ((rows - rows[i]) ** 2).sum(axis=1) / sigma**2).sum() for i in picked])
    return float(np.abs(np.exp(values[picked]) / sums - 1).max())


def scikit_density(count: int, sigma: float) -> tuple[float, object]:
    rows = clustered(count)
    return timed(lambda: KernelDensity(bandwidth=sigma, rtol=RELATIVE).fit(rows).score_samples(rows).sum())


def scikit_search(count: int, sigma: float) -> tuple[float, object]:
    """Twenty bandwidths around `sigma`, five folds, refitted; then the density of all rows."""
    rows = clustered(count)
    grid = {"bandwidth": sigma * np.geomspace(0.2, 5, BANDWIDTHS)}

    def search() -> float:
        found = GridSearchCV(KernelDensity(rtol=RELATIVE), grid, cv=5).fit(rows)
        return float(found.best_estimator_.score_samples(rows).sum())

    return timed(search)


def scipy_density(count: int, sigma: float) -> tuple[float, object]:
    rows = clustered(count)
    # its factor multiplies the covariance of the data, so whitened rows are needed for a round kernel
    white = rows @ np.linalg.inv(np.linalg.cholesky(np.cov(rows.T))).T
    return timed(lambda: gaussian_kde(white.T, bw_method=sigma)(white.T).sum())


def grown(function: object, sizes: list[int], sigma: float, wanted: int) -> tuple[float, str]:
    """Seconds at `wanted` rows, and how they were found."""
    runs = [measured(function, size, sigma).seconds for size in sizes]
    growth = Growth.fitted(sizes, runs)
    measurements = ", ".join(f"{size:,}: {seconds(run)}" for size, run in zip(sizes, runs, strict=True))
    return growth.at(wanted), f"extrapolated with N^{growth.exponent:.2f} from {measurements}"


def megabytes(run: Run) -> str:
    return f"{run.memory / 1e6:,.0f} MB"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ten-million", action="store_true", help="also 1e7 rows: some minutes, 4 GB")
    parser.add_argument(
        "--in-full", action="store_true", help="also scikit-learn's density at 1e5 rows, not extrapolated"
    )
    options = parser.parse_args()
    columns = ("measure", "ours", "peak memory", "worst error", "peer", "ratio", "how")

    chosen = select_bandwidth(clustered(100_000)).value
    rows = []
    for sigma in (0.05, chosen):
        ours = measured(density, 100_000, sigma, times=5)
        if options.in_full:
            peer, how = measured(scikit_density, 100_000, sigma).seconds, "measured"
        else:
            peer, how = grown(scikit_density, [10_000, 20_000, 40_000], sigma, 100_000)
        rows.append(
            (
                f"density, N = 1e5, bandwidth {sigma:.4f} ({ours.result[0]})", seconds(ours.seconds), megabytes(ours),
                f"{ours.result[1]:.0e}", f"scikit-learn {seconds(peer)}", f"{peer / ours.seconds:,.0f} x", how,
            )
        )  # fmt: skip
    chains = {
        count: measured(select_then_density, count, times=times) for count, times in ((100_000, 3), (1_000_000, 1))
    }
    if options.ten_million:
        chains[10_000_000] = measured(select_then_density, 10_000_000)
    peer, how = grown(scikit_search, [2_500, 5_000, 10_000], chosen, 100_000)
    for count, run in chains.items():
        bandwidth, selecting, engine, error = run.result
        compared = (
            (f"scikit-learn, 20 bandwidths {seconds(peer)}", f"{peer / run.seconds:,.0f} x", how)
            if count == 100_000
            else ("", "", "")
        )
        rows.append(
            (
                f"bandwidth, then density, N = {count:.0e} ({bandwidth.value:.4f} +- {bandwidth.value_error:.4f}, {engine})",
                f"{seconds(run.seconds)} (bandwidth {seconds(selecting)})", megabytes(run), f"{error:.0e}", *compared,
            )
        )  # fmt: skip
    show("Spectral engine, three clustered features", columns, rows)

    sizes = list(chains)
    alone = [measured(density, size, 0.05, "spectral").seconds for size in sizes]
    show(
        "Growth",
        ("measure", *(f"{size:.0e}" for size in sizes), "exponent from first to last"),
        [
            (name, *map(seconds, times), f"{Growth.fitted([sizes[0], sizes[-1]], [times[0], times[-1]]).exponent:.2f}")
            for name, times in (
                ("bandwidth, then density", [run.seconds for run in chains.values()]),
                ("density, bandwidth 0.05", alone),
            )
        ],
    )

    exact = measured(density, 20_000, 0.05, "exact", times=3)
    table = []
    for name, function in (("scipy gaussian_kde", scipy_density), ("scikit-learn KernelDensity", scikit_density)):
        other = measured(function, 20_000, 0.05, times=3)
        table.append((name, seconds(other.seconds), seconds(exact.seconds), f"{other.seconds / exact.seconds:.1f} x"))
    show("Exact engine, all pairs, N = 2e4, bandwidth 0.05", ("peer", "its time", "ours", "ratio"), table)


if __name__ == "__main__":
    sys.exit(main())
