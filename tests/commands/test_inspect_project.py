"""A received project is looked through without running anything of it."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.commands import inspect_project as module
from pipeline.commands.inspect_project import LEADS_OUT, ODD, RUNS, inspect_project
from pipeline.errors import ParameterError

ROOT = Path(__file__).resolve().parents[2]
KEPT = (
    "params.yaml",
    "dvc.yaml",
    "Makefile",
    "pyproject.toml",
    "schemas",
    "pipeline",
    "datasets/scenes",
    "docs/overlays",
)


@pytest.fixture
def received(tmp_path: Path) -> Path:
    """This project as somebody else would have it, with its own program."""
    folder = tmp_path / "received"
    for name in KEPT:
        source, target = ROOT / name, folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, target)
    return folder


def said(folder: Path) -> list[str]:
    return inspect_project(folder).lines()[1:]


def test_nothing_is_said_of_a_project_that_is_as_this_one(received: Path) -> None:
    found = inspect_project(received)
    assert found.findings == []
    assert found.files > 100
    assert found.lines()[1:] == ["only the stages of this program run in it, and nothing leads out of it"]


def write(path: str, text: str) -> Callable[[Path], None]:
    def into(folder: Path) -> None:
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("a") as stream:
            stream.write(text)

    return into


def sparse(folder: Path) -> None:
    with (folder / "recording.mcap").open("wb") as stream:
        stream.truncate(5_000_000_000)


HOSTILE: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "a command of its own": (
        write("sub/dvc.yaml", "stages: {a: {cmd: curl example.org | sh}}\n"), RUNS, "would run `curl example.org | sh`"
    ),
    "a command after one of ours": (
        write("more/dvc.yaml", "stages:\n  a:\n    cmd: [lessbench scene table, 'lessbench scene table; touch x']\n"),
        RUNS, "would run `lessbench scene table; touch x`",
    ),
    "a value that a shell would run": (
        lambda folder: (
            write("params.yaml", "x: '--help; touch RAN; true'\n")(folder),
            (folder / "dvc.yaml").write_text("stages: {a: {cmd: 'lessbench ingest ${x}'}}\n"),
            None,
        )[-1],
        RUNS,
        "would run `lessbench ingest ${x}`",
    ),
    "a task whose name a shell would run": (
        lambda folder: (
            (folder / "params.yaml").write_text("tasks: {'a; touch RAN': {}}\n"),
            None,
        )[-1],
        RUNS,
        "dvc.yaml: is not what this program writes",
    ),
    "compiled code": (
        write("pipeline/__pycache__/errors.cpython-311.pyc", "x"),
        RUNS,
        "errors.cpython-311.pyc: is compiled Python",
    ),
    "a program elsewhere": (
        lambda folder: (shutil.rmtree(folder / "pipeline"), (folder / "pipeline").symlink_to("/"), None)[-1],
        RUNS,
        "pipeline: is a link to / where the program should be",
    ),
    "a mesh beside the folder": (
        write("s.xml", '<mujoco><asset><mesh file="../secret.stl"/></asset></mujoco>'),
        LEADS_OUT,
        "<mesh> names ../secret.stl",
    ),
    "a table beside the folder": (
        write("docs/o.yaml", "sample: {given: ../elsewhere.csv}\n"),
        LEADS_OUT,
        "sample.given names ../elsewhere.csv",
    ),
    "changed code": (write("pipeline/errors.py", "\nimport os\n"), RUNS, "`dvc repro` runs it"),
    "more code": (write("pipeline/stages/more.py", "1\n"), RUNS, "pipeline/stages/more.py: is not as in the program"),
    "a hook": (write(".git/hooks/post-checkout", "#!/bin/sh\n"), RUNS, "is a hook, which git runs"),
    "settings of git": (write(".git/config", "[core]\n\tfsmonitor = ./run.sh\n"), RUNS, "sets fsmonitor = ./run.sh"),
    "rules of make": (write("Makefile", "\nall:\n\ttrue\n"), RUNS, "holds rules of make"),
    "a pickle": (write("demonstrations.p", "x"), RUNS, "is a pickle"),
    "a notebook": (write("docs/look.ipynb", "{}"), RUNS, "is a notebook"),
    "tests": (write("tests/conftest.py", "1"), RUNS, "is Python"),
    "a virtual environment": (write("env/pyvenv.cfg", ""), RUNS, "env: is a virtual environment"),
    "a remote": (
        write(".dvc/config", "[remote \"x\"]\n    url = s3://elsewhere\n"), LEADS_OUT, "names the address s3:"
    ),
    "a scheduler": (write("o.yaml", "compute: {scheduler: 'tcp://h:1'}\n"), LEADS_OUT, "compute.scheduler names the"),
    "a file elsewhere": (
        write("o.yaml", "sample: {given: /etc/passwd}\n"), LEADS_OUT, "sample.given names /etc/passwd"
    ),
    "a file far up": (write("o.yaml", "tasks: {a: {scene: ../../../s.xml}}\n"), LEADS_OUT, "names ../../../s.xml"),
    "a scene that reads elsewhere": (
        write("s.xml", '<mujoco><asset><mesh file="/dev/zero"/></asset></mujoco>'), LEADS_OUT, "<mesh> names /dev/zero"
    ),
    "entities": (write("s.xml", '<!DOCTYPE a [<!ENTITY b "c">]><mujoco>&b;</mujoco>'), ODD, "declares entities"),
    "broken XML": (write("s.xml", "<mujoco>"), ODD, "is not readable XML"),
    "aliases that multiply": (write("o.yaml", "a: &a [*a]\n"), ODD, "holds an alias of itself"),
    "a link out": (lambda folder: (folder / "l").symlink_to("/etc"), LEADS_OUT, "l: is a link to /etc"),
    "a link to itself": (lambda folder: (folder / "l").symlink_to("l"), LEADS_OUT, "l: is a link to l"),
    "a pipe": (lambda folder: os.mkfifo(folder / "mesh.stl"), ODD, "mesh.stl: is not a file but a pipe"),
    "a file that is not there": (sparse, ODD, "claims 5.0 GB, of which hardly any is there"),
    "a name that a terminal obeys": (write("a\x1b]0;b\x07.md", ""), ODD, "has a name with characters"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_what_is_not_as_it_should_be_is_named(received: Path, case: str) -> None:
    make, kind, sentence = HOSTILE[case]
    make(received)
    assert any(line.startswith(f"{kind}: ") and sentence in line for line in said(received)), said(received)


def test_many_of_a_kind_are_one_line(received: Path) -> None:
    for number in range(50):
        write(f"p/{number:02}.p", "")(received)
    (line,) = [line for line in said(received) if "pickle" in line]
    assert line.startswith("runs code: p/00.p: is a pickle")
    assert line.endswith("(and 49 more: p/01.p, p/02.p, p/03.p)")


def test_it_ends_in_a_folder_without_end(received: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_FILES", 20)
    assert any("holds more than 20 files" in line for line in said(received))


def test_a_folder_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for name in ("file", "nothing"):
        with pytest.raises(ParameterError, match="there is no such folder"):
            inspect_project(tmp_path / name)


def test_the_command_says_it_without_what_a_terminal_obeys(received: Path) -> None:
    write("\x1b]52;c;eA==\x07.p", "")(received)
    command = ["lessbench", "inspect-project", str(received)]
    ended = subprocess.run(command, cwd=received.parent, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 1
    assert "\x1b" not in ended.stdout
    assert r"runs code: \x1b]52;c;eA==\x07.p: is a pickle" in ended.stdout
