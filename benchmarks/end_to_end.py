"""From sampling to the posterior, a million alternatives and three features: `python -m benchmarks.end_to_end`.

Each stage is a process of its own, as `dvc repro` runs it, in a project in a temporary folder. `--growth` also runs the
stages with a quarter of the alternatives, to show what memory depends on.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from ruamel.yaml import YAML

from benchmarks.measuring import seconds, show

ROOT = Path(__file__).resolve().parents[1]
TASK = "table"
PREPARED = ("simulate", "ingest")
STAGES = ("sample", "featurize", "density", "infer")


@dataclass(frozen=True)
class Cost:
    """The cost of a process: wall-clock time, processor time of all its threads, and peak memory in bytes."""

    wall_s: float
    cpu_s: float
    memory: float


def write_project(root: Path, count: int, partition: int | None) -> None:
    """Write a project with one task of the repository and one set of `count` alternatives."""
    yaml = YAML(typ="safe", pure=True)
    parameters = yaml.load(ROOT / "params.yaml")
    parameters["tasks"] = {TASK: parameters["tasks"][TASK]}
    parameters["simulate"]["weights"] = {TASK: parameters["simulate"]["weights"][TASK]}
    parameters["sample"] |= {"sizes": [], "sets": 0, "working_set": count}
    parameters["compute"]["partition"] = partition or parameters["compute"]["partition"]
    yaml.dump(parameters, root / "params.yaml")
    for folder in ("robots", "scenes"):
        shutil.copytree(ROOT / "datasets" / folder, root / "datasets" / folder)


def run(root: Path, *command: str) -> Cost:
    """Run a command of `lessbench` in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    begin = time.perf_counter()
    with subprocess.Popen([sys.executable, "-m", "pipeline", *command], cwd=root, env=environment) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} failed")
    return Cost(time.perf_counter() - begin, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024.0)


def measured(count: int, partition: int | None) -> tuple[dict[str, Cost], dict[str, int]]:
    """Cost of each stage, and the size of each table in bytes."""
    with tempfile.TemporaryDirectory(prefix="lessbench-end-to-end-") as folder:
        root = Path(folder)
        write_project(root, count, partition)
        for stage in PREPARED:
            run(root, stage, TASK)
        costs = {stage: run(root, stage, TASK) for stage in STAGES}
        return costs, {
            path.stem: path.stat().st_size for path in (root / "datasets" / TASK / "tables").glob("*.parquet")
        }


def report(count: int, costs: dict[str, Cost], sizes: dict[str, int]) -> None:
    rows = [
        (stage, seconds(cost.wall_s), seconds(cost.cpu_s), f"{cost.memory / 1e6:,.0f} MB")
        for stage, cost in costs.items()
    ]
    total = sum(cost.wall_s for cost in costs.values()), sum(cost.cpu_s for cost in costs.values())
    rows.append(
        ("all", seconds(total[0]), seconds(total[1]), f"{max(cost.memory for cost in costs.values()) / 1e6:,.0f} MB")
    )
    large = ", ".join(f"{name} {size / 1e6:,.0f} MB" for name, size in sizes.items() if size > 1e7)
    show(f"{count:,} alternatives, 3 features; on disk: {large}", ("stage", "time", "CPU time", "peak memory"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000, help="alternatives")
    parser.add_argument("--partition", type=int, help="alternatives per part; that of params.yaml if not given")
    parser.add_argument("--growth", action="store_true", help="a quarter of the alternatives too")
    arguments = parser.parse_args()
    for count in [arguments.count // 4, arguments.count] if arguments.growth else [arguments.count]:
        report(count, *measured(count, arguments.partition))


if __name__ == "__main__":
    main()
