"""`lessbench survey` as a process: where it listens, how it ends, and what it says of its file."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from pipeline.replay.scene import load_scene
from pipeline.survey.clips import HEIGHT, WIDTH, clips
from tests.support.gantry_project import GANTRY
from tests.support.listening import LOOPBACK, listening
from tests.support.recorded_motions import GOAL, START

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc to read the listening sockets from")
def test_it_listens_here_alone_and_ends_when_told_to(tmp_path: Path) -> None:
    command = [sys.executable, "-u", "-m", "pipeline", "survey", "--port", "0", "--choices", "c.csv"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True) as survey:
        assert survey.stdout is not None
        first = survey.stdout.readline()
        address = re.search(r"http://127\.0\.0\.1:\d+/", first)
        assert address, first
        assert listening(survey.pid) <= LOOPBACK
        assert listening(survey.pid)
        with urllib.request.urlopen(address[0], timeout=10) as page:
            assert page.status == 200
        survey.send_signal(signal.SIGINT)
        said, _ = survey.communicate(timeout=30)
        assert survey.returncode == 0
    assert "c.csv has 0 choices of 0 people; `lessbench study human-choice --choices c.csv`" in said
    assert (tmp_path / "c.csv").read_text().startswith("participant,trial,choice,group,")


def test_motions_are_drawn_within_the_picture(tmp_path: Path) -> None:
    (tmp_path / "gantry.xml").write_text(GANTRY)
    scene = load_scene(tmp_path / "gantry.xml", end_effector="tip")
    s = np.linspace(0, 1, 15)[:, None]
    paths = {f"bow{bow}": START + s * (GOAL - START) + bow * np.sin(np.pi * s) for bow in (0.0, 0.3)}

    drawn = clips(scene, paths)

    assert set(drawn) == set(paths)
    for clip in drawn.values():
        frames, path = clip["frames"], np.reshape(clip["path"], (-1, 2))
        assert len(frames) == len(path) == 15
        assert all(len(frame) > 0 for frame in frames)
        assert ((path >= 0) & (path <= [WIDTH, HEIGHT])).all()
    moved = np.concatenate(
        [np.array(points).reshape(-1, 2) for clip in drawn.values() for _, points in clip["frames"][0]]
    )
    assert (np.ptp(moved, axis=0) / [WIDTH, HEIGHT]).max() > 0.3, "the arm and not the floor fills the picture"
    assert drawn["bow0.0"]["frames"][7] != drawn["bow0.3"]["frames"][7]
    assert drawn["bow0.0"]["still"] == drawn["bow0.3"]["still"]
