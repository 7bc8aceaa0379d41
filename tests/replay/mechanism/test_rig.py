"""Constraints and mocap bodies: everything is where MuJoCo would hold it, its own constraint residuals being zero."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene, replay
from pipeline.replay.geometry import body_poses

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="beacon" mocap="true" pos="5 5 0"><geom size="0.1"/><site name="light" pos="0 0 0.3"/></body>
    <body name="one" pos="0 0 0.5" euler="0.3 0.2 0.1">
      <joint name="first" axis="0 0 1" ref="0.2" range="-3 3"/><geom size="0.1"/>
      <body name="two" pos="0.3 0 0" euler="0.1 0 -0.4">
        <joint name="second" axis="0 1 0" ref="-0.1"/><geom size="0.1"/>
        <body name="three" pos="0.3 0 0">
          <joint name="third" type="slide" axis="1 0.5 0" range="0 0.3"/><geom size="0.1"/>
          <site name="grip" pos="0.1 0.02 0" euler="0 0 0.5"/>
          <body name="left" pos="0 0.05 0">
            <joint name="left" type="slide" axis="0 1 0" range="0 0.04"/><geom size="0.01"/></body>
          <body name="right" pos="0 -0.05 0">
            <joint name="right" type="slide" axis="0 -1 0" range="0 0.04"/><geom size="0.01"/></body>
        </body>
      </body>
    </body>
    <body name="cup" pos="2 0 1"><freejoint name="cup"/><geom size="0.05"/>
      <body name="lid" pos="0 0 0.1"><joint name="lid" axis="1 0 0"/><geom size="0.02"/></body>
      <site name="handle" pos="0.06 0 0.05" euler="0 1 0"/></body>
    <body name="spoon" pos="2 1 1"><freejoint name="spoon"/><geom size="0.05"/></body>
  </worldbody>
  <equality>{equality}</equality>
  <keyframe>{keyframe}</keyframe>
</mujoco>
"""
FOLLOW = '<joint name="follow" joint1="second" joint2="first" polycoef="0.1 0.5 0.2 -0.1 0.05"/>'
FINGERS = '<joint name="fingers" joint1="left" joint2="right"/>'
HELD = {
    "relpose": '<weld name="held" body1="three" body2="cup" relpose="0.1 0.2 0.3 0.5 0.5 -0.5 0.5" '
    'anchor="0.05 -0.02 0.1"/>',
    "as it stands": '<weld name="held" body1="three" body2="cup"/>',
    "cup first": '<weld name="held" body1="cup" body2="three" relpose="0.1 0 0.05 0.9 0.1 0 0.3"/>',
    "by its lid": '<weld name="held" body1="three" body2="lid" relpose="0.1 0 0.05 0.9 0.1 0 0.3"/>',
    "by sites": '<weld name="held" site1="grip" site2="handle"/>',
    "sites turned": '<weld name="held" site1="handle" site2="grip"/>',
}


def scene_of(folder: Path, equality: str = "", keyframe: str = "", **options):
    path = folder / "arm.xml"
    path.write_text(ARM.format(equality=equality, keyframe=keyframe))
    return load_scene(path, **options)


def residuals(scene, configurations):
    """What MuJoCo finds left of each equality constraint, the largest at each configuration."""
    data, found = scene.rig.data(), []
    for configuration in configurations:
        scene.rig.pose(data, configuration)
        mujoco.mj_fwdPosition(scene.model, data)
        equalities = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        assert equalities.any()
        found.append(np.abs(data.efc_pos[equalities]).max())
    return np.array(found)


def agree(scene, configurations):
    """Replay, the drawing and MuJoCo, all bodies and sites."""
    (motion,) = replay(scene, configurations[None])
    data = scene.rig.data()
    positions, quaternions = body_poses(scene, configurations)
    for t, configuration in enumerate(configurations):
        scene.rig.pose(data, configuration)
        for body in range(scene.model.nbody):
            name = scene.model.body(body).name
            assert np.abs(motion.position(name)[0, t] - data.xpos[body]).max() < 1e-12
            assert np.abs(motion.rotation(name)[0, t].ravel() - data.xmat[body]).max() < 1e-12
            assert np.abs(positions[t, body] - data.xpos[body]).max() < 1e-12
            assert np.abs(quaternions[t, body] - data.xquat[body]).max() < 1e-12
        for site in range(scene.model.nsite):
            assert np.abs(motion.position(scene.model.site(site).name)[0, t] - data.site_xpos[site]).max() < 1e-12


@pytest.mark.parametrize("held", HELD)
def test_what_follows_and_what_is_carried_leaves_no_residual(tmp_path, held):
    joints = ("first", "third", "right", "lid")[: 3 if held == "by its lid" else 4]
    scene = scene_of(tmp_path, FOLLOW + FINGERS + HELD[held], joints=None if len(joints) == 4 else joints)
    assert scene.joints == joints
    configurations = np.random.default_rng(0).uniform(-2, 2, (20, len(joints)))
    assert residuals(scene, configurations).max() < 1e-12
    agree(scene, configurations)


