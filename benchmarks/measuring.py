"""What the benchmarks share: runs in separate processes, growth fits, tables, recorded results, test data."""

from __future__ import annotations

import datetime
import json
import math
import multiprocessing
import os
import platform
import resource
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Run:
    """Median seconds of the repetitions, peak memory of the process in bytes, and the last result."""

    seconds: float
    memory: float
    result: Any


def measured(function: Callable[..., Any], *args: Any, times: int = 1) -> Run:
    """Call `function(*args)`, which returns (seconds, result), `times` times in a fresh process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_repeat, (function, args, times))


def _repeat(function: Callable[..., Any], args: Sequence[Any], times: int) -> Run:
    runs = [function(*args) for _ in range(times)]
    return Run(statistics.median(seconds for seconds, _ in runs), _peak_bytes(), runs[-1][1])


def _peak_bytes() -> float:
    """Peak memory of this process; `ru_maxrss` would include what its parent held when it was started."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0
    return next(float(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def timed(function: Callable[..., Any], *args: Any, **options: Any) -> tuple[float, Any]:
    """Seconds and result of one call."""
    start = time.perf_counter()
    result = function(*args, **options)
    return time.perf_counter() - start, result


@dataclass(frozen=True)
class Growth:
    """seconds = factor x N^exponent, fitted to the two largest sizes, for which lower-order terms matter least."""

    factor: float
    exponent: float

    @classmethod
    def fitted(cls, sizes: Sequence[int], seconds: Sequence[float]) -> Growth:
        exponent = math.log(seconds[-1] / seconds[-2]) / math.log(sizes[-1] / sizes[-2])
        return cls(seconds[-1] / sizes[-1] ** exponent, exponent)

    def at(self, size: int) -> float:
        return self.factor * size**self.exponent


def clustered(count: int, features: int = 3, seed: int = 0) -> np.ndarray:
    """(count, features) points of eight normal clusters, 0.03 to 0.12 wide, with centres in a unit cube."""
    rng = np.random.default_rng(seed)
    centres, widths = rng.random((8, features)), rng.uniform(0.03, 0.12, 8)
    cluster = rng.integers(0, 8, count)
    return centres[cluster] + widths[cluster, None] * rng.normal(size=(count, features))


def show(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, and below it the number of cores and the load average."""
    table = Table(*columns, title=title, title_justify="left")
    for row in rows:
        table.add_row(*row)
    Console(width=150).print(table)
    Console().print(f"{os.cpu_count()} cores; load average {os.getloadavg()[0]:.1f}\n")


def record(file: str, costs: dict[str, float]) -> None:
    """Write unit costs to benchmarks/results/`file`.json, with machine and date; other costs in it are kept."""
    path = RESULTS / f"{file}.json"
    path.parent.mkdir(exist_ok=True)
    document = recorded(file) if path.is_file() else {}
    document.update({name: float(f"{value:.3g}") for name, value in costs.items()})
    document["date"] = datetime.date.today().isoformat()
    document["machine"] = f"{_processor()}, {os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f}"
    path.write_text(json.dumps(document, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def recorded(file: str) -> dict[str, Any]:
    """The unit costs that `record` wrote."""
    return dict(json.loads((RESULTS / f"{file}.json").read_text(encoding="utf-8")))


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def seconds(value: float) -> str:
    """A duration in seconds, minutes or hours."""
    if value < 120:
        return f"{value:.3g} s"
    return f"{value / 60:.3g} min" if value < 7200 else f"{value / 3600:.3g} h"
