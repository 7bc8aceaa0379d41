"""What `dvc repro` costs besides the stages' work: `python -m benchmarks.repro`.

The files of the default project are copied to a temporary folder without anything derived. There `dvc repro` runs once,
and twice more with nothing to do. Useful seconds are those that each stage records for its work; they do not include
DVC, starting Python and importing libraries.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from benchmarks.explained import explain
from benchmarks.measuring import record, show, timed

ROOT = Path(__file__).resolve().parents[1]


def copy(folder: Path) -> None:
    """Copy the files that git tracks into a folder, and make it a repository."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in listed.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)


def repro(folder: Path) -> float:
    """Seconds of one `dvc repro`."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPATH"] = str(folder)
    took, _ = timed(
        subprocess.run, ["dvc", "repro"], cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL
    )
    return took


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy(folder)
        cold = repro(folder)
        runs = [json.loads(path.read_text()) for path in (folder / ".lessbench" / "runs").glob("*.json")]
        idle = min(repro(folder) for _ in range(2))
    useful = sum(run["seconds"] for run in runs)
    by_stage: dict[str, float] = {}
    for run in runs:
        by_stage[run["stage"]] = by_stage.get(run["stage"], 0) + run["seconds"]
    longest = sorted(by_stage.items(), key=lambda item: -item[1])[:5]
    show(
        f"`dvc repro` of the default project, {len(runs)} stages",
        ("measure", "result"),
        [
            ("cold", f"{cold:.0f} s"),
            ("useful, inside the stages", f"{useful:.0f} s"),
            ("useful / cold", f"{useful / cold:.2f}"),
            ("the rest, per stage", f"{(cold - useful) / len(runs):.2f} s"),
            ("nothing to do", f"{idle:.2f} s"),
            ("longest stages, all tasks together", ", ".join(f"{stage} {took:.0f} s" for stage, took in longest)),
        ],
    )
    record(
        "repro",
        {"cold, s": cold, "useful, s": useful, "useful / cold": useful / cold, "nothing to do, s": idle},
    )


if __name__ == "__main__":
    explain(__doc__)
    main()
