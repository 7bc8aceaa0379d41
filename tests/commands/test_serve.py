"""`--live`: a recording is saved and served at once, on this machine only, to whoever connects."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.commands.serve import Live, claimed
from pipeline.errors import StageError
from pipeline.stages import density, featurize, infer, ingest, sample
from pipeline.views.rerun.recording import quiet_environment, viewer_command
from pipeline.views.rerun.server import Address, claim, open_beside, require_listening
from pipeline.workspace.project import Project
from tests.support.live_viewer import entities, lessbench, listening, not_blank, pictures, received

Make = Callable[[dict[str, Any]], Project]


@pytest.fixture
def inferred(make_project: Make, parameters: dict[str, Any]) -> Project:
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")
    return project


def outer_address() -> str | None:
    """An address by which other machines would reach this one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent: UDP only looks up the route
        except OSError:
            return None
        address = str(probe.getsockname()[0])
    return None if address.startswith("127.") else address


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc to read the listening sockets from")
@pytest.mark.parametrize("stage", ["inspect", "infer"])
def test_a_recording_is_served_here_only_and_saved(inferred: Project, tmp_path: Path, stage: str) -> None:
    with lessbench(inferred, stage, "sweep", "--live", "--port", "0", "--stay") as process:
        assert process.stdout is not None
        first, warned, second = (process.stdout.readline() for _ in range(3))
        said = re.fullmatch(r"serving the recording of sweep at (rerun\+http://127\.0\.0\.1:(\d+)/proxy)\n", first)
        assert said, first
        assert warned.startswith("every user of this machine can look at it and write into it")
        uri, port = said[1], int(said[2])
        assert second.startswith("no viewer was opened: there is no display here")
        assert second.endswith(f"connect one with: rerun {uri}\n")
        assert listening(port) == {"0100007F"}
        outside = outer_address()
        if outside:
            with pytest.raises(OSError, match="refused"):
                socket.create_connection((outside, port), timeout=5)
        # whole already, while it is being served
        path = inferred.datasets / "sweep" / "inspect.rrd"
        verified = subprocess.run(
            [viewer_command()[0], "rrd", "verify", str(path)], env=quiet_environment(), capture_output=True, check=False
        )
        assert verified.returncode == 0, verified.stderr
        saved = entities(path)
        assert "/summary" in saved
        assert received(uri, tmp_path / "received.rrd", "/summary") >= saved - {"/__properties/task"}
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 0
    assert listening(port) == set()


def test_the_real_viewer_shows_what_is_served(inferred: Project, tmp_path: Path) -> None:
    drawn = pictures()
    with lessbench(inferred, "inspect", "sweep", "--live", "--port", "0", "--stay") as process:
        assert process.stdout is not None
        uri = process.stdout.readline().split(" at ")[1].strip()
        with drawn.headless_viewer(uri) as viewer:
            drawn.show_moment(viewer, 1.0)
            time.sleep(1.0)
            # two features: no cube; no robustness study: no KLAggregate
            state = viewer.get_state()
            assert len(state.views) == 13
            assert [view.reports for view in state.views if view.reports] == []
            viewer.save_screenshot(str(tmp_path / "live.png"))
    not_blank(tmp_path / "live.png")


def test_in_a_pipe_it_ends_when_the_work_is_done(inferred: Project) -> None:
    with lessbench(inferred, "inspect", "sweep", "--live", "--port", "0") as process:
        said, complained = process.communicate(timeout=60)
    assert process.returncode == 0, complained
    assert said.splitlines()[-1] == "ending now; --stay keeps serving"


def test_a_port_in_use_is_said_before_any_work(inferred: Project) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with lessbench(inferred, "inspect", "sweep", "--live", "--port", str(port)) as process:
            said, complained = process.communicate(timeout=60)
    assert (process.returncode, said) == (1, "")
    assert complained == (
        f"lessbench: port {port} of 127.0.0.1 cannot be served (address already in use); choose another with --port, "
        "or --port 0 for any that is free\n"
    )
    assert not (inferred.datasets / "sweep" / "inspect.rrd").exists()


@pytest.mark.parametrize(
    ("bind", "port", "match"),
    [
        ("example.org", 0, "--bind is 'example.org'; it must be an IP address of this machine"),
        ("192.0.2.1", 0, "port 0 of 192.0.2.1 cannot be served"),
        ("127.0.0.1", 70000, "--port is 70000; it must be 1..65535, or 0"),
    ],
)
def test_an_address_that_cannot_be_had_is_refused(bind: str, port: int, match: str) -> None:
    with pytest.raises(StageError, match=match):
        claim(bind, port)


def test_other_machines_are_let_in_only_with_a_warning(capsys: pytest.CaptureFixture[str]) -> None:
    assert claimed(Live(bind="localhost", port=0)).local
    assert capsys.readouterr().err == ""
    open_to_all = claimed(Live(bind="0.0.0.0", port=0))
    assert not open_to_all.local
    assert open_to_all.uri == f"rerun+http://127.0.0.1:{open_to_all.port}/proxy"
    assert "can be reached from other machines" in capsys.readouterr().err
    assert Address("::1", 9876).uri == "rerun+http://[::1]:9876/proxy"


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.views.rerun.server._START_S", 0.2)
    with pytest.raises(StageError, match=r"does not answer; .* choose one with --port"):
        require_listening(claim(port=0))


def test_a_viewer_is_opened_where_there_is_a_display(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert open_beside(Address("127.0.0.1", 9)) == "there is no display here (DISPLAY and WAYLAND_DISPLAY are not set)"
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("pipeline.views.rerun.server.viewer_command", lambda: [str(tmp_path / "none")])
    assert open_beside(Address("127.0.0.1", 9)) == "the Rerun viewer is not installed here (pip install rerun-sdk)"
    fake, seen = tmp_path / "viewer", tmp_path / "seen"
    fake.write_text(f'#!/bin/sh\necho "$CI $@" > {seen}.new\nmv {seen}.new {seen}\n')
    fake.chmod(0o755)
    monkeypatch.setattr("pipeline.views.rerun.server.viewer_command", lambda: [str(fake), *viewer_command()[1:]])
    monkeypatch.setattr(subprocess, "Popen", waited_for := _Waited(subprocess.Popen))
    assert open_beside(Address("127.0.0.1", 9)) is None
    waited_for.wait()
    said = "true --bind 127.0.0.1 --port auto --hide-welcome-screen rerun+http://127.0.0.1:9/proxy\n"
    assert seen.read_text() == said


class _Waited:
    """Starts processes and remembers the last, so that a test leaves none behind."""

    def __init__(self, start: Callable[..., subprocess.Popen[bytes]]) -> None:
        self.start = start
        self.last: subprocess.Popen[bytes] | None = None

    def __call__(self, *arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        self.last = self.start(*arguments, **options)
        return self.last

    def wait(self) -> None:
        assert self.last is not None
        assert self.last.wait(timeout=30) == 0


def test_a_signal_ends_serving_and_its_handler_is_put_back() -> None:
    from pipeline.commands.serve import interrupted

    before = signal.getsignal(signal.SIGTERM)
    with interrupted() as stop:
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
        assert stop.wait(timeout=30)
    assert signal.getsignal(signal.SIGTERM) is before
