"""Predictions of pipeline/choice/kernel/cost_model.py beside measured times: `python -m benchmarks.unit_costs`."""

from __future__ import annotations

import math
import statistics

import finufft
import numpy as np

from benchmarks.explained import explain
from benchmarks.measuring import clustered, seconds, show, timed
from pipeline.choice.kernel import cost_model
from pipeline.choice.kernel.fourier import Grid, Sketch
from pipeline.choice.kernel.pairwise import Neighbours
from pipeline.choice.kernel.unique_rows import distinct_rows

GRIDS = (128, 250, 250), (96, 200, 200), (120, 240, 240), (96, 192, 192), (128, 256, 256), (160, 320, 320)


def main() -> None:
    rows = []
    for count, features, sigma in (
        (20_000, 2, 0.05), (20_000, 3, 0.05), (20_000, 4, 0.05), (100_000, 2, 0.005), (100_000, 3, 0.02),
    ):  # fmt: skip
        groups = distinct_rows(clustered(count, features))
        predicted = cost_model.neighbours(groups.rows, count, None, sigma).seconds
        took = _median(lambda g=groups, s=sigma: Neighbours(g.rows, g.counts).log_sums_within(s))
        rows.append(("neighbours", f"{count:,} x {features}", f"{sigma}", seconds(predicted), seconds(took)))
    for count, features, sigma in (
        (100_000, 1, 0.01), (1_000_000, 1, 0.01), (1_000_000, 2, 0.01), (100_000, 3, 0.05), (1_000_000, 3, 0.05),
        (100_000, 3, 0.02),
    ):  # fmt: skip
        groups = distinct_rows(clustered(count, features))
        grid = Grid.covering(groups.rows.min(axis=0), groups.rows.max(axis=0), sigma, sigma, count)
        predicted = cost_model.transform_seconds(grid, count)
        took = _median(lambda g=groups, grid=grid: Sketch.of(g.rows, grid, g.counts))
        rows.append(("one transform", f"{count:,} x {features}", f"{sigma}", seconds(predicted), seconds(took)))
    show("Cost model", ("what", "rows x features", "bandwidth", "predicted", "measured"), rows)
    transforms = [(" x ".join(map(str, sizes)), _fft(sizes, -1), _fft(sizes, 1)) for sizes in GRIDS]
    show("FINUFFT's own FFT, per point, by grid and sign", ("grid", "exp(-i ...)", "exp(i ...)"), transforms)


def _fft(sizes: tuple[int, ...], sign: int) -> str:
    """Time of a transform of one point, nearly all of which is the FFT, per point of the grid."""
    oversampling = 1.6
    shape = [int(size / oversampling) for size in sizes]
    plan = finufft.Plan(1, shape, eps=1e-12, isign=sign, nthreads=1, upsampfac=oversampling)
    plan.setpts(*[np.zeros(1)] * len(sizes))
    took = _median(lambda: plan.execute(np.ones(1, dtype=np.complex128)))
    return f"{took / math.prod(sizes) * 1e9:.1f} ns"


def _median(function: object) -> float:
    return statistics.median(timed(function)[0] for _ in range(3))


if __name__ == "__main__":
    explain(__doc__)
    main()
