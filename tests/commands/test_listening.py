"""What listens is named here, and is seen from the outside to listen on the loopback address alone."""

from __future__ import annotations

import re
import subprocess
import time
from pathlib import Path

import pytest
import typer

from pipeline.cli import app
from pipeline.views.rerun.recording import quiet_environment, viewer_command
from tests.support.listening import LOOPBACK, listening

ROOT = Path(__file__).resolve().parents[2]
# Every command that listens, with the test that looks at its sockets from the outside; a new one must be named here.
LISTENING = {
    "view": "test_listening.py: test_the_viewer_listens_on_the_loopback_address_alone",
    "infer": "test_serve.py: test_a_recording_is_served_here_only_and_saved",
    "inspect": "test_serve.py: test_a_recording_is_served_here_only_and_saved",
    "survey": "test_survey.py: test_it_listens_here_alone_and_ends_when_told_to",
    "watch": "test_watch.py: test_it_serves_while_it_watches_and_keeps_what_it_has_when_told_to_end",
}
# Every module that opens a socket to listen on, or starts a program that does.
OPENING = {"pipeline/views/rerun/recording.py", "pipeline/views/rerun/server.py", "pipeline/survey/server.py"}


def test_every_command_that_listens_is_named_and_its_test_is_there() -> None:
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    serving = {
        name for name, command in commands.items() if {"bind", "port"} & {option.name for option in command.params}
    }
    assert serving | {"view"} == set(LISTENING)
    for where in LISTENING.values():
        file, test = where.split(": ")
        assert f"def {test}(" in (Path(__file__).parent / file).read_text()


def test_every_command_that_can_be_bound_elsewhere_is_bound_here_unless_told() -> None:
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for name in set(LISTENING) - {"view"}:
        (bind,) = (option for option in commands[name].params if option.name == "bind")
        assert bind.default == "127.0.0.1"


def test_no_other_module_listens() -> None:
    word = re.compile(
        r"serve_grpc|serve_web|socketserver|http\.server|create_server|\.bind\(|\.listen\(|--bind|dashboard_address"
    )
    found = {
        path.relative_to(ROOT).as_posix() for path in (ROOT / "pipeline").rglob("*.py") if word.search(path.read_text())
    }
    assert found == OPENING


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc to read the listening sockets from")
def test_the_viewer_listens_on_the_loopback_address_alone() -> None:
    # as `lessbench view` starts it, but without a window
    with subprocess.Popen(
        [*viewer_command(), "--serve-grpc"], env=quiet_environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as process:
        try:
            found: set[str] = set()
            for _ in range(600):
                found = listening(process.pid)
                if found:
                    break
                assert process.poll() is None
                time.sleep(0.1)
        finally:
            process.kill()
    assert found
    assert found <= LOOPBACK
