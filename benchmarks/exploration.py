"""Do explorations agree, and are they right? `python -m benchmarks.exploration [TASK ...] [--data DIR] [--people DIR]`.

For each task: independent explorations, each seeded by another sampler's set of 1,000 (`shifted_alternatives.parquet`
of a finished project under --data), their disagreement under both models, coverage of credible sets on choices
simulated from one exploration and inferred with another, and cost. With --people (a folder with one
folder of MCAP files a condition,
named after its task, such as laptop2) the same on those recordings, and the held-out scores of the two models.

Fixed before the runs that are reported: the bound on effort (1.25 times the most wasteful demonstration, up to the next
tenth), the width of the base measure (the demonstrations' root mean square deviation), cells and kernel of 0.05 (1/36
of the bound on scaled efficiency where that is more), 1,000,000 evaluations of the map beside a
million of the tempering.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.measuring import show
from pipeline.choice import angle_to, held_out_from, posterior_from, theta_grid
from pipeline.choice.convergence import TEN, disagreement
from pipeline.choice.explored import expected_choice, log_states, region_log_likelihood, region_log_weights
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.reweighting import base_weights
from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.params import load
from pipeline.replay import bind_features, load_scene
from pipeline.replay.assessment import assessment
from pipeline.replay.room import Room
from pipeline.trajectories.exploration.archive import Grid
from pipeline.trajectories.exploration.choice_space import ChoiceSpace, default_effort_multiple, default_width
from pipeline.trajectories.exploration.search import explore
from pipeline.trajectories.exploration.tempering import temper
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.random_streams import child_rng
from pipeline.trajectories.timebase import moving_part

ROOT = Path(__file__).resolve().parents[1]
WAYPOINTS, CELL, CELLS_OF_EFFORT = 41, 0.05, 36
SIMULATED_BETAS = (1.0, 3.0, 10.0, 30.0)
REPETITIONS, MANY = 100, 12
LEVEL = 0.9


@dataclass(frozen=True)
class Case:
    """A task, what was demonstrated in it, and what samplers drew."""

    name: str
    space: ChoiceSpace
    demonstrations: np.ndarray
    samples: dict[str, np.ndarray]
    thetas: np.ndarray
    betas: np.ndarray
    cell: float


@dataclass(frozen=True)
class Covered:
    """One exploration: rows and log weights for each model, log likelihoods of the demonstrations."""

    rows: dict[str, tuple[np.ndarray, np.ndarray]]
    likelihoods: dict[str, np.ndarray]
    states: np.ndarray
    seconds: tuple[float, float]
    evaluations: tuple[int, int]
    cells: int
    growth: float
    effective: float


def case(name: str, data: Path, recordings: Path | None = None) -> Case:
    parameters = load(ROOT / "params.yaml")
    task_name = name.rstrip("0123456789")
    task = parameters.task(task_name)
    scene = load_scene(ROOT / task.scene, end_effector=task.end_effector, joints=task.joints)
    features = bind_features(scene, task.features)
    scales = pl.read_parquet(data / task_name / "scales.parquet")["scale"].to_numpy()
    if recordings is None:
        table = pl.read_parquet(data / task_name / "demonstrations.parquet").sort("demonstration_id")
        shown = table["waypoints"].to_numpy().astype(float)
    else:
        shown = np.stack([waypoints_of(file, scene) for file in sorted(recordings.glob("*.mcap"))])
    drawn = pl.read_parquet(data / task_name / "shifted_alternatives.parquet").filter(pl.col("set_size") == 1000)
    room = Room.of(scene, task.surface, task.collisions, Anchor(scene.start, scene.goal), name)
    assess, measure = assessment(features, scales, room)
    space = ChoiceSpace(
        Anchor(scene.start, scene.goal),
        WAYPOINTS,
        scene.lower,
        scene.upper,
        assess,
        default_effort_multiple(shown),
        default_width(shown),
        measure=measure,
    )
    most = space.most_effort / scales[features.names.index("efficiency")]
    return Case(
        name,
        space,
        features.evaluate(shown) / scales,
        {
            key: part["waypoints"].to_numpy().astype(float)
            for (key,), part in drawn.partition_by("set_id", as_dict=True).items()
        },
        theta_grid([parameters.infer.theta_values] * len(features.names)),
        np.array(parameters.infer.betas),
        max(CELL, most / CELLS_OF_EFFORT),
    )


def waypoints_of(file: Path, scene) -> np.ndarray:
    recording = read_joint_states(file, joints=scene.joints)
    time_s = (recording.time_ns - recording.time_ns[0]) / 1e9
    moving = moving_part(time_s, recording.positions, scene.continuous)
    return moving.waypoints(scene.start, scene.continuous, WAYPOINTS)


def covered(which: Case, seed: str, evaluations: int) -> Covered:
    start = time.process_time()
    space = which.space
    draws = temper(space, which.thetas, which.betas.max(), child_rng(0, which.name, seed, "temper"))
    weights = base_weights(draws.features, draws.omegas, draws.counts, draws.log_normalisers)
    tempered = time.process_time()
    seeds = np.concatenate([space.encode(which.samples[seed]), draws.walkers])
    found = explore(
        space,
        seeds,
        child_rng(0, which.name, seed, "explore"),
        evaluations,
        Grid(which.cell),
        interest=lambda phi: expected_choice(phi, which.thetas, which.betas),
    )
    seconds = tempered - start, time.process_time() - tempered
    rows = {
        "less": (found.archive.features.copy(), region_log_weights(found.archive.features, which.cell)),
        "boltzmann": (weights.features, weights.log_w),
    }
    likelihoods = {
        model: region_log_likelihood(which.demonstrations, *of, which.thetas, which.betas) for model, of in rows.items()
    }
    omegas = (which.betas[:, None, None] * which.thetas).reshape(-1, which.thetas.shape[1])
    return Covered(
        rows,
        likelihoods,
        log_states(which.demonstrations, *rows["boltzmann"], which.cell),
        seconds,
        (draws.evaluations, found.evaluations),
        len(found.archive),
        found.growth_at_last_doubling,
        float(weights.effective_sizes(omegas).min()),
    )


def agreement(which: Case, runs: list[Covered], model: str) -> list[str]:
    """KLAggregate on the scale of ten: median and largest over demonstrations, all together; learned nats."""
    single = np.stack(
        [
            [posterior_from(one, which.thetas, which.betas).log_marginal_theta for one in run.likelihoods[model]]
            for run in runs
        ]
    )
    together = np.stack(
        [[posterior_from(run.likelihoods[model], which.thetas, which.betas).log_marginal_theta] for run in runs]
    )
    apart, apart_together = TEN * disagreement(single), TEN * disagreement(together)
    learned = (np.log(len(which.thetas)) + (np.exp(single) * single).sum(axis=2)).mean()
    return [f"{np.median(apart):.2f}", f"{apart.max():.2f}", f"{apart_together[0]:.2f}", f"{learned:.2f}"]


def simulated(which: Case, runs: list[Covered], model: str, count: int) -> list[str]:
    """Choices from one exploration, inferred with another: coverage of credible sets, accuracy."""
    rng = child_rng(0, which.name, model, count, "simulated")
    angles = np.array([[angle_to(a, b) for b in which.thetas] for a in which.thetas])
    scores = []
    for source, judge in zip(runs[::2], runs[1::2], strict=False):
        phi, log_w = source.rows[model]
        log_z = -region_log_likelihood(np.zeros((1, phi.shape[1])), *judge.rows[model], which.thetas, which.betas)[0]
        for k, theta in enumerate(which.thetas):
            for beta in SIMULATED_BETAS:
                log_p = beta * phi @ theta + log_w
                chances = np.exp(log_p - log_sum_exp(log_p))
                chosen = phi[rng.choice(len(phi), size=(REPETITIONS, count), p=chances / chances.sum())].sum(axis=1)
                joint = (chosen @ which.thetas.T)[..., None] * which.betas - count * log_z
                log_marginal = log_sum_exp(joint, axis=2)
                p = np.exp(log_marginal - log_sum_exp(log_marginal, axis=1)[:, None])
                before = np.where(p > p[:, [k]], p, 0).sum(axis=1)  # mass of what is more probable than the truth
                standard = before < LEVEL
                randomised = before + rng.random(len(p)) * p[:, k] < LEVEL
                best = p.argmax(axis=1)
                scores.append(
                    np.stack([standard, randomised, p[:, k], best == k, np.degrees(angles[k, best])]).mean(axis=1)
                )
    covers, exactly, posterior, match, angle = np.mean(scores, axis=0)
    return [f"{covers:.3f}", f"{exactly:.3f}", f"{posterior:.3f}", f"{match:.3f}", f"{angle:.1f}"]


def held_out(runs: list[Covered]) -> list[str]:
    """LESS minus Boltzmann as densities of features, per person: mean and SD over explorations, error over people."""
    differences = np.stack(
        [
            held_out_from(run.likelihoods["less"]).log_predictive
            - held_out_from(run.likelihoods["boltzmann"] + run.states[:, None, None]).log_predictive
            for run in runs
        ]
    )
    people = differences.mean(axis=0)
    spread = differences.mean(axis=1).std(ddof=1)
    return [f"{people.mean():+.2f}", f"{spread:.3f}", f"{people.std(ddof=1) / np.sqrt(len(people)):.2f}"]


def report(which: Case, explorations: int, evaluations: int, keep: Path | None) -> None:
    every = np.linspace(0, len(which.samples) - 1, explorations).round().astype(int)
    seeds = [list(which.samples)[index] for index in every]
    runs = []
    for seed in seeds:
        runs.append(covered(which, seed, evaluations))
        run = runs[-1]
        print(
            f"{which.name} {seed}: {run.cells} cells, growth at the last doubling {run.growth:.3f}, least effective "
            f"size {run.effective:.0f}, {run.seconds[0]:.1f} + {run.seconds[1]:.1f} s for {run.evaluations[0]} + "
            f"{run.evaluations[1]}",
            flush=True,
        )
    space = which.space
    title = (
        f"{which.name}: {len(runs)} explorations; effort up to {space.most_effort:.3f} rad^2 "
        f"({space.effort_multiple:g} times the least), base measure {space.width_rad:.3f} rad, cell {which.cell:.3f}"
    )
    show(
        title,
        ("model", "KLAggregate median", "largest", "all together", "learned nats"),
        [[model, *agreement(which, runs, model)] for model in runs[0].rows],
    )
    show(
        "choices simulated from one exploration, inferred with another",
        ("model", "choices", "90 % sets cover", "randomised", "TruePosterior", "TrueMatch", "angle deg"),
        [[model, str(n), *simulated(which, runs, model, n)] for model in runs[0].rows for n in (1, MANY)],
    )
    show(
        "held-out score, LESS minus Boltzmann, nat a person",
        ("mean", "SD over explorations", "SE over people"),
        [held_out(runs)],
    )
    if keep is not None:
        arrays = {f"{model}{r}": np.column_stack(run.rows[model]) for r, run in enumerate(runs) for model in run.rows}
        np.savez(keep / f"{which.name}.npz", **arrays, demonstrations=which.demonstrations)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tasks", nargs="*", default=["table", "laptop", "human"])
    parser.add_argument("--data", type=Path, default=ROOT / "datasets")
    parser.add_argument("--people", type=Path)
    parser.add_argument("--explorations", type=int, default=10)
    parser.add_argument("--evaluations", type=int, default=1_000_000)
    parser.add_argument("--keep", type=Path)
    asked = parser.parse_args()
    for task in asked.tasks:
        folder = None if asked.people is None else asked.people / task
        report(case(task, asked.data, folder), asked.explorations, asked.evaluations, asked.keep)


if __name__ == "__main__":
    main()
