"""A user's mistake: one clear sentence, exit status 1, and earlier outputs as they were."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from ruamel.yaml import YAML

from pipeline.formats.parquet.tables import read_table
from pipeline.workspace.project import Project
from tests.support.gantry_project import record

Make = Callable[[dict[str, Any]], Project]
Change = Callable[[Project], None]


def run(project: Project, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pipeline", *words], cwd=project.root, capture_output=True, text=True, timeout=120
    )


def change(project: Project, path: str, value: object) -> None:
    document = YAML(typ="safe", pure=True).load((project.root / "params.yaml").read_text())
    node = document
    *folders, last = path.split(".")
    for folder in folders:
        node = node[folder]
    node[last] = value
    with (project.root / "params.yaml").open("w") as stream:
        YAML(typ="safe", pure=True).dump(document, stream)


def bad(project: Project) -> Path:
    return project.root / "mine" / "demo-1.mcap"


def wrong_joints(project: Project) -> None:
    record(bad(project), names=("a", "b", "c"))


def no_joint_states(project: Project) -> None:
    with bad(project).open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/chatter", "json", writer.register_schema("Text", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()


def one_message(project: Project) -> None:
    rewrite(project, lambda time_ns, q: (time_ns[:1], q[:1]))


def nan_position(project: Project) -> None:
    rewrite(project, lambda time_ns, q: (time_ns, np.where(np.arange(len(q))[:, None] == 50, np.nan, q)))


def backwards(project: Project) -> None:
    rewrite(project, lambda time_ns, q: (time_ns[::-1], q))


def rewrite(project: Project, alter: Callable[[Any, Any], tuple[Any, Any]]) -> None:
    """The recording with altered content, past the checks of our own writer."""
    from pipeline.formats.mcap.joint_state_cdr import encode_joint_states
    from pipeline.formats.mcap.joint_states import read_joint_states

    good = read_joint_states(bad(project))
    time_ns, q = alter(good.time_ns, good.positions)
    schema = (Path(__file__).resolve().parents[2] / "schemas" / "joint_state.ros2msg").read_bytes()
    rows = encode_joint_states(time_ns, good.names, (q, np.empty((len(q), 0)), np.empty((len(q), 0))), "")
    with bad(project).open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema_id = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", schema)
        channel = writer.register_channel("/arm/joints", "cdr", schema_id)
        for place, row in enumerate(rows):
            writer.add_message(channel, int(good.time_ns[0]) + place, row.tobytes(), int(time_ns[place]))
        writer.finish()


def truncated(project: Project) -> None:
    bad(project).write_bytes(bad(project).read_bytes()[:-2000])


def empty_folder(project: Project) -> None:
    for file in (project.root / "mine").iterdir():
        file.unlink()


MISTAKES: dict[str, tuple[str, Change, str]] = {
    "wrong joint names": ("ingest", wrong_joints, r"demo-1\.mcap \(joints-missing\): .*rail"),
    "no JointState topic": ("ingest", no_joint_states, r"demo-1\.mcap \(no-joint-states\): .*/chatter"),
    "NaN position": ("ingest", nan_position, r"demo-1\.mcap \(not-finite\)"),
    "one message": ("ingest", one_message, r"demo-1\.mcap \(too-few-messages\)"),
    "time backwards": ("ingest", backwards, r"demo-1\.mcap \(time-not-increasing\)"),
    "truncated file": ("ingest", truncated, r"demo-1\.mcap \(truncated\)"),
    "empty folder": ("ingest", empty_folder, r"mine: there is no recording"),
    "missing MJCF": ("featurize", lambda p: change(p, "tasks.sweep.scene", "nowhere.xml"), r"nowhere\.xml"),
    "broken MJCF": ("featurize", lambda p: (p.root / "gantry.xml").write_text("<mujoco><bod"), r"gantry\.xml"),  # type: ignore[dict-item, return-value]
    "unknown end effector": ("ingest", lambda p: change(p, "tasks.sweep.end_effector", "hand"), r"'hand'.*tip"),
    "unknown feature": (
        "featurize",
        lambda p: change(p, "tasks.sweep.features.effort.kind", "grace"),
        r"'grace'.*proximity",
    ),
    "unknown object": ("featurize", lambda p: change(p, "tasks.sweep.features.vase.object", "jar"), r"'jar'.*vase"),
    "theta of wrong length": (
        "infer",
        lambda p: change(p, "tasks.sweep.thetas", [[1, 2, 3]]),
        r"thetas\[0\] has 3 numbers.*2",
    ),
    "unknown task": ("infer", lambda p: None, "no task 'wipe'"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_ends_in_one_sentence(make_project: Make, parameters: dict[str, Any], mistake: str) -> None:
    from pipeline.stages import density, featurize, infer, ingest, sample

    parameters["sample"] |= {"sampler": "deformation", "sets": 1, "sizes": [5]}
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")
    stage_name, make_mistake, message = MISTAKES[mistake]
    make_mistake(project)
    before = {file: file.read_bytes() for file in project.datasets.rglob("*.parquet") if file.stem != "rejected"}
    done = run(project, stage_name, "wipe" if mistake == "unknown task" else "sweep")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith("lessbench: ")
    assert done.stderr.count("\n") == 1
    import re

    assert re.search(message, done.stderr), done.stderr
    after = {file: file.read_bytes() for file in project.datasets.rglob("*.parquet") if file.stem != "rejected"}
    assert after == before
    assert not list(project.root.rglob("*.partial"))


def test_all_recordings_are_looked_at_and_the_bad_ones_listed(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    nan_position(project)
    record(project.root / "mine" / "demo-2.mcap", names=("a", "b"))
    done = run(project, "ingest", "sweep")
    assert done.returncode == 1
    assert "2 of 3 recordings in mine cannot be used: demo-1.mcap (not-finite)" in done.stderr
    rejected = read_table(project.table("sweep", "rejected"), "rejected")
    assert rejected.select("source", "reason").rows() == [
        ("demo-1.mcap", "not-finite"),
        ("demo-2.mcap", "joints-missing"),
    ]
    assert not project.table("sweep", "demonstrations").exists()

    change(project, "ingest.on_rejected", "continue")
    assert run(project, "ingest", "sweep").returncode == 0
    kept = read_table(project.table("sweep", "demonstrations"), "demonstrations")
    assert kept["demonstration_id"].to_list() == ["demo-0"]


def test_check_says_what_a_recording_holds(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    good = run(project, "check", "mine/demo-0.mcap", "--task", "sweep")
    assert good.returncode == 0
    assert "mine/demo-0.mcap: usable" in good.stdout
    assert "/arm/joints: sensor_msgs/msg/JointState in cdr, 280 messages, 2.79 s, 100.0 Hz" in good.stdout
    truncated(project)
    both = run(project, "check", "mine/demo-0.mcap", "mine/demo-1.mcap")
    assert both.returncode == 1
    assert "mine/demo-1.mcap: cannot be used, truncated" in both.stdout


def test_a_new_task_for_somebody_elses_arm(make_project: Make, parameters: dict[str, Any]) -> None:
    from pipeline.stages import density, featurize, infer, ingest, sample

    project = make_project(parameters)
    done = run(project, "new-task", "wave", "--scene", "gantry.xml", "--recordings", "mine")
    assert done.returncode == 0, done.stderr
    assert "then run: lessbench run wave" in done.stdout  # without dvc.yaml
    fresh = Project(project.root)
    assert fresh.params.task("wave").end_effector == "tip"
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(fresh, "wave")
    assert fresh.table("wave", "posteriors").exists()
    again = run(project, "new-task", "wave", "--scene", "gantry.xml", "--recordings", "mine")
    assert again.returncode == 1
    assert "task 'wave' already" in again.stderr


def test_answers_for_other_programs(make_project: Make, parameters: dict[str, Any]) -> None:
    import json

    from pipeline.stages import catalog, ingest

    project = make_project(parameters)
    ingest.run(project, "sweep")
    catalog.run(project)
    question = "select demonstration_id, [1, 2] as pair, null as nothing from demonstrations order by all limit 1"
    row = {"demonstration_id": "demo-0", "pair": [1, 2], "nothing": None}
    assert json.loads(run(project, "sql", question, "--format", "json").stdout) == [row]
    assert run(project, "sql", question, "--format", "csv").stdout == (
        'demonstration_id,pair,nothing\ndemo-0,"[1, 2]",\n'
    )
    listed = run(project, "sql").stdout
    assert "demonstrations" in listed
    assert "Questions to begin with" in listed
