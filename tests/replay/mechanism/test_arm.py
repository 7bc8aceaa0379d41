"""Which joints are the arm's: those that carry the end effector, or those that are named. All others stay."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene, replay
from pipeline.replay.mechanism.arm import hand_of, left_out
from pipeline.replay.mechanism.couplings import joint_couplings
from pipeline.replay.scene import Scene

BALL = '<geom type="sphere" size=".02"/>'
FINGERS = f"""
  <body name="left"><joint name="finger_left" type="slide" range="0 .04"/>{BALL}</body>
  <body name="right"><joint name="finger_right" type="slide" range="0 .04"/>{BALL}</body>"""


def arm(prefix: str = "", at: float = 0.0, hand: str = FINGERS, beyond: str = "") -> str:
    return f"""
    <body name="{prefix}one" pos="0 {at} 0"><joint name="{prefix}j1" axis="0 0 1" range="-3 3"/>{BALL}
      <body name="{prefix}two" pos=".3 0 0"><joint name="{prefix}j2" axis="0 1 0" range="-2 2"/>{BALL}
        <body name="{prefix}hand" pos=".3 0 0">{BALL}<site name="{prefix}tip"/>{hand}</body>{beyond}
      </body>
    </body>"""


DRAWER = f'<body name="drawer"><joint name="drawer_slide" type="slide" range="0 .3"/>{BALL}</body>'
MUG = f'<body name="mug"><freejoint/>{BALL}</body>'
KEYS = "<keyframe><key name='{name}' qpos='{qpos}'/></keyframe>"


def load(folder: Path, bodies: str, rest: str = "", **settings: object) -> Scene:
    file = folder / "scene.xml"
    file.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{bodies}</worldbody>{rest}</mujoco>')
    return load_scene(file, **settings)  # type: ignore[arg-type]


def test_fingers_drawers_and_free_bodies_are_no_part_of_the_arm(tmp_path: Path) -> None:
    scene = load(tmp_path, arm() + DRAWER + MUG, end_effector="tip")
    assert scene.joints == ("j1", "j2")
    (remark,) = scene.remarks
    assert "finger_left, finger_right, drawer_slide stay at home" in remark


def test_a_base_that_slides_is_part_of_it(tmp_path: Path) -> None:
    based = f'<body name="base"><joint name="x" type="slide" range="-1 1"/>{BALL}{arm()}</body>'
    assert load(tmp_path, based, end_effector="hand").joints == ("x", "j1", "j2")


def test_joints_beyond_the_end_effector_are_part_of_it_until_the_arm_branches(tmp_path: Path) -> None:
    assert load(tmp_path, arm() + DRAWER, end_effector="one").joints == ("j1", "j2")
    assert load(tmp_path, arm(), end_effector="left").joints == ("j1", "j2", "finger_left")


def test_of_two_arms_it_is_the_one_that_carries_the_end_effector(tmp_path: Path) -> None:
    scene = load(tmp_path, arm("a_", hand="") + arm("b_", 1.0, hand=""), end_effector="b_tip")
    assert scene.joints == ("b_j1", "b_j2")
    both = ["b_j1", "b_j2", "a_j1", "a_j2"]
    assert load(tmp_path, arm("a_", hand="") + arm("b_", 1.0, hand=""), joints=both).joints == tuple(both)


def test_a_follower_stands_for_its_leader(tmp_path: Path) -> None:
    ties = '<equality><joint joint1="j2" joint2="drawer_slide" polycoef="0 1 0 0 0"/></equality>'
    assert load(tmp_path, arm() + DRAWER, ties, end_effector="hand").joints == ("j1", "drawer_slide")


def test_joints_by_name_keep_their_order_and_by_body_the_files(tmp_path: Path) -> None:
    scene = load(tmp_path, arm() + DRAWER, joints=["j2", "j1"], end_effector="hand")
    assert (scene.joints, scene.remarks) == (("j2", "j1"), ())
    assert load(tmp_path, arm() + DRAWER, joints="two").joints == ("j2", "finger_left", "finger_right")


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        (["j1", "elbow"], "no hinge or slide joint named 'elbow'; it has .*j1, j2"),
        (["j1", "j1"], "each joint may be named once"),
        ("shoulder", "no body named 'shoulder'.*or list the names of joints"),
        ("mug", "no hinge or slide in body 'mug'"),
    ],
)
def test_names_that_are_not_there_are_refused(tmp_path: Path, joints: object, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load(tmp_path, arm() + MUG, joints=joints, end_effector="hand")


def test_all_else_stays_where_start_has_it_or_home(tmp_path: Path) -> None:
    for name in ("start", "home"):
        scene = load(tmp_path, arm() + DRAWER, KEYS.format(name=name, qpos="0 0 .01 .02 .25"), end_effector="hand")
        paths = np.random.default_rng(0).uniform(-1, 1, (3, 4, 2))
        (motion,) = replay(scene, paths)
        data = mujoco.MjData(scene.model)
        data.qpos[:] = 0, 0, 0.01, 0.02, 0.25
        mujoco.mj_kinematics(scene.model, data)
        drawer = data.xpos[scene.body_id("drawer")]
        np.testing.assert_allclose(motion.position("drawer"), np.broadcast_to(drawer, (3, 4, 3)), atol=1e-12)


@pytest.mark.parametrize(
    ("bodies", "hand"),
    [
        (arm() + DRAWER, "hand"),  # before the fingers
        (arm(hand=""), "hand"),
        (arm(hand=f'<body name="cup">{BALL}</body>'), "cup"),  # what is carried, without joints
    ],
)
def test_the_hand_is_the_last_body_before_the_arm_branches(tmp_path: Path, bodies: str, hand: str) -> None:
    scene = load(tmp_path, bodies, joints=["j1", "j2"])
    assert scene.model.body(hand_of(scene.model, scene.rig.joint_ids.tolist())).name == hand


def test_what_follows_a_joint_that_moves_is_not_left_out(tmp_path: Path) -> None:
    ties = '<equality><joint joint1="finger_left" joint2="j2" polycoef="0 .01 0 0 0"/></equality>'
    scene = load(tmp_path, arm(), ties, joints=["j1", "j2"])
    ids = scene.rig.joint_ids.tolist()
    assert left_out(scene.model, ids, joint_couplings(scene.path, scene.model)) == ["finger_right"]
