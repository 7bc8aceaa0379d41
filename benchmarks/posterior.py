"""Posterior over many hypotheses and a million alternatives: `python -m benchmarks.posterior`."""

from __future__ import annotations

import numpy as np

from benchmarks.explained import explain
from benchmarks.measuring import clustered, measured, seconds, show, timed
from pipeline.choice import LESS, Boltzmann, infer


def posterior(model: Boltzmann | LESS, count: int, hypotheses: int, demonstrations: int) -> tuple[float, object]:
    thetas = np.random.default_rng(2).normal(size=(hypotheses, 3))
    return timed(lambda: infer(model, clustered(demonstrations, seed=0), clustered(count), thetas).map_index)


def main() -> None:
    rows = []
    for model, hypotheses in ((Boltzmann(), 171), (LESS(0.05), 171), (Boltzmann(), 1000), (LESS(0.05), 1000)):
        run = measured(posterior, model, 1_000_000, hypotheses, 20)
        product = 1_000_000 * hypotheses
        rows.append(
            (
                model.name, f"{hypotheses}", seconds(run.seconds), f"{run.seconds / product * 1e9:.1f} ns",
                f"{run.memory / 1e6:,.0f} MB", f"{product * 8 / 1e6:,.0f} MB",
            )
        )  # fmt: skip
    columns = ("model", "hypotheses", "time", "per alternative and hypothesis", "peak memory", "the product alone")
    show("Posterior, 1e6 alternatives, 20 demonstrations outside the set", columns, rows)


if __name__ == "__main__":
    explain(__doc__)
    main()
