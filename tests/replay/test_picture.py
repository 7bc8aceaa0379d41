"""Pictures of scenes: what is where, what hides what, from the scene's own camera or one that sees all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.replay.picture import named_things, take_picture
from pipeline.replay.scene import Scene, load_scene

SCENE = """<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    {camera}
    <body name="ball" pos="0 0 1"><geom type="sphere" size="0.2" rgba="1 0 0 1"/></body>
    <body name="wall" pos="0 -0.5 0.2"><geom type="box" size="1 0.02 0.2" rgba="0 0 1 1"/></body>
    <body name="collision_hull" pos="0.5 0 1"><geom group="3" type="sphere" size="0.2"/></body>
    <body name="arm"><joint name="turn" axis="0 0 1" range="-3 3"/><geom type="box" size="0.01 0.01 0.5"/>
      <body name="hand" pos="0.3 0 0"><geom type="sphere" size="0.02"/></body></body>
  </worldbody>
  <keyframe><key name="start" qpos="0"/><key name="goal" qpos="1"/></keyframe>
</mujoco>"""
CAMERA = '<camera pos="0 -3 0.5" xyaxes="1 0 0 0 0 1" fovy="60"/>'
AT_BALL, AT_WALL = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, -0.5, 0.3]])


def scene(folder: Path, camera: str = CAMERA) -> Scene:
    (folder / "scene.xml").write_text(SCENE.format(camera=camera))
    return load_scene(folder / "scene.xml", end_effector="hand")


def test_things_are_where_they_are_and_hide_what_is_behind_them(tmp_path: Path) -> None:
    one = scene(tmp_path)
    picture = take_picture(one, np.zeros(1), AT_BALL, 120, 90)
    assert picture.colours.shape == (90, 120, 3)
    for point, name, channel in ((AT_BALL, "ball", 0), (AT_WALL, "wall", 2)):
        places, far = picture.places(point)
        column, row = places[0].astype(int)
        assert picture.bodies[row, column] == one.body_id(name)
        assert picture.colours[row, column].argmax() == channel
        assert far[0] - 0.25 < picture.distances[row, column] < far[0]
    # slope 0.5 / 3 of a view whose half has slope tan 30 degrees: 45 - 45 * (1 / 6) / tan 30 lines down
    np.testing.assert_allclose(picture.places(AT_BALL)[0][0], [60, 45 - 7.5 * np.sqrt(3)])
    arm = picture.bodies == one.body_id("arm")
    assert arm.any()
    upper, lower = (int(picture.places(np.array([[0, -0.5, z]]))[0][0, 1]) for z in (0.35, 0.05))
    assert not arm[upper:lower].any(), "the wall hides the middle of the arm"
    assert one.body_id("collision_hull") not in picture.bodies
    nothing = picture.bodies == -1
    assert nothing[0, 0]
    assert np.isinf(picture.distances[nothing]).all()
    assert (picture.colours[0, 0] == 255).all()


def test_the_same_picture_again(tmp_path: Path) -> None:
    first, second = (take_picture(scene(tmp_path), np.zeros(1), AT_BALL, 97, 66) for _ in range(2))
    assert first.colours.tobytes() == second.colours.tobytes()


@pytest.mark.parametrize("camera", [CAMERA, ""])
def test_all_points_are_in_the_picture(camera: str, tmp_path: Path) -> None:
    points = np.array([[2.5, 0, 0.5], [-2.5, 0, 0.5], [0, 0, 3.0]])
    places, _ = take_picture(scene(tmp_path, camera), np.zeros(1), points, 80, 60).places(points)
    assert ((places > 0) & (places < [80, 60])).all()
    if camera:
        near, _ = take_picture(scene(tmp_path), np.zeros(1), AT_BALL, 80, 60).places(points)
        assert not ((near > 0) & (near < [80, 60])).all(), "a camera that sees enough stays as it is"


def test_what_is_behind_the_camera_has_no_place(tmp_path: Path) -> None:
    picture = take_picture(scene(tmp_path), np.zeros(1), AT_BALL, 8, 6)
    assert np.isnan(picture.places(np.array([[0.0, -5.0, 0.5]]))[0]).all()


def test_things_that_no_joint_moves_have_names(tmp_path: Path) -> None:
    assert sorted(named_things(scene(tmp_path)).values()) == ["ball", "collision_hull", "wall"]


def test_a_picture_without_pixels(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="width 0"):
        take_picture(scene(tmp_path), np.zeros(1), AT_BALL, 0, 6)
