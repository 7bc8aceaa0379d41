"""What people expect of any command line: `--version`, `-h`, `--quiet`, `--json`, and a hint for a mistyped name."""

import json
import subprocess
import sys
from importlib.metadata import version

import pytest
import typer
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.cli.grouping import PANELS
from pipeline.terminal import note, quiet

RUNNER = CliRunner()
COMMANDS = typer.main.get_command(app).commands


def test_version_is_that_of_the_package():
    assert RUNNER.invoke(app, ["--version"]).output == f"lessbench {version('lessbench')}\n"


@pytest.mark.parametrize("command", [[], *([name] for name in COMMANDS), ["import", "ferl"]])
def test_short_help_is_the_help_and_names_no_type_for_a_switch(command):
    short, long = (RUNNER.invoke(app, [*command, option], env={"COLUMNS": "80"}) for option in ("-h", "--help"))

    assert short.exit_code == 0
    assert short.output == long.output
    assert "<bool>" not in short.output
    assert max(map(len, short.output.splitlines())) <= 80


def test_commands_are_grouped_by_what_a_person_wants():
    shown = RUNNER.invoke(app, ["-h"], env={"COLUMNS": "80"}).output

    places = [shown.index(f"─ {panel} ─") for panel in PANELS]
    assert places == sorted(places)
    assert all(command.rich_help_panel in PANELS for command in COMMANDS.values())


def test_a_mistyped_task_is_answered_with_the_nearest(make_project, parameters, monkeypatch):
    monkeypatch.chdir(make_project(parameters).root)

    result = RUNNER.invoke(app, ["verify", "swepe"])

    assert "there is no task 'swepe' in params.yaml (did you mean 'sweep'?)" in str(result.exception)


def test_summary_without_any_run_says_what_to_do(make_project, parameters, monkeypatch):
    monkeypatch.chdir(make_project(parameters).root)

    assert RUNNER.invoke(app, ["summary"]).output == "no stage has run yet; `dvc repro` runs all of them\n"
    assert json.loads(RUNNER.invoke(app, ["summary", "--json"]).output) == []


def test_quiet_leaves_notes_out(capsys):
    token = quiet.set(True)
    note("odd")
    quiet.reset(token)
    assert capsys.readouterr().err == ""

    note("odd")
    assert capsys.readouterr().err == "odd\n"


@pytest.mark.parametrize("megabytes", [700, 1200, 2500])
@pytest.mark.parametrize("command", ["sample sweep", "infer sweep", "run sweep"])
def test_with_too_little_memory_a_stage_says_so_at_once(make_project, parameters, command, megabytes):
    project = make_project(parameters)
    lessbench = f"ulimit -v {megabytes * 1024}; exec {sys.executable} -m pipeline {command}"

    done = subprocess.run(["bash", "-c", lessbench], cwd=project.root, capture_output=True, text=True, timeout=60)

    assert done.returncode == 1
    assert done.stderr.startswith(
        "lessbench: there is too little memory here to compute (the limit on the memory of a program (`ulimit -v`) is "
        f"{megabytes:,} MB, and a stage needs "
    )
    assert done.stderr.count("\n") == 1