def test_what_is_carried_carries_more(tmp_path):
    held = '<weld body1="spoon" body2="cup"/><weld body1="cup" body2="three" relpose="0 0 0.1 1 0 0 0"/>'
    scene = scene_of(tmp_path, FOLLOW + held)
    configurations = np.random.default_rng(1).uniform(-2, 2, (10, len(scene.joints)))
    assert residuals(scene, configurations).max() < 1e-12
    agree(scene, configurations)
    assert {"cup", "spoon", "lid"} <= {scene.model.body(i).name for i in scene.moving_bodies()}


def test_a_follower_is_where_the_polynomial_has_it(tmp_path):
    scene = scene_of(tmp_path, FOLLOW, joints=["first", "third"], end_effector="grip")
    data = scene.rig.data()
    scene.rig.pose(data, np.array([0.9, 0.1]))
    x = 0.9 - 0.2
    assert data.joint("second").qpos[0] == pytest.approx(
        -0.1 + 0.1 + 0.5 * x + 0.2 * x**2 - 0.1 * x**3 + 0.05 * x**4, abs=1e-15
    )


def test_a_follower_that_is_recorded_leads(tmp_path):
    """The second of a gripper's fingers follows the first; who records the second alone has the first too."""
    gear = (
        '<joint joint1="left" joint2="right" polycoef="0.001 0.5 0 0 0"/>'
        '<joint joint1="right" joint2="third" polycoef="0 0.1 0 0 0"/>'
    )
    scene = scene_of(tmp_path, gear, joints=["first", "left"])
    configurations = np.array([[0.1, 0.012], [1.0, 0.001]])
    assert residuals(scene, configurations).max() < 1e-15
    data = scene.rig.data()
    scene.rig.pose(data, configurations[0])
    assert data.joint("right").qpos[0] == pytest.approx(0.022, abs=1e-15)
    assert data.joint("third").qpos[0] == pytest.approx(0.22, abs=1e-15)


def test_followers_of_joints_that_stay_are_set_once(tmp_path):
    scene = scene_of(
        tmp_path, '<joint joint1="third" polycoef="0.2 0 0 0 0"/>'
        '<joint joint1="left" joint2="third" polycoef="0 0.1 0 0 0"/>',
        joints=["first", "second"], end_effector="grip",
    )  # fmt: skip
    assert residuals(scene, np.array([[0.1, 0.2]])).max() < 1e-15
    assert scene.home[scene.model.joint("left").qposadr[0]] == pytest.approx(0.02)


def test_limits_are_narrowed_where_a_follower_would_leave_its_own(tmp_path):
    scene = scene_of(tmp_path, '<joint joint1="left" joint2="first" polycoef="0.02 -0.01 0 0 0"/>')
    place = scene.joints.index("first")
    # left = 0.02 - 0.01 (first - 0.2) in 0..0.04, so first in -1.8..2.2
    np.testing.assert_allclose([scene.lower[place], scene.upper[place]], [-1.8, 2.2], atol=1e-12)


@pytest.mark.parametrize(
    ("equality", "joints", "message"),
    [
        (FOLLOW, ["first", "second"], "makes joint 'second' follow joint 'first'; leave the follower out"),
        (FOLLOW, ["second", "third"], "makes joint 'second' follow joint 'first'"),
        ('<joint joint1="third"/>', ["first", "third"], "makes joint 'third' follow a constant"),
        (
            FOLLOW + FOLLOW.replace("follow", "again"), None,
            "two equality constraints give the position of joint 'second'",
        ),
        (
            '<joint joint1="left" joint2="right"/><joint joint1="right" joint2="left"/>', None,
            "'left', 'right' follow each other in a circle",
        ),
        (
            '<connect name="loop" body1="three" body2="world" anchor="0 0 0"/>', None,
            "'loop' ties body 'three', .* to 'world'",
        ),
        (
            '<weld body1="left" body2="right"/>', None,
            r"'number 0' ties body 'left', .* to 'right', .* active=\"false\"",
        ),
        ('<weld body1="lid" body2="three"/>', None, "ties body 'lid', which the joints move, to 'three'"),
    ],
)  # fmt: skip
def test_what_cannot_be_held_is_refused(tmp_path, equality, joints, message):
    with pytest.raises(SceneError, match=rf"arm\.xml: .*{message}"):
        scene_of(tmp_path, equality, joints=joints)
    scene_of(tmp_path, equality.replace("/>", ' active="false"/>'), joints=joints)


