from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from pipeline.errors import ArgumentError, SceneError
from pipeline.replay import load_scene
from pipeline.replay.geometry import KINDS, body_poses, extract_geometry

ZOO = """
<mujoco>
  <compiler angle="radian"/>
  <asset>
    <material name="red" rgba="1 0 0 1"/>
    <mesh name="wedge" vertex="1 0 0  2 0 0  1 1 0  1 0 1"/>
  </asset>
  <worldbody>
    <camera name="eye" pos="1 2 3"/>
    <geom name="floor" type="plane" size="0 2 0.1"/>
    <body name="thing" pos="0 0 1">
      <geom name="ball" type="sphere" size="0.1" material="red" rgba="0 1 0 1"/>
      <geom type="capsule" size="0.1 0.2" pos="0 0 0.3"/>
      <geom name="egg" type="ellipsoid" size="0.1 0.2 0.3"/>
      <geom name="can" type="cylinder" size="0.1 0.2"/>
      <geom name="crate" type="box" size="0.1 0.2 0.3" quat="0 1 0 0"/>
      <geom name="wedge" type="mesh" mesh="wedge"/>
      <geom name="hull" type="sphere" size="1" group="3"/>
      <geom name="ghost" type="sphere" size="1" rgba="1 1 1 0"/>
    </body>
  </worldbody>
</mujoco>
"""


def test_every_visible_geom_becomes_a_shape_and_no_other():
    geometry = extract_geometry(mujoco.MjModel.from_xml_string(ZOO))
    assert geometry.body_names == ("world", "thing")
    assert [shape.kind for shape in geometry.shapes] == list(KINDS)
    assert [shape.name for shape in geometry.shapes] == ["floor", "ball", "capsule_2", "egg", "can", "crate", "wedge"]
    assert [shape.body for shape in geometry.shapes] == [0, 1, 1, 1, 1, 1, 1]
    ball = geometry.shapes[1]
    assert ball.rgba.tolist() == [1, 0, 0, 1]
    assert ball.size[0] == 0.1
    assert geometry.viewpoint is not None
    assert geometry.viewpoint.tolist() == [1, 2, 3]
    with pytest.raises(ValueError, match="read-only"):
        ball.size[0] = 2.0


def test_a_mesh_keeps_its_place_although_mujoco_moves_its_frame():
    wedge = extract_geometry(mujoco.MjModel.from_xml_string(ZOO)).shapes[-1]
    w, axis = wedge.quaternion[0], wedge.quaternion[1:]
    twice = 2 * np.cross(axis, wedge.vertices)
    corners = wedge.position + wedge.vertices + w * twice + np.cross(axis, twice)
    # MuJoCo keeps mesh vertices in single precision
    np.testing.assert_allclose(
        sorted(corners.round(5).tolist()), [[1, 0, 0], [1, 0, 1], [1, 1, 0], [2, 0, 0]], atol=1e-5
    )
    assert wedge.faces.shape == (4, 3)


def test_a_geom_without_a_solid_form_is_named():
    field = """<mujoco><asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/></asset>
    <worldbody><geom name="hill" type="hfield" hfield="h"/></worldbody></mujoco>"""
    with pytest.raises(SceneError, match=r"hill.*allowed are plane, sphere"):
        extract_geometry(mujoco.MjModel.from_xml_string(field))


def test_poses_are_those_of_the_arm_by_hand(gantry):
    positions, quaternions = body_poses(gantry, np.array([[0.5, 0.0, 0.0], [0.5, np.pi / 2, 0.0]]))
    names = extract_geometry(gantry.model).body_names
    hook, parcel, thumb = (names.index(name) for name in ("hook", "parcel", "thumb"))
    np.testing.assert_allclose(positions[:, hook], [[1.2, 0, 0.5], [0.5, 0.7, 0.5]], atol=1e-12)
    np.testing.assert_allclose(quaternions[1, hook], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-12)
    # what the waypoints do not move stays where the keyframe has it: the grip at 0.7 rad about x
    np.testing.assert_allclose(quaternions[0, thumb], [np.cos(0.35), np.sin(0.35), 0, 0], atol=1e-12)
    np.testing.assert_allclose(positions[:, parcel], [[3, 3, 0.1]] * 2, atol=1e-12)


def test_waypoints_of_another_arm_are_refused(gantry):
    with pytest.raises(ArgumentError, match=r"\(M, 3\).*rail, swing, bow.*\(5, 7\)"):
        body_poses(gantry, np.zeros((5, 7)))


@pytest.mark.parametrize("task", ["table", "laptop", "human"])
def test_the_shipped_scenes_can_be_drawn(task):
    path = Path(__file__).resolve().parents[2] / "datasets" / "scenes" / f"{task}.xml"
    scene = load_scene(path, end_effector="j2s7s300_link_7")
    geometry = extract_geometry(scene.model)
    links = {geometry.body_names[shape.body] for shape in geometry.shapes}
    assert {f"j2s7s300_link_{i}" for i in range(1, 8)} <= links
    assert scene.start is not None
    positions, _ = body_poses(scene, scene.start[None])
    assert positions.shape == (1, len(geometry.body_names), 3)
