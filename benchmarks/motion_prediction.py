"""Is the rest of a motion predicted from its first half? `python -m benchmarks.motion_prediction table [--recordings
FOLDER]`.

Needs a finished project. Each person is predicted from the others' whole motions. `--recordings` names a folder of
recordings by other people who moved from the task's start to its goal; otherwise the task's own demonstrations are
used.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.explained import explain
from benchmarks.measuring import show, timed
from pipeline.answers.motion_prediction import Forecast, ForecastScore, score_forecasts
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.models import Model
from pipeline.choice.prediction import predictive
from pipeline.choice.weights import Choices, WeightDraws, sample_group, sample_weights
from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.params.reading import load
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import load_scene
from pipeline.trajectories.continuation import nearest, prefix_log_kernel, spliced, straight_on
from pipeline.trajectories.timebase import moving_part


@dataclass(frozen=True)
class Data:
    """Alternatives and people of a task, as waypoints and scaled features."""

    features: FeatureSet
    scale: np.ndarray
    alternatives: np.ndarray
    people: np.ndarray

    def phi(self, waypoints: np.ndarray) -> np.ndarray:
        return self.features.evaluate(waypoints) / self.scale

    def end_effector(self, waypoints: np.ndarray) -> np.ndarray:
        scene = self.features.scene
        return body_positions(scene, waypoints, [scene.end_effector])[scene.end_effector]


def read(datasets: Path, task: str, recordings: Path | None) -> Data:
    params = load(Path("params.yaml"))
    settings = params.task(task)
    scene = load_scene(settings.scene, end_effector=settings.end_effector, joints=settings.joints)
    features = bind_features(scene, settings.features)
    there = pl.read_parquet(datasets / task / "alternatives.parquet").filter(pl.col("set_id") == "working")
    scale = pl.read_parquet(datasets / task / "scales.parquet")["scale"].to_numpy()
    alternatives = there["waypoints"].to_numpy().astype(np.float64)
    if recordings is None:
        people = pl.read_parquet(datasets / task / "demonstrations.parquet")["waypoints"].to_numpy()
    else:
        continuous = ~np.isfinite(scene.lower)
        found = [read_joint_states(path, joints=scene.joints) for path in sorted(recordings.glob("*.mcap"))]
        people = np.stack(
            [
                moving_part((one.time_ns - one.time_ns[0]) / 1e9, one.positions, continuous).waypoints(
                    scene.start, continuous, alternatives.shape[1]
                )
                for one in found
            ]
        )
    return Data(features, scale, alternatives, people)


def posterior(data: Data, model: Model, others: list[int], together: bool) -> WeightDraws:
    """What is thought of a new person, from the others."""
    rng, phi = np.random.default_rng(1), data.phi(data.alternatives)
    choices = Choices.outside(model, data.phi(data.people[others]), phi)
    if together:
        return sample_weights(rng, choices)
    return sample_group(rng, [choices.subset([row]) for row in range(len(others))], count=512).next_person(rng)


def forecasts(data: Data, half: int) -> dict[str, list[Forecast]]:
    everyone = range(len(data.people))
    paths = data.end_effector(data.people)
    found: dict[str, list[Forecast]] = {}
    goal = data.alternatives[0, -1]
    for person in everyone:
        others = [other for other in everyone if other != person]
        seen, actual = data.people[person, : half + 1], paths[person, half + 1 :]

        def rest(waypoints: np.ndarray) -> np.ndarray:
            return data.end_effector(waypoints)[:, half + 1 :]

        line = straight_on(seen, goal, data.people.shape[1])
        found.setdefault("straight on", []).append(Forecast.single(rest(line[None])[0], actual))
        near = data.people[others][nearest(seen, data.people[others])][None]
        found.setdefault("nearest person", []).append(Forecast.single(rest(spliced(seen, near))[0], actual))
        near = data.alternatives[nearest(seen, data.alternatives)][None]
        found.setdefault("nearest alternative", []).append(Forecast.single(rest(spliced(seen, near))[0], actual))
        ways = spliced(seen, data.alternatives)
        phi, positions = data.phi(ways), rest(ways)
        alike = np.full(len(ways), 1 / len(ways))
        found.setdefault("all alternatives alike", []).append(Forecast(positions, alike, actual))
        momentum = prefix_log_kernel(seen, data.alternatives, 0.2)
        for model in (Boltzmann(), LESS()):
            log_w = model.weigh(phi).log_w
            for together in (True, False):
                draws = posterior(data, model, others, together)
                label = f"{model.name}, {'all as one' if together else 'a group'}"
                p = predictive(phi, log_w, draws.omega, draws.weight)
                found.setdefault(label, []).append(Forecast(positions, p, actual))
                if together:
                    p = predictive(phi, log_w + momentum, draws.omega, draws.weight)
                    found.setdefault(f"{label}, begun alike", []).append(Forecast(positions, p, actual))
    return found


def row(label: str, score: ForecastScore, base: ForecastScore) -> tuple[str, ...]:
    gain = score.log_score - base.log_score
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    return (
        label,
        f"{score.error_m.mean() * 100:.1f} cm",
        f"{score.log_score.mean():.2f}",
        f"{gain.mean():+.2f} ± {error:.2f}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task")
    parser.add_argument("--datasets", type=Path, default=Path("datasets"))
    parser.add_argument("--recordings", type=Path)
    options = parser.parse_args()
    data = read(options.datasets, options.task, options.recordings)
    half = (data.people.shape[1] - 1) // 2
    took, found = timed(forecasts, data, half)
    scores = {label: score_forecasts(some) for label, some in found.items()}
    columns = ("prediction", "error", "log score per waypoint", "more than straight on")
    show(
        f"{options.task}: the second half of {len(data.people)} people's motions ({took:.0f} s)",
        columns,
        [row(label, score, scores["straight on"]) for label, score in scores.items()],
    )


if __name__ == "__main__":
    explain(__doc__)
    main()
