"""Is the rest of a motion predicted from its first half? `python -m benchmarks.motion_prediction TASK`.

Needs the tables of a finished run. Each person is predicted from the others' whole motions: the alternatives are made
to begin as the person did, and each model says how probable each of them is then. `--overlay` names a file of
parameters. Beside them stand two predictions without a model, going straight on to the goal and going on as the nearest
other person, and all alternatives alike.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measuring import show, timed
from pipeline.answers.assessment import Case
from pipeline.answers.motion_prediction import Forecast, ForecastScore, score_forecasts
from pipeline.arrays import FloatArray
from pipeline.choice import LESS, Boltzmann
from pipeline.choice.models import Model
from pipeline.choice.prediction import predictive
from pipeline.choice.weights import WeightDraws, sample_weights
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.replay.features import FeatureSet, bind_features
from pipeline.replay.replay import body_positions
from pipeline.stages.answer import case_of
from pipeline.stages.registry import parameters
from pipeline.trajectories.continuation import nearest, prefix_log_kernel, spliced, straight_on
from pipeline.workspace.choice_sets import Chosen, choice_tables, read_choices
from pipeline.workspace.project import find_project
from pipeline.workspace.scenes import load_task_scene

BEGUN_RAD = 0.2  # how alike motions begin that go on alike
CELLS = 2000  # of an explored space, evenly chosen


@dataclass(frozen=True)
class Data:
    """A task's demonstrations and what they were chosen from."""

    features: FeatureSet
    chosen: Chosen
    case: Case

    @property
    def people(self) -> FloatArray:
        return np.asarray(self.chosen.people["waypoints"].to_numpy().astype(np.float64))

    def phi(self, waypoints: FloatArray) -> FloatArray:
        return np.asarray(self.features.evaluate(waypoints) / self.chosen.scale)

    def end_effector(self, waypoints: FloatArray) -> FloatArray:
        scene = self.features.scene
        return body_positions(scene, waypoints, [scene.end_effector])[scene.end_effector]


def read(task: str, overlay: Path | None) -> Data:
    project = find_project(Path.cwd(), overlay)
    settings = project.params.task(task)
    with TaskTables(choice_tables(project, task)) as tables:
        chosen = read_choices(tables, project, parameters("explore", task))
    specs = {name: dict(settings.features[name]) for name in chosen.features}
    return Data(bind_features(load_task_scene(project, settings), specs), chosen, case_of(chosen))


def posterior(case: Case, model: Model, left_out: list[int]) -> WeightDraws:
    """What is thought of a new person, from all demonstrations but some."""
    others = [row for row in range(len(case.demonstrations)) if row not in left_out]
    return sample_weights(np.random.default_rng(1), case.considered(model).subset(others), count=512)


def forecasts(data: Data, half: int) -> dict[str, list[Forecast]]:
    everyone, who = data.people, data.chosen.people["participant"].to_list()
    paths, found = data.end_effector(everyone), dict[str, list[Forecast]]()
    spaces = {"set": Case(**{**vars(data.case), "space": None})}
    if data.case.space is not None:
        spaces["explored space"] = data.case
    for person, motion in enumerate(everyone):
        same = [row for row, name in enumerate(who) if name == who[person]]
        others = [row for row in range(len(everyone)) if row not in same]
        seen, actual = motion[: half + 1], paths[person, half + 1 :]
        own = data.chosen.set_of(person).waypoints

        def rest(waypoints: FloatArray) -> FloatArray:
            return data.end_effector(waypoints)[:, half + 1 :]

        def add(label: str, positions: FloatArray, p: FloatArray, actual: FloatArray = actual) -> None:
            found.setdefault(label, []).append(Forecast(positions, p, actual))

        line = straight_on(seen, own[0, -1], motion.shape[0])
        add("straight on", rest(line[None]), np.ones(1))
        near = everyone[others][nearest(seen, everyone[others])][None]
        add("nearest other person", rest(spliced(seen, near)), np.ones(1))
        ways = spliced(seen, own)
        add("all alternatives alike", rest(ways), np.full(len(ways), 1 / len(ways)))
        for label, case in spaces.items():
            if case.space is not None and data.chosen.explored is not None:
                known = data.chosen.explored.waypoints
                own = known[:: -(-len(known) // CELLS)]
                ways = spliced(seen, own)
            phi, positions = data.phi(ways), rest(ways)
            begun = prefix_log_kernel(seen, own, BEGUN_RAD)
            for model in (Boltzmann(), LESS()):
                if case.space is not None and model.name != LESS.name:
                    continue  # the map's trajectories stand for volumes of features, not for Boltzmann's base measure
                draws = posterior(case, model, same)
                log_w = model.weigh(phi).log_w + begun
                add(f"{model.name}, {label}", positions, predictive(phi, log_w, draws.omega, draws.weight))
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
    parser.add_argument("--overlay", type=Path)
    options = parser.parse_args()
    data = read(options.task, options.overlay)
    half = (data.people.shape[1] - 1) // 2
    took, found = timed(forecasts, data, half)
    scores = {label: score_forecasts(some) for label, some in found.items()}
    lead = scores["less, set"].log_score - scores["boltzmann, set"].log_score
    columns = ("prediction", "error", "log score per waypoint", "more than straight on")
    show(
        f"{options.task}: the second half of {len(data.people)} motions ({took:.0f} s)",
        columns,
        [row(label, score, scores["straight on"]) for label, score in scores.items()],
    )
    print(f"LESS beyond Boltzmann: {lead.mean():+.2f} ± {lead.std(ddof=1) / np.sqrt(len(lead)):.2f} nat per waypoint")


if __name__ == "__main__":
    main()
