"""A few hundred of the cases of `python -m tests.hostile.fuzz`, and that a case is the same whenever it is made."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.hostile import fuzz_files

ROOT = Path(__file__).resolve().parents[2]


def fuzz(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.hostile.fuzz", *words], cwd=ROOT, capture_output=True, text=True, timeout=280
    )


def test_hostile_recordings_end_as_a_demonstration_or_with_a_reason() -> None:
    done = fuzz("--cases", "298", "--first", "700", "--json")
    assert done.stdout, done.stderr
    found = json.loads(done.stdout)
    assert found["failures"] == []
    assert found["cases"] == sum(found["outcomes"].values()) == sum(found["with_salvage"].values()) == 298
    assert {"usable", "corrupt", "truncated", "too-large", "unsupported-compression", "not-mcap"} <= set(
        found["outcomes"]
    )
    assert found["with_salvage"]["salvaged"] > 10
    assert found["worst_megabytes"] < 1000


def test_hostile_tables_names_and_parameters_end_as_promised() -> None:
    found = fuzz_files.run(range(5_000, 5_220))
    assert found.failures == []
    assert set(found.by_kind) == set(fuzz_files.KINDS)
    assert sum(sum(endings.values()) for endings in found.by_kind.values()) == 220


def test_a_case_can_be_replayed_by_its_number() -> None:
    first, second = fuzz("--replay", "47"), fuzz("--replay", "47")
    assert first.returncode == 0, first.stdout
    files = [Path(done.stdout.split(":", 1)[0]) for done in (first, second)]
    try:
        assert files[0].read_bytes() == files[1].read_bytes()
    finally:
        for file in files:
            file.unlink()
