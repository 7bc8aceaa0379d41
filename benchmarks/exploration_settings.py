"""What the bound on effort, cells and kernel do to the answer: `python -m benchmarks.exploration_settings TASK`.

Each row changes one setting of the default and says how far the posteriors of single demonstrations and of all together
lie from those of the default (KL divergence, nats), what is learned, and for how many people the most probable theta is
another one. --project is a folder in which `dvc repro` has run. The first row is another exploration with the default
settings: what is no larger than that is noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.measuring import show
from pipeline.arrays import FloatArray
from pipeline.choice import posterior_from
from pipeline.choice.explored import expected_choice, region_log_likelihood, region_log_weights
from pipeline.choice.reweighting import base_weights
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.explore import Inputs, plan_of, read_inputs
from pipeline.trajectories.exploration.archive import Grid
from pipeline.trajectories.exploration.choice_space import ChoiceSpace
from pipeline.trajectories.exploration.search import explore
from pipeline.trajectories.exploration.tempering import Tempering, temper
from pipeline.trajectories.random_streams import child_rng
from pipeline.workspace.compute.exploration import with_fine_cells
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene

FACTORS = (0.5, 0.75, 1.5, 2.0)


@dataclass(frozen=True, eq=False)
class Case:
    """A task, what was demonstrated in it, and its choice space."""

    name: str
    given: Inputs
    space: ChoiceSpace
    demonstrations: FloatArray
    thetas: FloatArray
    betas: FloatArray
    cell: float


@contextmanager
def case(project: Project, name: str) -> Iterator[Case]:
    """The choice space of a task as the stage `explore` declares it."""
    task = project.params.task(name)
    with TaskTables(project.tables(name, ("demonstrations", "scales"))) as tables:
        given = read_inputs(project, name, load_task_scene(project, task), tables)
        plan = with_fine_cells(plan_of(project, task, given, [given.shown]))
        yield Case(name, given, plan.declared.space(), given.phi, given.asked.thetas, given.asked.betas, plan.cell)


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
    """Median and largest divergence over single demonstrations, that of all together; mean learned; flipped answers."""
    kl = (np.exp(now) * (now - default)).sum(axis=1)
    learned = (np.log(now.shape[1]) + (np.exp(now) * now).sum(axis=1))[:-1].mean()
    flips = now.argmax(axis=1) != default.argmax(axis=1)
    return [
        f"{np.median(kl[:-1]):.3f}", f"{kl[:-1].max():.3f}", f"{kl[-1]:.3f}", f"{learned:.2f}",
        f"{flips[:-1].sum()} of {len(flips) - 1}", "yes" if flips[-1] else "no",
    ]  # fmt: skip


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
        columns = ("setting", "KL single, median", "largest", "all", "learned nats", "other best theta", "all together")
        show(title, columns, of_model)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tasks", nargs="*", default=["table", "laptop", "human"])
    parser.add_argument("--project", type=Path, default=Path())
    parser.add_argument("--evaluations", type=int, default=500_000)
    asked = parser.parse_args()
    for task in asked.tasks:
        with case(Project(asked.project), task) as which:
            report(which, asked.evaluations)


if __name__ == "__main__":
    main()