@pytest.mark.parametrize(
    ("equality", "remark"),
    [
        ('<weld name="hand" body1="beacon" body2="three"/>', "weld 'hand' to a mocap body is not followed"),
        ('<connect name="hook" body1="cup" body2="three" anchor="0 0 0"/>', "body 'cup' hangs from a point ('hook')"),
        ('<weld name="soft" body1="cup" body2="three" torquescale="0"/>', "body 'cup' hangs from a point ('soft')"),
        (
            '<weld body1="cup" body2="spoon"/><weld body1="one" body2="one"/>',
            None,
        ),  # nothing that the joints move apart
    ],
)
def test_what_is_not_followed_is_said(tmp_path, equality, remark):
    if "one" in equality:
        equality = '<weld body1="cup" body2="spoon"/>'
    scene = scene_of(tmp_path, equality, joints=["first", "third"])
    assert [said for said in scene.remarks if remark and said.startswith(remark)] == list(scene.remarks)
    assert len(scene.remarks) == (remark is not None)
    agree(scene, np.array([[0.1, 0.2]]))


def test_tendons_held_equal_are_not_followed(tmp_path):
    path = tmp_path / "arm.xml"
    tendon = '<tendon><fixed name="t"><joint joint="left" coef="1"/></fixed></tendon>'
    path.write_text(
        ARM.format(equality='<tendon tendon1="t"/>', keyframe="").replace("<equality>", tendon + "<equality>")
    )
    assert load_scene(path).remarks == ("equality constraint 'number 0' (tendon) is not followed",)


def test_mimic_joints_of_a_urdf(tmp_path):
    mass = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/><axis xyz="0 0 1"/><origin xyz="0.5 0 0"/>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="r"><link name="base"/><link name="a">{mass}</link><link name="b">{mass}</link>'
        f'<joint name="lead" type="revolute"><parent link="base"/><child link="a"/>{limit}</joint>'
        f'<joint name="mimic" type="revolute"><parent link="a"/><child link="b"/>{limit}'
        '<mimic joint="lead" multiplier="2" offset="0.1"/></joint></robot>'
    )
    scene = load_scene(tmp_path / "arm.urdf", end_effector="b")
    assert scene.joints == ("lead",)
    np.testing.assert_allclose([scene.lower[0], scene.upper[0]], [-0.55, 0.45])
    assert residuals(scene, np.array([[0.3], [-0.4]])).max() < 1e-15
    agree(scene, np.array([[0.3], [-0.4]]))


ZEROS = " ".join(["0"] * 5) + " 2 0 1 1 0 0 0 0 2 1 1 1 0 0 0"


@pytest.mark.parametrize("object_name", ["beacon", "light"])
def test_a_mocap_body_is_where_the_start_keyframe_has_it(tmp_path, object_name):
    start = '<key name="start" mpos="0.2 0.5 0.1" mquat="0 0 1 0"/>'
    scene = scene_of(tmp_path, keyframe=start, joints=["first", "second"], end_effector="grip")
    configurations = np.random.default_rng(3).uniform(-1, 1, (4, 2))
    agree(scene, configurations)
    (motion,) = replay(scene, configurations[None])
    data = mujoco.MjData(scene.model)
    mujoco.mj_resetDataKeyframe(scene.model, data, 0)  # MuJoCo's own reading of the keyframe
    mujoco.mj_forward(scene.model, data)
    expected = data.body("beacon").xpos if object_name == "beacon" else data.site("light").xpos
    np.testing.assert_allclose(motion.position(object_name)[0], np.tile(expected, (4, 1)), atol=1e-15)
    assert scene_of(tmp_path, joints=["first"]).at_home().body("beacon").xpos.tolist() == [5, 5, 0]


def test_what_is_elsewhere_at_the_goal_is_said(tmp_path):
    qpos = ZEROS.replace("2 0 1", "2 0 1.5", 1)
    keys = f'<key name="start" qpos="{ZEROS}"/><key name="goal" qpos="{qpos}" mpos="0.2 0.5 0.1"/>'
    scene = scene_of(tmp_path, keyframe=keys)
    assert scene.remarks == (
        "joint 'cup', mocap body 'beacon': elsewhere in keyframe 'goal' than in 'start'; replay has it as in 'start'",
    )


def test_a_keyframe_that_breaks_a_coupling_is_refused(tmp_path):
    qpos = ZEROS.split()
    names = ["first", "second", "third", "left", "right"]
    for name, value in (("right", "0.03"), ("left", "0.0295")):
        qpos[names.index(name)] = value
    start = '<key name="start" qpos="{}"/>'
    assert scene_of(tmp_path, FINGERS, start.format(" ".join(qpos))).start[-2] == 0.03
    qpos[names.index("left")] = "0"
    with pytest.raises(
        SceneError, match=r"keyframe 'start' has joint 'left' at 0, and joint 'right' wants it at 0\.03; write"
    ):
        scene_of(tmp_path, FINGERS, start.format(" ".join(qpos)))
