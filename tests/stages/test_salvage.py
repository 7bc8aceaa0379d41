"""Recordings that are cut off: refused unless ingest.salvage says to use what stands before the cut."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from pipeline.errors import StageError
from pipeline.formats.mcap.joint_state_cdr import encode_joint_states
from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import ingest
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]
SCHEMA = (Path(__file__).resolve().parents[2] / "schemas" / "joint_state.ros2msg").read_bytes()


@pytest.fixture
def cut(make_project: Make, parameters: dict[str, Any]) -> Callable[[bool], Project]:
    """A project of which one recording, in many chunks, lacks its last fifth."""

    def make(salvage: bool) -> Project:
        parameters["ingest"]["salvage"] = salvage
        project = make_project(parameters)
        path = project.root / "mine" / "demo-1.mcap"
        good = read_joint_states(path)
        none = np.empty((len(good.time_ns), 0))
        rows = encode_joint_states(good.time_ns, good.names, (good.positions, none, none))
        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=3000)
            writer.start("ros2", "test")
            channel = writer.register_channel(
                "/arm/joints", "cdr", writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", SCHEMA)
            )
            for time_ns, row in zip(good.time_ns.tolist(), rows, strict=True):
                writer.add_message(channel, time_ns, row.tobytes(), time_ns)
            writer.finish()
        written = path.read_bytes()
        end = written.index(b"\x0f\x04" + bytes(7))  # the end of the data section
        path.write_bytes(written[: 4 * end // 5])
        return project

    return make


def test_a_cut_recording_is_refused_unless_asked(cut: Callable[[bool], Project]) -> None:
    project = cut(False)
    with pytest.raises(StageError, match=r"demo-1\.mcap \(truncated\).*ingest\.salvage"):
        ingest.run(project, "sweep")
    assert read_table(project.table("sweep", "rejected"), "rejected")["reason"].to_list() == ["truncated"]


def test_a_salvaged_demonstration_says_so_in_its_row(cut: Callable[[bool], Project]) -> None:
    project = cut(True)
    ingest.run(project, "sweep")
    rows = read_table(project.table("sweep", "demonstrations"), "demonstrations")
    assert rows["salvaged"].to_list() == [False, True, False]
    assert rows["lost"].is_null().to_list() == [True, False, True]
    assert "messages before" in rows["lost"][1]
    assert rows["duration_s"][1] < rows["duration_s"][0]
    assert read_table(project.table("sweep", "rejected"), "rejected").is_empty()


def test_what_is_no_file_is_rejected_and_not_waited_for(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["ingest"]["on_rejected"] = "continue"
    project = make_project(parameters)
    os.mkfifo(project.root / "mine" / "pipe.mcap")
    (project.root / "mine" / "folder.mcap").mkdir()
    (project.root / "mine" / "nowhere.mcap").symlink_to("gone.mcap")
    ingest.run(project, "sweep")
    rejected = read_table(project.table("sweep", "rejected"), "rejected")
    assert rejected["source"].to_list() == ["folder.mcap", "nowhere.mcap", "pipe.mcap"]
    assert set(rejected["reason"]) == {"unreadable"}


@pytest.mark.parametrize("salvage", [False, True])
def test_check_says_what_could_be_salvaged(cut: Callable[[bool], Project], salvage: bool) -> None:
    project = cut(salvage)
    words = [sys.executable, "-m", "pipeline", "check", "mine/demo-1.mcap", "--task", "sweep"]
    done = subprocess.run(words, cwd=project.root, capture_output=True, text=True, timeout=120)
    assert done.returncode == (0 if salvage else 1)
    first, second, *_ = done.stdout.splitlines()
    assert first.startswith("mine/demo-1.mcap: usable" if salvage else "mine/demo-1.mcap: cannot be used, truncated:")
    assert ("is salvaged" if salvage else "can be salvaged") in second
    assert "poses on /arm/joints" in second
