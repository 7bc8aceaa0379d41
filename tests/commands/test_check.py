"""`lessbench check` on files, folders and datasets, for people and for programs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.commands.new_task import Wishes, add_task
from pipeline.commands.verify import verify
from pipeline.errors import ParameterError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import ingest
from pipeline.workspace.project import Project
from tests.support.recorded_forms import (
    NAMES,
    motion,
    states,
    write_hdf5,
    write_json,
    write_lerobot,
    write_ros1,
    write_ros2,
    write_table,
)  # fmt: skip

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
pytest.importorskip("h5py", reason="the extra `hdf5` is not installed")
Make = Callable[[dict[str, Any]], Project]
TIMES, POSITIONS = motion()


def message(time_ns: int, row: np.ndarray) -> dict[str, Any]:
    return {"timestamp": {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}, "name": NAMES, "position": list(row)}


@pytest.fixture
def every_form(make_project: Make, parameters: dict[str, Any]) -> Project:
    """The small project with one recording in every form, each 0.02 further than the one before."""
    parameters["tasks"]["sweep"] |= {"recordings": "forms"}
    project = make_project(parameters)
    folder = project.root / "forms"
    folder.mkdir()
    write_ros2(folder / "ros2", lambda store: states(store, 2))
    write_ros2(folder / "packed", lambda store: states(store, 2)[1:], "MCAP", "FILE", custom={"participant": "Ann"})
    write_ros1(folder / "ros1.bag", lambda store: states(store, 1)[2:])
    write_json(folder / "json.mcap", lambda t, q: message(t, q - 0.001))
    for place, ending in enumerate(("csv", "parquet", "npz")):
        columns = {name: POSITIONS[:, joint] + 0.001 * place for joint, name in enumerate(NAMES)}
        write_table(folder / f"table-{ending}.{ending}", {"t": (TIMES - TIMES[0]) / 1e9, **columns})
    write_lerobot(folder / "picks", "v3.0", 2)
    write_hdf5(folder / "lift.hdf5", 1)
    return project


def invoke(project: Project, monkeypatch: pytest.MonkeyPatch, *words: str) -> tuple[int, str]:
    monkeypatch.chdir(project.root)
    answer = CliRunner().invoke(app, list(words))
    assert answer.exception is None or isinstance(answer.exception, SystemExit), answer.exception
    return answer.exit_code, answer.stdout


NAMED = [
    "json", "lift_demo_0", "packed", "picks_episode_000000", "picks_episode_000001", "ros1", "ros2", "table-csv",
    "table-npz", "table-parquet",
]  # fmt: skip


def test_every_form_becomes_a_demonstration(every_form: Project) -> None:
    (every_form.root / "forms" / "lift.hdf5").rename(every_form.root / "lift.hdf5")  # whose joints have no names
    ingest.run(every_form, "sweep")
    rows = read_table(every_form.table("sweep", "demonstrations"), "demonstrations")
    assert rows["demonstration_id"].to_list() == [name for name in NAMED if name != "lift_demo_0"]
    assert dict(rows.select("demonstration_id", "source").rows())["picks_episode_000001"] == (
        "picks/data/chunk-000/file-000.parquet: episode 1"
    )
    assert dict(rows.select("demonstration_id", "participant").rows())["packed"] == "Ann"
    waypoints = rows["waypoints"].to_numpy()
    assert np.ptp(waypoints[:, -1], axis=0).max() < 0.05
    assert read_table(every_form.table("sweep", "rejected"), "rejected").height == 0
    assert verify(every_form, "sweep", sample=1).drift == []


def test_a_folder_of_every_form_is_checked(every_form: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    code, text = invoke(every_form, monkeypatch, "check", "forms")
    assert code == 0
    assert text.count(": usable") == len(NAMED)
    code, text = invoke(every_form, monkeypatch, "check", "forms", "--json")
    assert code == 0
    found = json.loads(text)
    assert len(found) == len(NAMED)
    assert {one["recording"] for one in found} >= {
        "forms/ros1.bag",
        "forms/picks/data/chunk-000/file-000.parquet: episode 1",
    }
    assert all(one["usable"] and len(one["poses"]["joints"]) == 3 for one in found)
    code, text = invoke(every_form, monkeypatch, "check", "forms", "--task", "sweep", "--json")
    assert code == 1
    told = {one["recording"]: one for one in json.loads(text)}
    refused = [name for name, one in told.items() if not one["usable"]]
    assert refused == ["forms/lift.hdf5: demo_0"]
    assert told[refused[0]]["reason"] == "joints-missing"
    assert told["forms/packed/packed.mcap.zstd"]["demonstration"]["participant"] == "Ann"


@pytest.mark.parametrize(
    ("path", "count"),
    [("ros2", 1), ("picks", 2), ("lift.hdf5", 1), ("table-csv.csv", 1), ("ros1.bag", 1), ("packed", 1)],
)
def test_each_alone_is_checked(every_form: Project, monkeypatch: pytest.MonkeyPatch, path: str, count: int) -> None:
    code, text = invoke(every_form, monkeypatch, "check", f"forms/{path}")
    assert code == 0, text
    assert text.count(": usable") == count


def test_what_is_no_recording_is_said(every_form: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    (every_form.root / "empty").mkdir()
    code, text = invoke(every_form, monkeypatch, "check", "empty", "--json")
    assert (code, [one["usable"] for one in json.loads(text)]) == (1, [False])
    (every_form.root / "empty" / "notes.txt").write_text("Ann was tired.")
    code, text = invoke(every_form, monkeypatch, "check", "empty")
    assert (code, "notes.txt: set aside, not-a-recording" in text) == (1, True)
    code, text = invoke(every_form, monkeypatch, "check", "nowhere.csv", "nowhere")
    assert code == 1
    assert text.count("cannot be used") == 2


def test_a_task_is_proposed_from_tables_that_need_a_word(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    folder = project.root / "tables"
    folder.mkdir()
    for number in range(2):
        columns = {f"q_{name}": POSITIONS[:, joint] + 0.01 * number for joint, name in enumerate(NAMES)}
        columns["q_swing"], columns["q_bend"] = np.rad2deg(columns["q_swing"]), np.rad2deg(columns["q_bend"])
        write_table(folder / f"a{number}.csv", {"clock": (TIMES - TIMES[0]) / 1e6, **columns})
    wishes = Wishes("pour", project.root / "gantry.xml", folder)
    with pytest.raises(ParameterError, match="no recording in it has joint states"):
        add_task(project, wishes)
    with pytest.raises(ParameterError, match=r"--reading unit.*'deg'.*it takes array"):
        add_task(project, Wishes("pour", project.root / "gantry.xml", folder, reading={"unit": "degrees"}))
    reading = {"time": "clock", "time_unit": "ms", "unit": "deg"}
    add_task(project, Wishes("pour", project.root / "gantry.xml", folder, reading=reading))
    fresh = Project(project.root)
    assert dict(fresh.params.task("pour").joint_names) == {f"q_{name}": name for name in NAMES}
    ingest.run(fresh, "pour")
    rows = read_table(fresh.table("pour", "demonstrations"), "demonstrations")
    np.testing.assert_allclose(rows["duration_s"], (TIMES[-1] - TIMES[0]) / 1e9, atol=0.1)
    waypoints = rows["waypoints"].to_numpy()  # the rail slides, so that its numbers are no degrees
    np.testing.assert_allclose(waypoints[:, -1], POSITIONS[-1] + 0.01 * np.arange(2)[:, None], atol=0.02)


def test_reading_is_given_on_the_command_line(
    make_project: Make, parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    project = make_project(parameters)
    (project.root / "lift").mkdir()
    write_hdf5(project.root / "lift" / "lift.hdf5")
    monkeypatch.chdir(project.root)
    words = ["new-task", "lift", "--scene", "gantry.xml", "--recordings", "lift", "--reading", "joints=rail,swing,bend"]
    answer = CliRunner().invoke(app, [*words, "--reading", "rate_hz=50"])
    assert answer.exit_code == 0, answer.output
    reading = Project(project.root).params.task("lift").reading
    assert reading is not None
    assert (reading.joints, reading.rate_hz) == (NAMES, 50.0)
    answer = CliRunner().invoke(app, [*words[:-1], "joints"])
    assert (answer.exit_code, "write KEY=VALUE" in str(answer.exception)) == (1, True)


def test_positions_in_degrees_are_remarked_without_a_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    time_s = np.linspace(0, 2, 101)
    swing = 1.5 * (1 - np.cos(np.pi * time_s / 2))
    for name, scale in (("rad", 1.0), ("deg", 180 / np.pi)):
        rows = "".join(f"{t},{scale * q}\n" for t, q in zip(time_s, swing, strict=True))
        (tmp_path / f"{name}.csv").write_text(f"time,swing\n{rows}")
    said = CliRunner().invoke(app, ["check", "rad.csv", "deg.csv"]).output
    assert said.count("remark: too fast for rad or m") == 1
    assert said.index("deg.csv: usable") < said.index("too fast for rad or m")
