"""A scene in a few lines of YAML is what the same words of `new-task --arm` build."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene, model_hash, scene_files
from pipeline.replay.furnished_scene import furnished, with_keyframes
from tests.docs.test_bring_your_own import JOINT, JOINTS, URDF
from tests.replay.test_scene_files import ARM, INCLUDED, MAIN, SCENE, arm, stl
from tests.replay.test_urdf import mesh, robot

PAGE = Path(__file__).resolve().parents[2] / "docs" / "bring-your-own.md"
TEXT = """arm: ../arms/arm.urdf
table: true
objects: {cup: [0.5, 0.1, 0.2]}
"""


@pytest.fixture
def described(tmp_path: Path) -> Path:
    (tmp_path / "arms").mkdir()
    (tmp_path / "scenes").mkdir()
    (tmp_path / "arms" / "arm.urdf").write_text(robot(mesh("package://arms/tet.stl")))
    (tmp_path / "arms" / "tet.stl").write_bytes(stl())
    path = tmp_path / "scenes" / "mine.yaml"
    path.write_text(TEXT)
    return path


def test_it_is_the_scene_that_new_task_builds(described: Path) -> None:
    text, _ = furnished(
        described.parents[1] / "arms" / "arm.urdf", described.with_suffix(".xml"),
        table=True, objects={"cup": (0.5, 0.1, 0.2)},
    )  # fmt: skip
    described.with_suffix(".xml").write_text(text)
    ours, built = load_scene(described), load_scene(described.with_suffix(".xml"))
    assert (ours.joints, ours.box_sites(), ours.model.nmesh) == (built.joints, built.box_sites(), 1)
    configuration = np.full(len(ours.joints), 0.3)
    for scene, other in ((ours, built), (built, ours)):
        data, others = scene.rig.data(), other.rig.data()
        scene.rig.pose(data, configuration)
        other.rig.pose(others, configuration)
        np.testing.assert_allclose(data.xpos, others.xpos, atol=1e-6)
        np.testing.assert_allclose(data.geom_xpos, others.geom_xpos, atol=1e-6)


def test_its_keyframes_are_start_and_goal(described: Path) -> None:
    joint = load_scene(described).joints[0]
    described.write_text(TEXT + f"start: {{{joint}: 0.25}}\ngoal: {{{joint}: -0.5}}\n")
    scene = load_scene(described)
    assert scene.start is not None
    assert scene.goal is not None
    assert (scene.start[0], scene.goal[0]) == (0.25, -0.5)
    assert not scene.start[1:].any()


def test_all_of_its_files_count_and_an_edit_is_another_scene(described: Path) -> None:
    arm_file = described.parents[1] / "arms" / "arm.urdf"
    assert scene_files(described) == sorted([described, arm_file, arm_file.with_name("tet.stl")])
    before = model_hash(load_scene(described))
    assert model_hash(load_scene(described)) == before
    described.write_text(TEXT + "# only said\n")
    assert model_hash(load_scene(described)) == before
    described.write_text(TEXT.replace("0.5, 0.1", "0.6, 0.1"))
    assert model_hash(load_scene(described)) != before


def test_an_mjcf_arm_with_includes_serves_too(tmp_path: Path) -> None:
    for file, content in ((SCENE, MAIN.format(INCLUDED)), (ARM, arm("meshes/tet.stl"))):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(content)
    (tmp_path / "arm/meshes").mkdir(parents=True, exist_ok=True)
    (tmp_path / "arm/meshes/tet.stl").write_bytes(stl())
    (tmp_path / "mine.yml").write_text(f"arm: {SCENE}\nobjects: {{cup: [1, 0, 0]}}\n")
    scene = load_scene(tmp_path / "mine.yml")
    assert (scene.joints, scene.model.nmesh) == (load_scene(tmp_path / SCENE).joints, 1)
    assert len(scene_files(tmp_path / "mine.yml")) == 4


def test_what_the_guide_shows_is_read(tmp_path: Path) -> None:
    (block,) = (text for text in re.findall(r"(?ms)^```yaml\n(.*?)^```$", PAGE.read_text()) if text.startswith("arm:"))
    (tmp_path / "mine.yaml").write_text(block)
    (tmp_path / "my_arm.urdf").write_text(URDF.format("".join(JOINT.format(*one) for one in JOINTS)))
    scene = load_scene(tmp_path / "mine.yaml", end_effector="tip")
    assert scene.start is not None
    assert scene.goal is not None
    assert (scene.start.tolist(), scene.goal.tolist()) == ([-0.3, -0.6, 0], [0.3, 0.9, 0])
    assert scene.box_sites() == ["table_top"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it must be names with their values"),
        ("table: true", "arm is None; it must name an MJCF or URDF file, from the folder of this file"),
        ("arm: no.urdf", "There is no file .*no.urdf; give the path of an MJCF or URDF file"),
        ("arm: mine.yaml", "arm is 'mine.yaml', which is a description itself"),
        (TEXT + "tabel: true", "'tabel' is unknown; allowed are arm, goal, objects, start, table"),
        (TEXT.replace("true", "big"), "table is 'big'; allowed are true and false"),
        (TEXT.replace("[0.5, 0.1, 0.2]", "0.5"), r"objects.cup is 0.5; it must be \[x, y, z\] in m"),
        (TEXT.replace("0.5, ", "left, "), "objects.cup is 'left'; it must be a number from -1000 to 1000"),
        (TEXT.replace("0.5, ", ".nan, "), "objects.cup is nan"),
        (TEXT.replace("cup", "table"), "has a body 'table' already|repeated name|give the object another name"),
        (TEXT + "start: {wheel: 1}", "start names 'wheel', which is no joint; there are"),
        (TEXT + "start: [1, 2]", r"start is \[1, 2\]; it must be names with their values"),
        ("arm: [", "is not readable YAML"),
        ("a: &a [1, 2]\nb: *a\n" + "x" * 1_000_001, "has more than 1,000,000 bytes"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(described: Path, text: str, message: str) -> None:
    described.write_text(text)
    with pytest.raises(SceneError, match=message):
        load_scene(described)


def test_a_keyframe_of_the_arms_own_file_is_not_overridden_silently(described: Path) -> None:
    scene = load_scene(described)
    own = described.parents[1] / "arms" / "own.xml"
    text, _ = furnished(described.parents[1] / "arms" / "arm.urdf", own, table=False, objects={})
    own.write_text(
        with_keyframes(text, scene, {}).replace("</mujoco>", '<keyframe><key name="start"/></keyframe></mujoco>')
    )
    described.write_text(f"arm: ../arms/own.xml\nstart: {{{scene.joints[0]}: 0.1}}\n")
    with pytest.raises(SceneError, match=r"own\.xml has a keyframe of that name; drop one"):
        load_scene(described)
