"""The trajectory that is best for what people want: `python -m benchmarks.plan table [--recordings FOLDER]`; see
motion_prediction.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.explained import explain
from benchmarks.measuring import show, timed
from benchmarks.motion_prediction import read
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.weights import Choices, sample_group, weighted_quantiles
from pipeline.params.reading import load
from pipeline.replay.planning import Room
from pipeline.trajectories.best_in_expectation import bounded, plan_in_expectation
from pipeline.trajectories.optimise import Search
from pipeline.trajectories.paths import Anchor
from pipeline.trajectories.random_streams import child_rng


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task")
    parser.add_argument("--datasets", type=Path, default=Path("datasets"))
    parser.add_argument("--recordings", type=Path)
    options = parser.parse_args()
    data = read(options.datasets, options.task, options.recordings)
    scene, rows, chosen = data.features.scene, data.phi(data.alternatives), data.phi(data.people)
    room = Room(scene, load(Path("params.yaml")).task(options.task).surface)
    anchor = Anchor(data.alternatives[0, 0], data.alternatives[0, -1])
    lower, upper = room.limits(anchor)
    assess = bounded(lambda w: (data.phi(w), room.admissible(w)), rows.min(axis=0), rows.max(axis=0))
    table = []
    for model in (Boltzmann(), LESS()):
        choices = Choices.outside(model, chosen, rows)
        group = sample_group(np.random.default_rng(0), [choices.subset([n]) for n in range(len(chosen))]).group
        rngs = [child_rng(0, "plan", n) for n in range(12)]
        took, plan = timed(
            plan_in_expectation, rngs, anchor, group.omega, group.weight, assess, lower=lower, upper=upper,
            n_waypoints=data.people.shape[1], candidates=data.alternatives, restarts=4, search=Search(iterations=60),
        )  # fmt: skip
        best = float((rows @ group.mean).max())
        table.append(
            (
                model.name, str(group.mean.round(1)), str((rows < plan.features).mean(axis=0).round(2)),
                f"{plan.expected_reward - best:+.2f}", f"{plan.expected_regret:.2f}",
                f"{weighted_quantiles(plan.regret[:, None], group.weight, [0.9])[0, 0]:.2f}",
                f"{plan.change.min():.2f} to {plan.change.max():.2f} rad",
                f"{plan.inadmissible:.2f}", f"{took:.1f} s",
            )
        )  # fmt: skip
    columns = (
        "model", "mean weights", "plan's place among alternatives", "reward beyond the best alternative (nat)",
        "expected regret",
        "90 % below", "change over the belief", "inadmissible", "time",
    )  # fmt: skip
    show(f"{options.task}: {', '.join(data.features.names)}", columns, table)


if __name__ == "__main__":
    explain(__doc__)
    main()
