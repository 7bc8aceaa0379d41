"""Memory for many hypotheses and time for many sets: `python -m benchmarks.hypotheses`.

Memory is measured for the repository's table task with 20 participants and a growing number of features, with each
stage in a process of its own. A grid of three weights for each of F features has 3^F - 2^F thetas. Time is measured for
900
sets of 50 alternatives: how much processor time is spent on reading them, and how much on inferring from them.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from benchmarks.end_to_end import ROOT, STAGES, TASK, run
from benchmarks.measuring import measured, record, seconds, show
from pipeline.choice import log_likelihood, theta_grid
from pipeline.choice.models import choice_model
from pipeline.formats.parquet.partitions import Scaled
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages.infer import INPUTS
from pipeline.workspace.compute.likelihoods import bandwidths
from pipeline.workspace.project import Project

PARTICIPANTS = 20
FEATURES: dict[str, dict[str, Any]] = {
    "efficiency": {"kind": "efficiency"},
    "table": {"kind": "height"},
    "laptop": {"kind": "proximity", "object": "laptop", "radius_m": 0.4},
    "length": {"kind": "path_length"},
    "tilt": {"kind": "tilt", "body": "j2s7s300_link_7"},
    "near": {"kind": "proximity", "object": "laptop", "radius_m": 0.2},
    "far": {"kind": "proximity", "object": "laptop", "radius_m": 0.8},
    "elbow": {"kind": "tilt", "body": "j2s7s300_link_4"},
}
LOOKING = (("figures", TASK), ("inspect", TASK), ("verify", TASK), ("catalog",), ("report",))


def write_project(root: Path, features: int, **sample: object) -> None:
    """Write a project with one task of the repository, this number of features, and 20 participants."""
    yaml = YAML(typ="safe", pure=True)
    parameters = yaml.load(ROOT / "params.yaml")
    task = parameters["tasks"][TASK] | {"features": dict(list(FEATURES.items())[:features])}
    parameters["tasks"] = {TASK: task}
    parameters["simulate"] |= {"participants": PARTICIPANTS, "weights": {TASK: parameters["simulate"]["weights"][TASK]}}
    parameters["sample"] |= sample
    yaml.dump(parameters, root / "params.yaml")
    for folder in ("robots", "scenes"):
        shutil.copytree(ROOT / "datasets" / folder, root / "datasets" / folder)


def read_and_infer(root: Path) -> tuple[float, tuple[float, float, int]]:
    """Seconds of both; then processor seconds of reading and of inferring, and the number of sets."""
    project = Project(root)
    thetas, betas = theta_grid([project.params.infer.theta_values] * 3), np.array(project.params.infer.betas)
    begin, start = time.process_time(), time.perf_counter()
    with TaskTables(project.tables(TASK, INPUTS)) as tables:
        tables.check(whole=["demonstrations", "densities"])
        scales = tables["scales"].read()
        features = Scaled(tables.for_jobs("features"), tuple(scales["feature"]), scales["scale"].to_numpy())
        demonstrations = features.read(tables.contents("features").others)
        sets = tables.contents("features").sets
        sigmas = bandwidths(tables)
        alternatives = {set_rows.key: features.read(set_rows.pieces) for set_rows in sets}
    read = time.process_time()
    for key, phi in alternatives.items():
        for model in project.params.infer.models:
            log_likelihood(choice_model(model, sigmas[key]), demonstrations, phi, thetas, betas)
    ended = time.process_time()
    return time.perf_counter() - start, (read - begin, ended - read, len(sets))


def reading() -> None:
    with tempfile.TemporaryDirectory(prefix="lessbench-sets-") as folder:
        root = Path(folder)
        write_project(root, 3, sizes=[50], sets=900, working_set=50, sampler="deformation")
        for stage in ("simulate", "ingest", *STAGES):
            cost = run(root, stage, TASK)
        read, inferred, sets = measured(read_and_infer, root, times=3).result
        rows = [
            ("reading", seconds(read)),
            ("inferring", seconds(inferred)),
            ("the stage, all it does", seconds(cost.cpu_s)),
        ]
        show(f"infer, {sets} sets of 50: processor time", ("what", "CPU time"), rows)
        record("hypotheses", {"sets of 50, reading, s": read, "sets of 50, inferring, s": inferred})


def memory(features: int) -> None:
    thetas = len(theta_grid([[0, 0.5, 1]] * features))
    with tempfile.TemporaryDirectory(prefix="lessbench-hypotheses-") as folder:
        root = Path(folder)
        write_project(root, features)
        for stage in ("simulate", "ingest", *STAGES[:-1]):
            run(root, stage, TASK)
        costs = {command[0]: run(root, *command) for command in (("infer", TASK), *LOOKING)}
        size = (root / "datasets" / TASK / "tables" / "posteriors.parquet").stat().st_size
    rows = [
        (name, seconds(cost.wall_s), seconds(cost.cpu_s), f"{cost.memory / 1e6:,.0f} MB")
        for name, cost in costs.items()
    ]
    title = f"{features} features, {thetas:,} thetas, {PARTICIPANTS} demonstrations; posteriors {size / 1e6:,.0f} MB"
    show(f"{title} on disk", ("stage", "time", "CPU time", "peak memory"), rows)
    record("hypotheses", {f"{features} features, {name}, MB": cost.memory / 1e6 for name, cost in costs.items()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--features", type=int, nargs="*", default=[3, 6, 7], help="how many, up to eight")
    arguments = parser.parse_args()
    reading()
    for features in arguments.features:
        memory(features)


if __name__ == "__main__":
    main()
