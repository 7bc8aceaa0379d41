"""Every command in CONTRIBUTING.md is run here or by CI, and what the root's pages point to exists."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.kills import Undisturbed
from tests.support.small_project import ROOT, TASK, run

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PROGRAMS = "make|pytest|ruff|mypy|lint-imports|python|dvc|lessbench"
GENERATED = {
    "python -m pipeline.stages.dvc_yaml": "dvc.yaml",
    "python docs/make_tables.py": "docs/tables.md",
    "python docs/make_architecture.py": "ARCHITECTURE.md",
    "python docs/make_reference.py": "docs/command_line.md",
}
IN_PROJECT = (
    "dvc repro",
    "dvc repro infer@table",
    "lessbench verify",
    "lessbench summary",
    "lessbench check RECORDING",
    "dvc doctor",
)
ONE_FILE = "pytest -q tests/choice/test_models.py"


def commands() -> set[str]:
    """What the page tells a reader to type, in its blocks and in its text."""
    blocks = "\n".join(re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL))
    lines = {line.partition("  #")[0].strip() for line in blocks.splitlines() if line.strip()}
    return lines | set(re.findall(rf"`((?:{PROGRAMS})(?: [^`]+)?)`", PAGE))


def by_ci() -> set[str]:
    """The commands of CI's scripts, and of `make test`, which they run."""
    scripts = [
        line.strip() for name in ("run", "install_checks") for line in (ROOT / ".ci" / name).read_text().splitlines()
    ]
    _, _, recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\ntest: install-dev\n")
    made = {line.strip() for line in recipe.partition("\n\n")[0].splitlines()}
    assert "make test" in scripts
    return made | {command for line in scripts for command in re.findall(r"make (?:test|repro|install-dev|docs)", line)}


def test_every_command_is_run() -> None:
    alone = commands() - by_ci() - set(IN_PROJECT) - set(GENERATED) - {ONE_FILE, ". .venv/bin/activate"}
    (subset,) = alone  # some of the tests that `pytest -q` runs
    assert subset.startswith("pytest -q tests/")
    for folder in subset.split()[2:]:
        assert any((ROOT / folder).glob("**/test_*.py")), folder
    assert set(IN_PROJECT) | set(GENERATED) | {ONE_FILE} <= commands()


def test_one_file_is_tested() -> None:
    _, *words = ONE_FILE.split()
    done = subprocess.run([sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *words], cwd=ROOT, check=False)
    assert done.returncode == 0


@pytest.mark.timeout(900)
def test_the_commands_of_the_project_and_of_its_pages_do_what_the_page_says(
    undisturbed: Undisturbed, tmp_path: Path
) -> None:
    root = tmp_path / "project"
    shutil.copytree(undisturbed.root, root)
    shutil.copytree(ROOT / "docs", root / "docs", ignore=shutil.ignore_patterns("__pycache__", "pictures"))
    shutil.copy(ROOT / "ARCHITECTURE.md", root)
    for command, file in GENERATED.items():
        before = (root / file).read_bytes()
        run(root, *command.split())
        assert (root / file).read_bytes() == before, f"{command} changes {file}: run it"
    recording = min((root / "datasets" / TASK / "recordings").glob("*.mcap"))
    said = {command: run(root, *command.replace("RECORDING", str(recording)).split()).stdout for command in IN_PROJECT}
    assert "up to date" in said["dvc repro"]
    assert "as they were made" in said["lessbench verify"]
    assert recording.name in said["lessbench check RECORDING"]
    assert "Python" in said["dvc doctor"]


@pytest.mark.parametrize("name", ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"])
def test_what_a_page_points_to_exists(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    for target, anchor in re.findall(r"\]\(([^)#:]+)(?:#([^)]*))?\)", text):
        assert (ROOT / target).exists(), target
        if anchor:
            titles = re.findall(r"(?m)^#+ (.+)$", (ROOT / target).read_text(encoding="utf-8"))
            assert anchor in [title.lower().replace(" ", "-") for title in titles], f"{target}#{anchor}"
    for file in re.findall(r"`((?:pipeline|schemas|tests|docs|\.ci)/[\w/.]+)`", text):
        assert (ROOT / file).exists(), file


def test_lines_of_the_contributing_page_are_short() -> None:
    assert [line for line in PAGE.splitlines() if len(line) > 120 and not line.startswith("|")] == []
