"""`lessbench new-task` proposes a task, adds it to params.yaml and nothing else, and to what waits for every task."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.commands.new_task import Wishes, add_task
from pipeline.commands.remove_task import remove_task
from pipeline.errors import ParameterError, SceneError
from pipeline.formats.mcap.joint_states import read_joint_states, write_joint_states
from pipeline.params import parse, value_at
from pipeline.stages import ingest, scene
from pipeline.stages.dvc_yaml import dvc_yaml
from pipeline.stages.registry import STAGES, Scope, parameters
from pipeline.workspace.project import Project, recorded_runs
from tests.support.gantry_project import PARAMETERS, record

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def project(make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any]) -> Project:
    made = make_project(parameters)
    (made.root / "dvc.yaml").write_text(_written())
    return made


@cache
def _written() -> str:
    return dvc_yaml(parse(PARAMETERS))


def added(project: Project, name: str) -> str:
    return "\n".join(add_task(project, Wishes(name, project.root / "gantry.xml", project.root / "mine")))


def test_dvc_yaml_is_then_as_the_registry_writes_it(project: Project) -> None:
    file = project.root / "dvc.yaml"
    before = file.read_text()
    assert "dvc repro inspect@pour" in added(project, "pour").splitlines()[-1]
    after = file.read_text()
    assert after == dvc_yaml(Project(project.root).params)
    assert "datasets/pour/tables" in after
    assert "datasets/pour/figures/posterior.svg" in after
    start = before.index("  catalog:")
    assert after[:start] == before[:start]


def test_stages_of_ones_own_stay(project: Project) -> None:
    file = project.root / "dvc.yaml"
    file.write_text(file.read_text().replace("stages:\n", "stages:\n  mine:\n    cmd: echo\n"))
    added(project, "pour")
    assert file.read_text() == dvc_yaml(Project(project.root).params).replace(
        "stages:\n", "stages:\n  mine:\n    cmd: echo\n"
    )


def test_a_catalog_changed_by_hand_is_left_alone_and_said(project: Project) -> None:
    file = project.root / "dvc.yaml"
    mine = file.read_text().replace("datasets/sweep/tables, ", "")
    file.write_text(mine)
    assert "write it anew with that command, or name the tasks in its last stages by hand" in added(project, "pour")
    assert file.read_text() == mine
    assert "pour" in Project(project.root).params.tasks


def test_without_dvc_there_is_nothing_to_say(project: Project) -> None:
    (project.root / "dvc.yaml").unlink()
    assert "dvc.yaml" not in added(project, "pour")
    assert not Path(project.root / "dvc.yaml").exists()


def test_nothing_else_in_the_file_changes(project: Project) -> None:
    file = project.root / "params.yaml"
    shutil.copy(ROOT / "params.yaml", file)  # with comments
    before = file.read_text()
    said = added(Project(project.root), "pour")
    after = file.read_text()
    begin = after.index("  pour:\n")
    block = re.match(r"  pour:\n(?: {4}.*\n)+", after[begin:])
    assert block is not None
    assert after[:begin] + after[begin + block.end() :] == before
    assert "Joints of the arm: rail, swing, bend, which all 3 recordings have." in said
    assert "End effector: tip, the hand of these joints" in said
    assert "Surface: floor" in said
    assert "Anchor: task, as 3 of 3 recordings start and end near" in said
    assert Project(project.root).params.task("pour").joints == ("rail", "swing", "bend")


def test_a_removed_task_leaves_nothing_behind(project: Project) -> None:
    before = contents(project)
    added(project, "pour")
    mine = Project(project.root)
    for stage in (scene, ingest):
        stage.run(mine, "pour")
    lock = {"schema": "2.0", "stages": {"ingest@pour": {"cmd": "x"}, "ingest@sweep": {"cmd": "y"}}}
    (project.root / "dvc.lock").write_text(json.dumps(lock))
    lines = remove_task(Project(project.root), "pour")
    assert "gantry.xml, mine" in lines[1]
    assert "pour" not in (project.root / "dvc.lock").read_text()
    (project.root / "dvc.lock").unlink()
    assert contents(project) == before


def test_simulated_recordings_go_and_recorded_ones_stay(project: Project) -> None:
    for task in ("sweep", "pour"):
        if task == "pour":
            added(project, "pour")
        folder = project.datasets / task / "recordings"
        shutil.copytree(project.root / "mine", folder)
    remove_task(Project(project.root), "sweep")  # which has simulated people
    assert not (project.datasets / "sweep").exists()
    with pytest.raises(ParameterError, match="'pour' is the only task"):
        remove_task(Project(project.root), "pour")
    assert (project.datasets / "pour" / "recordings" / "demo-0.mcap").is_file()


def test_adding_an_arm_makes_no_other_task_stale(project: Project) -> None:
    """Every stage but those of the whole project is written as before, and reads the same parameters and files."""
    before = Project(project.root)
    added(before, "pour")
    after = Project(project.root)
    first, second = (YAML(typ="safe").load(dvc_yaml(one.params))["stages"] for one in (before, after))
    for one in STAGES:
        if one.scope is Scope.PROJECT:
            continue
        assert first[one.name] == second[one.name]
        for path in parameters(one.name, "sweep"):
            assert value_at(before.params, path) == value_at(after.params, path)


def test_names_that_differ_by_a_prefix_are_proposed(project: Project) -> None:
    for file in (project.root / "mine").iterdir():
        record(file, names=("lab/bend", "gripper", "lab/rail", "lab/swing"))
    joints = {f"lab/{name}": name for name in ("bend", "rail", "swing")}
    for number, file in enumerate(sorted((project.root / "mine").iterdir())):
        record(file, bow=0.1 * number)
        rename(file, {ours: theirs for theirs, ours in joints.items()})
    said = added(project, "pour")
    assert "The recordings call them otherwise: lab/bend: bend, lab/rail: rail, lab/swing: swing." in said
    fresh = Project(project.root)
    assert dict(fresh.params.task("pour").joint_names) == joints
    ingest.run(fresh, "pour")


def rename(file: Path, names: dict[str, str]) -> None:
    good = read_joint_states(file)
    write_joint_states(
        file, good.time_ns, [names.get(name, name) for name in good.names], good.positions, topic=good.topic,
        metadata=good.metadata,
    )  # fmt: skip


def test_what_is_odd_is_said_beforehand(project: Project) -> None:
    scene_file = project.root / "gantry.xml"
    scene_file.write_text(scene_file.read_text().replace("0.3 0.9 -0.2", "0.9 -1.9 -0.2"))
    said = added(project, "pour")
    assert "Anchor: demonstration, as 3 of 3 recordings start or end far from the scene's keyframes." in said
    record(project.root / "mine" / "bad.mcap", goal=(3.0, 0.9, -0.2))
    said = added(project, "scoop")
    assert "bad.mcap (beyond-limits): At" in said


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        ({"joints": ("rail", "elbow")}, "no hinge or slide joint named 'elbow'"),
        ({"joint_names": {"a": "rail", "b": "swing", "c": "bend"}}, "no name is the same.*--joint-name RECORDED=SCENE"),
        ({"recordings": Path("nowhere")}, "no recording in it has joint states"),
    ],
)
def test_wishes_that_cannot_be_met(project: Project, wishes: dict[str, Any], message: str) -> None:
    before = contents(project)
    given = {"recordings": project.root / "mine"} | wishes
    with pytest.raises((ParameterError, SceneError), match=message):
        add_task(project, Wishes("pour", project.root / "gantry.xml", **given))
    assert contents(project) == before


def contents(project: Project) -> dict[str, bytes]:
    files = [file for file in project.root.rglob("*") if file.is_file()]
    return {file.relative_to(project.root).as_posix(): file.read_bytes() for file in files}


def test_features_that_are_the_same_for_all_motions_are_not_proposed(project: Project) -> None:
    """An arm that stays in a plane is always as high, and never near to what stands far off."""
    flat = (project.root / "gantry.xml").read_text().replace('type="hinge" axis="0 1 0"', 'type="hinge" axis="0 0 1"')
    (project.root / "flat.xml").write_text(flat.replace('pos="0.4 0.3 0"', 'pos="9 9 0"'))
    wishes = Wishes("pour", project.root / "flat.xml", project.root / "mine", objects=("vase",))
    said = "\n".join(add_task(project, wishes))
    assert "Left out of the features: height, vase, which are the same for all motions of this arm." in said
    assert "Features: efficiency, path_length;" in said
    task = Project(project.root).params.task("pour")
    assert list(task.features) == list(task.preferences) == ["efficiency", "path_length"]
    assert list(Project(project.root).params.task("sweep").features) == ["effort", "vase"]


def test_features_that_differ_are_proposed(project: Project) -> None:
    wishes = Wishes("pour", project.root / "gantry.xml", project.root / "mine", objects=("vase",))
    said = "\n".join(add_task(project, wishes))
    assert "Features: efficiency, height, vase; docs/features.md has more kinds." in said
    assert "Left out of the features" not in said


def test_whose_the_recordings_are_is_said(project: Project) -> None:
    assert re.search(r"Participants: 3 \(.*\), by the recording's metadata record\.", added(project, "pour"))
    for file in (project.root / "mine").iterdir():
        good = read_joint_states(file)
        write_joint_states(file, good.time_ns, good.names, good.positions, topic=good.topic, metadata={})
    assert "Participants: 3, one for each recording, as nothing says whose one is;" in added(project, "scoop")
    wishes = Wishes("tip", project.root / "gantry.xml", project.root / "mine", reading={"file_name": "{participant}-*"})
    assert "Participants: 1 (demo), by the name of the file." in "\n".join(add_task(project, wishes))


def test_recordings_of_which_none_can_be_used_make_no_task(project: Project) -> None:
    for file in (project.root / "mine").iterdir():
        good = read_joint_states(file)
        write_joint_states(file, good.time_ns, good.names, 50 * good.positions, topic=good.topic, metadata={})
    before = contents(project)
    with pytest.raises(ParameterError, match=r"none of the 3 in it .*: demo-0.mcap \(.*--reading unit=deg"):
        added(project, "pour")
    assert contents(project) == before


def test_dvc_waits_for_every_file_of_the_scene(project: Project, tmp_path: Path) -> None:
    """Included files by name, folders that have nothing but meshes as a whole; what is shared by all tasks is known."""
    arm = project.root / "arm"
    (arm / "meshes").mkdir(parents=True)
    (arm / "meshes" / "block.obj").write_text(OBJ)
    (project.datasets / "robots").mkdir(parents=True, exist_ok=True)
    (project.datasets / "robots" / "floor.xml").write_text(
        "<mujocoinclude><geom type='plane' size='1 1 1'/></mujocoinclude>"
    )
    (arm / "its, parts.xml").write_text("<mujocoinclude><geom type='mesh' mesh='block'/></mujocoinclude>")
    text = (project.root / "gantry.xml").read_text()
    text = text.replace("<worldbody>", '<asset><mesh name="block" file="meshes/block.obj"/></asset><worldbody>')
    text = text.replace('<body name="vase"', '<include file="../datasets/robots/floor.xml"/><body name="vase"')
    text = text.replace('<body name="upper">', '<body name="upper"><include file="its, parts.xml"/>')
    (arm / "mine.xml").write_text(text)
    said = "\n".join(add_task(project, Wishes("pour", arm / "mine.xml", project.root / "mine")))
    assert "whose changes DVC notices: arm/its, parts.xml, arm/meshes (scene_files)" in said
    fresh = Project(project.root)
    assert fresh.params.task("pour").scene_files == ("arm/its, parts.xml", "arm/meshes")
    written = (project.root / "dvc.yaml").read_text()
    assert written == dvc_yaml(fresh.params)
    stages = YAML(typ="safe").load(written)["stages"]
    assert {"arm/its, parts.xml", "arm/meshes"} <= set(stages["scene"]["do"]["deps"])
    assert "arm/meshes" not in stages["ingest"]["do"]["deps"]  # they wait for scene.json alone
    scene.run(fresh, "pour")
    assert recorded_runs(fresh)[-1]["notes"] == []
    remove_task(fresh, "pour")
    assert "arm/meshes" not in (project.root / "dvc.yaml").read_text()


def test_a_file_of_the_scene_that_no_stage_waits_for_is_said(project: Project) -> None:
    (project.root / "part.xml").write_text(FLOOR)
    file = project.root / "gantry.xml"
    file.write_text(file.read_text().replace('<body name="vase"', '<include file="part.xml"/><body name="vase"'))
    scene.run(project, "sweep")
    assert "DVC does not notice a change of part.xml, which the scene depends on" in str(recorded_runs(project)[-1])


FLOOR = "<mujocoinclude><geom type='plane' size='1 1 1'/></mujocoinclude>"
OBJ = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
