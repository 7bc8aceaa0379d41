import math
from pathlib import Path

import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene, model_hash, scene_files


def test_joints_limits_and_kinds(gantry):
    assert gantry.joints == ("rail", "swing", "bow")
    assert gantry.slides.tolist() == [True, False, False]
    assert gantry.continuous.tolist() == [False, True, False]
    assert gantry.lower.tolist() == [-1, -math.inf, -2]
    assert gantry.upper.tolist() == [2, math.inf, 2]
    assert gantry.start.tolist() == [0.1, 0.2, 0.3]
    assert gantry.goal is None
    assert gantry.home.tolist() == [0.1, 0.2, 0.3, 0.7, 3, 3, 0.1, 1, 0, 0, 0]


def test_all_hinges_and_slides_by_default_and_free_joints_never(gantry_path):
    scene = load_scene(gantry_path, end_effector="tip")
    assert scene.joints == ("rail", "swing", "bow", "grip")


def test_joints_in_the_order_asked_for(gantry_path):
    scene = load_scene(gantry_path, end_effector="tip", joints=["bow", "rail"])
    assert scene.qpos_addresses.tolist() == [2, 0]
    assert scene.start.tolist() == [0.3, 0.1]


def test_moving_bodies_are_those_below_the_joints(gantry, gantry_path):
    moving = {gantry.model.body(i).name for i in gantry.moving_bodies()}
    assert moving == {"carriage", "boom", "wrist", "hook", "thumb"}
    wrist_only = load_scene(gantry_path, end_effector="tip", joints=["bow"])
    assert {wrist_only.model.body(i).name for i in wrist_only.moving_bodies()} == {"wrist", "hook", "thumb"}


def test_arrays_are_read_only(gantry):
    for array in (gantry.lower, gantry.start, gantry.home, gantry.qpos_addresses):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.mark.parametrize(
    ("end_effector", "joints", "message"),
    [
        ("hand", None, r"no body or site named 'hand'; its bodies are .*boom.* and its sites bench, dot, tip\.$"),
        ("hook", ["rail", "elbow"], r"no hinge or slide joint named 'elbow'; it has bow, grip, rail, swing\.$"),
        ("hook", ["loose"], r"no hinge or slide joint named 'loose'"),
        ("hook", ["bow", "bow"], r"each joint may be named once"),
        ("hook", [], r"at least one"),
    ],
)
def test_unknown_names(gantry_path, end_effector, joints, message):
    with pytest.raises(SceneError, match=message):
        load_scene(gantry_path, end_effector=end_effector, joints=joints)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><worldbody>", "line number=1|Line number=1"),
        ("<mujoco><include file='nowhere.xml'/></mujoco>", "nowhere.xml"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "mass and inertia"),
        ("<mujoco/>", "no hinge or slide joint to move"),
    ],
)
def test_broken_files_give_one_line(tmp_path, text, message):
    path = tmp_path / "scene.xml"
    path.write_text(text)
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(path, end_effector="x")
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(SceneError, match="There is no scene file"):
        load_scene(tmp_path / "no.xml", end_effector="x")
    with pytest.raises(SceneError, match="cannot be listed"):
        scene_files(tmp_path / "no.xml")


def test_unnamed_joint(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text("<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>")
    with pytest.raises(SceneError, match="number 0 has no name"):
        load_scene(path, end_effector="world")


def test_hash_follows_included_files_but_not_comments(gantry_path: Path):
    def hash_now() -> str:
        return model_hash(load_scene(gantry_path, end_effector="hook"))

    before = hash_now()
    gantry_path.write_text("<!-- a remark -->" + gantry_path.read_text())
    assert hash_now() == before
    included = gantry_path.parent / "bin.xml"
    included.write_text(included.read_text().replace("0.2 0.3", "0.2 0.4"))
    assert hash_now() != before


def test_scene_files_lists_what_is_included(gantry_path):
    assert scene_files(gantry_path) == [gantry_path.parent / "bin.xml", gantry_path]
