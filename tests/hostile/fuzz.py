"""Read broken and hostile recordings as `lessbench ingest` and `lessbench check` do, and say how each ended.

    python -m tests.hostile.fuzz --cases 10000       # all, in a few child processes
    python -m tests.hostile.fuzz --replay 1234       # one of them, and where its bytes were written

A child process takes a batch: its files lie in the folder of a small project, and the real stage ingests them, first as
they are and then with `ingest.salvage`. Every case is timed in processor seconds, its peak of resident memory is read
from the kernel, and whatever ends otherwise than in a demonstration or in a row of rejected.parquet is a failure.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.hostile.cases import HEAVY, LIGHT, case

ROOT = Path(__file__).resolve().parents[2]
SECONDS, MEGABYTES = 5.0, 1000.0
BATCH = 100
CEILING_BYTES = 6 << 30  # of address space: a child that goes astray must not take the machine with it


@dataclass
class Result:
    """How one case ended: the outcome without and with salvage, and the greatest cost of any one reading."""

    number: int
    kind: str
    size: int
    outcomes: list[str] = field(default_factory=list)
    seconds: float = 0.0
    megabytes: float = 0.0
    faults: list[str] = field(default_factory=list)


def main() -> int:
    """Run the cases and print the table; 1 if any case failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.fuzz", description="Hostile recordings by number.")
    parser.add_argument("--cases", type=int, default=10_000, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--processes", type=int, default=2, help="children at a time")
    parser.add_argument("--json", action="store_true", help="one line of JSON instead of the table")
    parser.add_argument("--replay", type=int, metavar="NUMBER", help="write this one case to a file and read it")
    parser.add_argument("--batch", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.batch:
        for result in read_batch([int(number) for number in given.batch.split(",")]):
            print(json.dumps(result.__dict__))
        return 0
    if given.replay is not None:
        return _replay(given.replay)
    numbers = list(range(given.first, given.first + given.cases))
    results = run(numbers, given.processes)
    print(json.dumps(summary(results)) if given.json else table(results))
    return int(any(result.faults for result in results))


def run(numbers: list[int], processes: int = 2) -> list[Result]:
    """Read all cases, a batch per child process."""
    batches = [numbers[first : first + BATCH] for first in range(0, len(numbers), BATCH)]
    with ThreadPoolExecutor(processes) as pool:
        return [result for results in pool.map(_child, batches) for result in results]


def _child(numbers: list[int]) -> list[Result]:
    words = [sys.executable, "-m", "tests.hostile.fuzz", "--batch", ",".join(map(str, numbers))]
    try:
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=120 + 20 * len(numbers))
    except subprocess.TimeoutExpired:
        return [_lost(number, "the batch it was in hangs") for number in numbers]
    if done.returncode != 0:
        end = (done.stderr.strip().splitlines() or [""])[-1]
        if len(numbers) == 1:
            return [_lost(numbers[0], f"the process ended with status {done.returncode}: {end}")]
        return [result for number in numbers for result in _child([number])]
    return [Result(**json.loads(line)) for line in done.stdout.splitlines()]


def _lost(number: int, fault: str) -> Result:
    made = case(number)
    return Result(number, made.kind, len(made.content), faults=[fault])


def read_batch(numbers: list[int]) -> list[Result]:
    """Write the cases into a project of their own and ingest it, within this process."""
    import resource

    from pipeline.formats.parquet.tables import read_table
    from pipeline.params import parse
    from pipeline.stages import ingest
    from pipeline.workspace.project import Project
    from tests.support.gantry_project import GANTRY, PARAMETERS, record

    resource.setrlimit(resource.RLIMIT_AS, (CEILING_BYTES, CEILING_BYTES))
    results: dict[str, Result] = {}
    allowed: dict[str, frozenset[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "gantry.xml").write_text(GANTRY)
        record(root / "mine" / "zzz.mcap")  # one that can be used, so that there is always a demonstration
        for number in numbers:
            made = case(number)
            name = f"{number:08d}.mcap"
            (root / "mine" / name).write_bytes(made.content)
            results[name] = Result(number, made.kind, len(made.content))
            allowed[name] = made.allowed
        for salvage in (False, True):
            document = json.loads(json.dumps(PARAMETERS))
            document["ingest"] |= {"on_rejected": "continue", "salvage": salvage}
            project = Project(root)
            project.__dict__["params"] = parse(document)
            with _observed(ingest, results):
                ingest.run(project, "sweep")
            _take_outcomes(results, read_table(project.table("sweep", "demonstrations"), "demonstrations"), "source")
            _take_outcomes(results, read_table(project.table("sweep", "rejected"), "rejected"), "source")
        for name, result in results.items():
            _check(root / "mine" / name, result)
    for name, result in results.items():
        _judge(result, allowed[name])
    return list(results.values())


def _take_outcomes(results: dict[str, Result], table: Any, source: str) -> None:
    for row in table.iter_rows(named=True):
        result = results.get(row[source])
        if result is None:
            continue
        if "reason" in row:
            result.outcomes.append(row["reason"])
            if not (row["detail"].isprintable() and row["detail"].endswith(".") and len(row["detail"]) <= 2000):
                result.faults.append(f"the reason is no clear sentence: {row['detail'][:200]!r}")
        else:
            result.outcomes.append("salvaged" if row["salvaged"] else "usable")


class _observed:
    """Measures reading and judging of a case within it; what they should not raise becomes a fault of the case."""

    def __init__(self, module: Any, results: dict[str, Result]) -> None:
        self.module, self.results = module, results
        self.real = {name: getattr(module, name) for name in ("read_bag", "demonstration_row")}

    def __enter__(self) -> None:
        self.module.read_bag = lambda bag, intake: self._observe("read_bag", bag.files[0].name, bag, intake)
        self.module.demonstration_row = lambda name, recording, intake: self._observe(
            "demonstration_row", recording.path.name, name, recording, intake
        )

    def __exit__(self, *_: object) -> None:
        for name, function in self.real.items():
            setattr(self.module, name, function)

    def _observe(self, function: str, file: str, *arguments: Any) -> Any:
        from pipeline.errors import RecordingError

        result = self.results.get(file)
        if result is None:
            return self.real[function](*arguments)
        try:
            return _measured(result, lambda: self.real[function](*arguments))
        except RecordingError:
            raise
        except Exception:
            result.faults.append(_last_lines())
            raise RecordingError("traceback", "It ended in a traceback.") from None


def _check(path: Path, result: Result) -> None:
    from pipeline.commands.check import report

    try:
        lines, usable = _measured(result, lambda: report(path, None, None))
    except Exception:
        result.faults.append(_last_lines())
        return
    if not all(line.isprintable() for line in lines):
        result.faults.append("check prints what a terminal would obey")
    if usable is not (result.outcomes[0] == "usable") and result.outcomes[0] not in _ONLY_FOR_A_TASK:
        result.faults.append(f"check says {'usable' if usable else 'unusable'}, ingest says {result.outcomes[0]}")


# what only ingest can see: it knows the task's joints, and looks at the motion and the metadata
_ONLY_FOR_A_TASK = {
    "does-not-move", "joints-missing", "reserved-name", "bad-metadata", "ambiguous-topic", "no-joint-states", "usable",
    "too-few-messages", "time-not-increasing", "not-finite", "out-of-range", "beyond-limits", "far-ends", "gap", "jump",
    "too-fast", "several-motions", "another-task", "copy",
}  # fmt: skip


def _measured(result: Result, act: Callable[[], Any]) -> Any:
    Path("/proc/self/clear_refs").write_text("5")  # the peak of resident memory begins anew
    began = time.process_time()
    try:
        return act()
    finally:
        result.seconds = max(result.seconds, time.process_time() - began)
        result.megabytes = max(result.megabytes, _peak_megabytes())


def _peak_megabytes() -> float:
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6


def _last_lines() -> str:
    return " | ".join(line.strip() for line in traceback.format_exc().strip().splitlines()[-3:])


def _judge(result: Result, allowed: frozenset[str]) -> None:
    if len(result.outcomes) != 2:
        result.faults.append(f"it is in {len(result.outcomes)} tables where it should be in one, twice")
    elif result.outcomes[0] == "salvaged":
        result.faults.append("it was salvaged without being asked for")
    elif allowed and not allowed.issuperset(result.outcomes):
        result.faults.append(f"it ended as {result.outcomes}, which it must not")
    if result.seconds > SECONDS:
        result.faults.append(f"it took {result.seconds:.1f} s of processor time, allowed are {SECONDS:g}")
    if result.megabytes > MEGABYTES:
        result.faults.append(f"it took {result.megabytes:.0f} MB, allowed are {MEGABYTES:g}")


def _replay(number: int) -> int:
    made = case(number)
    with tempfile.NamedTemporaryFile(prefix=f"case-{number}-", suffix=".mcap", delete=False) as stream:
        stream.write(made.content)
    (result,) = read_batch([number])
    print(f"{stream.name}: {made.kind}, {len(made.content)} bytes")
    print(
        f"{result.outcomes[0]}; with ingest.salvage {result.outcomes[-1]}; {result.seconds:.2f} s, "
        f"{result.megabytes:.0f} MB"
    )
    print("\n".join(result.faults))
    return int(bool(result.faults))


def summary(results: list[Result]) -> dict[str, Any]:
    """The figures of docs/promises.md."""
    slowest = max(results, key=lambda result: result.seconds)
    largest = max(results, key=lambda result: result.megabytes)
    plain, salvaged = (Counter(result.outcomes[i] for result in results if len(result.outcomes) == 2) for i in (0, 1))
    return {
        "cases": len(results),
        "kinds": len({result.kind for result in results}),
        "outcomes": dict(sorted(plain.items(), key=lambda item: -item[1])),
        "with_salvage": dict(sorted(salvaged.items(), key=lambda item: -item[1])),
        "worst_seconds": round(slowest.seconds, 2),
        "slowest": f"{slowest.number} ({slowest.kind})",
        "worst_megabytes": round(largest.megabytes),
        "largest": f"{largest.number} ({largest.kind})",
        "failures": [[result.number, result.kind, *result.faults] for result in results if result.faults],
    }


def table(results: list[Result]) -> str:
    """The same in words."""
    found = summary(results)
    return "\n".join(_lines(found))


def _lines(found: dict[str, Any]) -> Iterator[str]:
    yield f"{found['cases']:,} cases of {found['kinds']} kinds ({len(LIGHT)} light, {len(HEAVY)} heavy ones)"
    yield ""
    yield "| outcome | cases | with ingest.salvage |"
    yield "|---|---|---|"
    for outcome in sorted({*found["outcomes"], *found["with_salvage"]}):
        yield f"| {outcome} | {found['outcomes'].get(outcome, 0):,} | {found['with_salvage'].get(outcome, 0):,} |"
    yield ""
    yield f"longest: {found['worst_seconds']} s of processor time, case {found['slowest']}; allowed are {SECONDS:g} s"
    yield f"largest: {found['worst_megabytes']} MB resident, case {found['largest']}; allowed are {MEGABYTES:g} MB"
    yield f"failures: {len(found['failures'])}"
    yield from (f"  {number} {kind}: {'; '.join(faults)}" for number, kind, *faults in found["failures"])


if __name__ == "__main__":
    sys.exit(main())
