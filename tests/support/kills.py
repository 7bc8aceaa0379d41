"""Kill `dvc repro` with all its children at random moments, and see whether the next one gives the same files.

`python -m tests.support.kills --moments 100` does it in a folder of its own and prints what happened.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from ruamel.yaml import YAML

from tests.support import small_project

SEED = 20200323
FROM_NOTHING = 20  # every so many moments the run starts from nothing, else from one stage's outputs removed


class Undisturbed:
    """The project in a folder after one run that nobody disturbs.

    Attributes:
        outputs: what that run gave (`small_project.outputs`).
        stages: what each stage writes.
        run_s, idle_s: how long a run from nothing takes, and one that has nothing to do.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        small_project.make_small_project(root)
        self.run_s = _timed(root)
        self.idle_s = _timed(root)
        self.outputs = small_project.outputs(root)
        lock = YAML(typ="safe").load((root / "dvc.lock").read_text())
        self.stages = {name: [out["path"] for out in stage["outs"]] for name, stage in lock["stages"].items()}


def disturb(project: Undisturbed, number: int) -> str:
    """Remove what a stage wrote, start `dvc repro`, kill it at a moment, and start it again.

    Returns:
        what the kill met, for the count.

    Raises:
        AssertionError: a file was torn, something was lost, or a process survived.
    """
    rng = random.Random(f"{SEED}/{number}")
    root, stages = project.root, list(project.stages)
    stage = stages[number % len(stages)]
    everything = number % FROM_NOTHING == FROM_NOTHING - 1
    outs = [out for name, outs in project.stages.items() if everything or name == stage for out in outs]
    limit = project.run_s if everything else project.idle_s + (project.run_s - project.idle_s) / len(stages)
    for _ in range(5):
        _remove(root, [*outs, "dvc.lock"] if everything else outs)
        moment = rng.uniform(0, limit)
        begin = time.monotonic()
        if _killed_after(root, moment):
            break
        limit = time.monotonic() - begin  # this run took less: the next moment lies within it
    _expect_nothing_torn(project)
    mended = small_project.run(root, "lessbench", "recover").stdout.strip()
    small_project.run(root, "dvc", "repro")
    after = small_project.outputs(root)
    assert after == project.outputs, f"moment {number} ({stage}, {moment:.2f} s): {_difference(after, project.outputs)}"
    if mended != "nothing to repair":
        return "while DVC wrote dvc.lock or its list of users, which lessbench recover mended"
    return "anywhere in a run from nothing" if everything else f"in a run of {stage}"


def _killed_after(root: Path, delay_s: float) -> bool:
    """Start a run and kill it; False if it has ended before the moment came."""
    with subprocess.Popen(
        [Path(sys.executable).parent / "dvc", "repro"], cwd=root, env=small_project.environment(root),
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    ) as process:  # fmt: skip
        try:
            process.wait(delay_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            for _ in range(100):
                if not _alive(process.pid):
                    return True
                time.sleep(0.1)
            raise AssertionError("a process of the killed run is still there") from None
    return False


def _alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def _expect_nothing_torn(project: Undisturbed) -> None:
    for name, expected in project.outputs.items():
        path = project.root / name
        if path.is_file() and "/." not in name:
            assert small_project.sha256(path) == expected, f"{name} is there and is not whole"


def _remove(root: Path, names: list[str]) -> None:
    for path in (root / name for name in names):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _timed(root: Path) -> float:
    begin = time.monotonic()
    small_project.run(root, "dvc", "repro")
    return time.monotonic() - begin


def _difference(found: dict[str, str], expected: dict[str, str]) -> str:
    return ", ".join(sorted(name for name in found.keys() | expected if found.get(name) != expected.get(name)))


def main() -> None:
    """Print one line per moment and the count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=100)
    wanted = parser.parse_args().moments
    with tempfile.TemporaryDirectory() as folder:
        project = Undisturbed(Path(folder) / "project")
        print(f"a run from nothing took {project.run_s:.0f} s, {len(project.stages)} stages", flush=True)
        met: Counter[str] = Counter()
        for number in range(wanted):
            what = disturb(project, number)
            met[what] += 1
            print(f"{number + 1:4d} {what}", flush=True)
    print(f"\nkilled at {wanted} moments; each time the next `dvc repro` gave the same {len(project.outputs)} files:")
    for what, count in sorted(met.items()):
        print(f"{count:5d} {what}")


if __name__ == "__main__":
    main()
