"""The command line: help that teaches, completion, and a terminal that is told what a pipe is not."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from pipeline.cli import app
from pipeline.cli.shared import tasks
from pipeline.workspace.project import Project
from tests.support.terminal import on_a_terminal

COUNTING = """
from pipeline.workspace.progress import tracked; import time; [time.sleep(0.15) for _ in tracked(range(8), 'counting')]
"""


def commands(group: Any, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, *path, name)
        if not hasattr(command, "commands") or command.invoke_without_command:
            yield (*path, name), command


ALL = dict(commands(typer.main.get_command(app)))


@pytest.mark.parametrize("path", ALL, ids=" ".join)
def test_help_teaches_by_an_example_that_exists(path: tuple[str, ...]) -> None:
    example = re.search(r"Example.*?`lessbench (.+?)`", ALL[path].help, re.DOTALL)
    assert example, f"`lessbench {' '.join(path)} --help` has no `Example: ...`"
    words = example[1].split()
    if words[0] == "--overlay":
        words = words[2:]
    assert tuple(words[: len(path)]) == path
    assert {word for word in words if word.startswith("--")} <= {
        option for parameter in ALL[path].params for option in parameter.opts
    }


def run(
    project: Project, *words: str, env: dict[str, str] | None = None, command: tuple[str, ...] = ("-m", "pipeline")
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *command, *words], cwd=project.root, env=os.environ | (env or {}), capture_output=True,
        text=True, check=True,
    )  # fmt: skip


def test_a_pipe_gets_the_answer_and_nothing_else(small: Project) -> None:
    done = run(small, "catalog")
    assert done.stdout + done.stderr == ""
    done = run(small, "sql", "select 1 as one", "--format", "csv")
    assert (done.stdout, done.stderr) == ("one\n1\n", "")
    assert "\x1b" not in run(small, "sql").stdout
    assert run(small, COUNTING, command=("-c",)).stderr == ""


def test_a_terminal_is_told_how_far_it_is_and_what_came_out(small: Project) -> None:
    shown = on_a_terminal(small.root, "-m", "pipeline", "catalog")
    assert re.search(r"\x1b\[[\d;]*mcatalog all\x1b\[0m: 0 tables, 0 rows, took \d+\.\d s", shown)
    assert "\x1b[" not in on_a_terminal(small.root, "-m", "pipeline", "catalog", env={"NO_COLOR": "1", "TERM": "dumb"})
    shown = on_a_terminal(small.root, "-c", COUNTING)
    assert re.search(r"counting .*[1-7]/8.* [\d.]+/s .*0:00:0\d", re.sub(r"\x1b\[[\d;?]*\w", "", shown))


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("lessbench inf", {"infer"}),
        ("lessbench infer ", {"table", "laptop", "human"}),
        ("lessbench view s", {"studies"}),
    ],
)
def test_tab_completes_commands_and_tasks(small: Project, line: str, offered: set[str]) -> None:
    asked = {"_LESSBENCH_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    code = "import sys; from pipeline.cli import main; sys.argv[0] = 'lessbench'; main()"
    assert set(run(small, code, env=asked, command=("-c",)).stdout.split()) == offered


def test_outside_a_project_completion_offers_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert tasks() == []


@pytest.fixture
def small(tmp_path: Path) -> Project:
    """A project that has computed nothing yet."""
    shutil.copy(Path(__file__).resolve().parents[2] / "params.yaml", tmp_path)
    return Project(tmp_path)
