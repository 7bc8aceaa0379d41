"""A task's joints, from its parameters to its recordings and its alternatives."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import ParameterError, SceneError, StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.params import Params, load, parse
from pipeline.replay import replay
from pipeline.replay.surface import Surface
from pipeline.stages import ingest, sample, scene
from pipeline.workspace.project import Project
from pipeline.workspace.scenes import load_task_scene
from tests.support.gantry_project import GANTRY, record

Make = Callable[[dict[str, Any]], Project]
CASES = Path(__file__).resolve().parents[3] / "shared" / "cases"
DRAWER = """<body name="drawer" pos="0 2 0"><joint name="slide" type="slide" range="0 0.02"/>
  <geom type="box" size="0.1 0.1 0.1"/></body>"""


def with_drawer(make_project: Make, parameters: dict[str, Any], **settings: Any) -> Project:
    parameters["tasks"]["sweep"] |= settings
    parameters["sample"] |= {"sampler": "deformation", "sets": 1, "sizes": [5], "working_set": 5}
    project = make_project(parameters)
    text = GANTRY.replace("</worldbody>", f"{DRAWER}</worldbody>")
    for pose in ("-0.3 -0.6 0.1", "0.3 0.9 -0.2"):
        text = text.replace(f'qpos="{pose}"', f'qpos="{pose} 0.01"')
    (project.root / "gantry.xml").write_text(text)
    return project


def test_a_drawer_is_not_sampled_and_needs_no_recording(make_project: Make, parameters: dict[str, Any]) -> None:
    project = with_drawer(make_project, parameters)
    for stage in (scene, ingest, sample):
        stage.run(project, "sweep")
    drawn = read_table(project.table("sweep", "alternatives"), "alternatives")
    assert drawn["waypoints"].to_numpy().shape[2] == 3
    about = json.loads(project.scene_record("sweep").read_text())
    assert [joint["name"] for joint in about["joints"]] == ["rail", "swing", "bend"]
    assert any("slide stays at home" in remark for remark in about["remarks"])


def test_a_failure_names_the_joint_and_why(make_project: Make, parameters: dict[str, Any]) -> None:
    project = with_drawer(make_project, parameters, joints=["rail", "swing", "bend", "slide"])
    for number in range(3):
        record(
            project.root / "mine" / f"demo-{number}.mcap", bow=0.1 * number, names=("bend", "slide", "rail", "swing")
        )
    ingest.run(project, "sweep")
    with pytest.raises(StageError, match=r"Joint 'slide' left its limits, 0 to 0\.02.*the task's `joints`"):
        sample.run(project, "sweep")


def test_recordings_that_call_the_joints_otherwise(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    ingest.run(project, "sweep")
    first = read_table(project.table("sweep", "demonstrations"), "demonstrations")
    names = {f"lab/{joint}": joint for joint in ("bend", "rail")}
    parameters["tasks"]["sweep"]["joint_names"] = names
    mine = make_project(parameters)
    for number in range(3):
        renamed(mine.root / "mine" / f"demo-{number}.mcap", names)
    ingest.run(mine, "sweep")
    again = read_table(mine.table("sweep", "demonstrations"), "demonstrations")
    assert again.select("demonstration_id", "waypoints").equals(first.select("demonstration_id", "waypoints"))


def renamed(path: Path, names: dict[str, str]) -> None:
    from pipeline.formats.mcap.joint_states import read_joint_states, write_joint_states

    theirs = {ours: name for name, ours in names.items()}
    good = read_joint_states(path)
    write_joint_states(
        path, good.time_ns, [theirs.get(name, name) for name in good.names], good.positions, topic=good.topic,
        metadata=good.metadata,
    )  # fmt: skip


def test_a_name_for_a_joint_that_is_not_there(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["joint_names"] = {"a": "rial"}
    project = make_project(parameters)
    with pytest.raises(SceneError, match="'rial', and the joints of the task are bend, rail, swing"):
        load_task_scene(project, project.params.task("sweep"))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"joints": []}, r"tasks\.sweep\.joints"),
        ({"joints": ["a", "a"]}, "listed twice"),
        ({"joint_names": {"a": "rail", "b": "rail"}}, "'a' and 'b' are both called 'rail'"),
    ],
)
def test_mistakes_in_the_parameters(parameters: dict[str, Any], settings: dict[str, Any], message: str) -> None:
    parameters["tasks"]["sweep"] |= settings
    with pytest.raises(ParameterError, match=message):
        parse(parameters)


def test_older_parameters_go_on(parameters: dict[str, Any]) -> None:
    task = parse(parameters).task("sweep")
    assert (task.joints, dict(task.joint_names)) == (None, {})


def case(name: str) -> tuple[Params, Path]:
    if not CASES.is_dir():
        pytest.skip(f"the shared cases are not here: {CASES} does not exist")
    root = Path(__file__).resolve().parents[2]
    return load(root / "params.yaml", CASES / name / "overlay.yaml"), root


@pytest.mark.parametrize(
    ("name", "task"),
    [
        ("o41_included_arm_with_meshes", "mesh_case"),
        ("o42_scene_with_a_drawer", "drawer_case"),
        ("o43_site_end_effector_through_table", "site_case"),
    ],
)
def test_the_shared_cases(name: str, task: str, tmp_path: Path) -> None:
    parameters, _ = case(name)
    one = parameters.task(task)
    settings = {"scene": str(CASES / name / "scene.xml"), "recordings": str(CASES / name / "rec")}
    small = parameters.sample.model_copy(
        update={"sizes": (10,), "sets": 1, "working_set": 20, "sampler": "deformation"}
    )
    project = Project(tmp_path)
    project.__dict__["params"] = parameters.model_copy(
        update={"tasks": {task: one.model_copy(update=settings)}, "sample": small}
    )
    loaded = load_task_scene(project, project.params.task(task))
    assert loaded.joints == ("j1", "j2", "j3")
    ingest.run(project, task)
    sample.run(project, task)
    drawn = read_table(project.table(task, "alternatives"), "alternatives")["waypoints"].to_numpy()
    assert drawn.shape[2] == 3
    (motion,) = replay(loaded, drawn.astype(np.float64))
    assert float(Surface(loaded, "table_top").depth(motion).max()) < 1e-6  # the tip below the last body, too
