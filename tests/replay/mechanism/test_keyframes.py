"""Keyframes are judged by the joints' limits, as MuJoCo has compiled them."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene

SWING = """
<mujoco>
  <compiler {compiler}/>
  <default><default class="elbow"><joint range="{elbow}"/></default></default>
  <worldbody>
    <body name="upper"><joint name="turn" axis="0 0 1"/><geom size="0.1"/>
      <body name="fore" pos="0.4 0 0" childclass="elbow">
        <joint name="elbow" axis="0 0 1" ref="{ref}"/><geom size="0.1"/>
        <body name="hand" pos="0.3 0 0"><geom size="0.1"/>
          <body name="finger" pos="0 0.05 0" childclass="main">
            <joint name="finger" type="slide" range="0 0.04"/><geom size="0.01"/></body>
        </body></body></body>
    <body name="ball" pos="3 3 3"><freejoint/><geom size="0.1"/></body>
  </worldbody>
  <keyframe><key name="start" qpos="{start} 3 3 3 1 0 0 0"/><key name="goal" qpos="{goal} 3 3 3 1 0 0 0"/></keyframe>
</mujoco>
"""


@pytest.fixture
def swing(tmp_path):
    def load(
        compiler='angle="radian"',
        elbow="0.8 5.4",
        start="0.2 1.5 0",
        goal="1.2 2.5 0",
        ref="0",
        joints=("turn", "elbow"),
    ):
        path = tmp_path / "swing.xml"
        path.write_text(SWING.format(compiler=compiler, elbow=elbow, start=start, goal=goal, ref=ref))
        return load_scene(path, end_effector="hand", joints=joints)

    return load


def test_within_the_limits_nothing_is_said(swing):
    scene = swing()
    assert scene.remarks == ()
    assert scene.start.tolist() == [0.2, 1.5]
    assert swing(compiler='angle="degree"', elbow="46 309").remarks == ()
    # a range is of the position, its reference included
    np.testing.assert_allclose(swing(elbow="0.8 5.4", ref="1").lower[1], 0.8)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {
                "start": "11.46 85.9437 0",
                "goal": "68.75 143.239 0",
            },  # keyframes in degrees, which MuJoCo never converts
            r"in keyframe 'start' joint 'elbow' is at 85\.9437; its limits are 0\.8 to 5\.4 rad\. They look like "
            "degrees",
        ),
        (
            {"compiler": ""},  # a range in radians, taken for degrees
            r"joint 'elbow' is at 1\.5; its limits are 0\.0139626 to 0\.0942478 rad\. The range of 'elbow' reads as "
            r"0\.8 to "
            r"5\.4 radians that were taken for degrees: .* <compiler angle=\"radian\"/>; add it",
        ),
        ({"goal": "1.2 5.6 0"}, r"in keyframe 'goal' joint 'elbow' is at 5\.6; its limits are 0\.8 to 5\.4 rad\.$"),
        ({"start": "0.2 1.5 0.045"}, r"'start' joint 'finger' is at 0\.045; its limits are 0 to 0\.04 m\.$"),
        ({"start": "0.2 1.5 20", "goal": "0 1 1"}, r"joint 'finger' is at 20; .* look like millimetres; convert them"),
    ],
)
def test_beyond_the_limits_they_are_refused(swing, changes, message):
    with pytest.raises(SceneError, match=rf"swing\.xml: .*{message}"):
        swing(**changes)


def test_a_little_beyond_is_said_and_used(swing):
    past = 5.4 + radians(2.9)
    scene = swing(goal=f"1.2 {past} 0.043")
    assert scene.goal.tolist() == [1.2, past]
    assert [remark.split(";")[0] for remark in scene.remarks[:2]] == [
        "in keyframe 'goal' joint 'elbow' is at 5.45061",
        "in keyframe 'goal' joint 'finger' is at 0.043",
    ]
    with pytest.raises(SceneError, match=r"5\.45238"):
        swing(goal=f"1.2 {5.4 + radians(3.001)} 0")


def test_a_whole_turn_is_taken_back_and_said(swing):
    scene = swing(start=f"0.2 {1.5 - 2 * np.pi} 0")
    np.testing.assert_allclose(scene.start, [0.2, 1.5], atol=1e-15)
    assert scene.remarks == (
        "in keyframe 'start' joint 'elbow' is at -4.78319, a whole turn from its limits, 0.8 to 5.4 rad",
    )


def test_a_range_that_reads_like_radians_is_said_even_where_the_keyframes_are_inside(swing):
    (said,) = swing(compiler="", elbow="-1.57 1.57", start="0 0 0", goal="1 0.02 0").remarks
    assert said == "the range of elbow is less than 6.3 degrees, as if radians had been taken for degrees"
    with pytest.raises(SceneError, match="radians that were taken for degrees"):
        swing(
            compiler="", elbow="-1.57 1.57", start="0 0 0", goal="1 0.04 0"
        )  # a tenth of so small a range is no tolerance


def test_an_end_effector_that_nothing_moves_is_refused(swing):
    scene = swing()
    with pytest.raises(SceneError, match=r"none of the joints elbow, turn moves the end effector 'ball'"):
        load_scene(scene.path, end_effector="ball", joints=scene.joints)
