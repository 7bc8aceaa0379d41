"""What the bound on effort, cells and kernel do to the answer: `python -m benchmarks.exploration_settings TASK`.

Each row changes one setting of the default and says how far the posteriors of single demonstrations and of all together
lie from those of the default (KL divergence, nats), and what is learned. --data is a folder of tables, one folder a
task, see benchmarks.exploration. The first row is another exploration with the default settings: what is no larger than
that is noise.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.exploration import ROOT, Case, case
from benchmarks.measuring import show
from pipeline.arrays import FloatArray
from pipeline.choice import posterior_from
from pipeline.choice.explored import expected_choice, region_log_likelihood, region_log_weights
from pipeline.choice.reweighting import base_weights
from pipeline.trajectories.exploration.archive import Grid
from pipeline.trajectories.exploration.search import explore
from pipeline.trajectories.exploration.tempering import Tempering, temper
from pipeline.trajectories.random_streams import child_rng

FACTORS = (0.5, 0.75, 1.5, 2.0)


def likelihoods(which: Case, evaluations: int, stream: int, kernel: float) -> dict[str, FloatArray]:
    """(n, K, B) log likelihoods under both models."""
    sweeps = max(2, round(100 * evaluations / 1_000_000))
    rng = child_rng(0, which.name, stream, "temper")
    draws = temper(which.space, which.thetas, which.betas.max(), rng, Tempering(sweeps=sweeps))
    weights = base_weights(draws.features, draws.omegas, draws.counts, draws.log_normalisers)
    found = explore(
        which.space, draws.walkers, child_rng(0, which.name, stream, "explore"), evaluations, Grid(which.cell),
        interest=lambda phi: expected_choice(phi, which.thetas, which.betas),
    ).archive.features.copy()  # fmt: skip
    rows = {"less": (found, region_log_weights(found, kernel)), "boltzmann": (weights.features, weights.log_w)}
    asked = (which.thetas, which.betas)
    return {model: region_log_likelihood(which.demonstrations, *of, *asked) for model, of in rows.items()}


def answers(which: Case, values: FloatArray) -> FloatArray:
    """(n + 1, K) log posteriors over theta, of each demonstration and of all together."""
    groups = [*values, values.sum(axis=0)]
    return np.stack([posterior_from(one, which.thetas, which.betas).log_marginal_theta for one in groups])


def apart(now: FloatArray, default: FloatArray) -> list[str]:
    """Median and largest divergence over single demonstrations, that of all together; mean learned."""
    kl = (np.exp(now) * (now - default)).sum(axis=1)
    learned = (np.log(now.shape[1]) + (np.exp(now) * now).sum(axis=1))[:-1].mean()
    return [f"{np.median(kl[:-1]):.3f}", f"{kl[:-1].max():.3f}", f"{kl[-1]:.3f}", f"{learned:.2f}"]


def report(which: Case, evaluations: int) -> None:
    """Print one table a model."""
    space, cell = which.space, which.cell
    varied = [("another exploration", which, cell)]
    for factor in FACTORS:
        multiple = 1 + factor * (space.effort_multiple - 1)
        bounded = replace(which, space=replace(space, effort_multiple=multiple))
        varied.append((f"effort {multiple:.1f} times the least", bounded, cell))
    varied += [(f"cell and kernel {f * cell:.3f}", replace(which, cell=f * cell), f * cell) for f in (0.6, 1.5)]
    varied += [(f"kernel {f * cell:.3f}", which, f * cell) for f in (0.5, 2.0)]
    default = {model: answers(which, of) for model, of in likelihoods(which, evaluations, 0, cell).items()}
    rows: dict[str, list[list[str]]] = {model: [] for model in default}
    for name, changed, kernel in varied:
        for model, of in likelihoods(changed, evaluations, 1, kernel).items():
            if model == "less" or not name.startswith(("cell", "kernel")):
                rows[model].append([name, *apart(answers(changed, of), default[model])])
    for model, of_model in rows.items():
        title = f"{which.name}, {model}: default effort {space.effort_multiple:g}, cell and kernel {cell:.3f}"
        show(title, ("setting", "KL single, median", "largest", "all together", "learned nats"), of_model)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tasks", nargs="*", default=["table", "laptop", "human"])
    parser.add_argument("--data", type=Path, default=ROOT / "datasets")
    parser.add_argument("--evaluations", type=int, default=500_000)
    asked = parser.parse_args()
    for task in asked.tasks:
        report(case(task, asked.data), asked.evaluations)


if __name__ == "__main__":
    main()
