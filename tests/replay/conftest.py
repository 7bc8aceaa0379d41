"""A small arm that is nothing like the one the project ships: one slide, two hinges, other names."""

from pathlib import Path

import pytest

GANTRY = """
<mujoco model="gantry">
  <compiler angle="radian"/>
  <include file="bin.xml"/>
  <worldbody>
    <body name="carriage" pos="0 0 0.5">
      <joint name="rail" type="slide" axis="1 0 0" limited="true" range="-1 2"/>
      <geom size="0.05"/>
      <body name="boom">
        <joint name="swing" axis="0 0 1" limited="false"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02"/>
        <body name="wrist" pos="0.4 0 0">
          <joint name="bow" axis="0 1 0" limited="true" range="-2 2"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
          <body name="hook" pos="0.3 0 0">
            <geom size="0.02"/>
            <site name="tip" pos="0.1 0 0"/>
            <body name="thumb"><joint name="grip" axis="1 0 0"/><geom size="0.02"/></body>
          </body>
        </body>
      </body>
    </body>
    <body name="parcel" pos="3 3 0.1"><freejoint name="loose"/><geom size="0.1"/></body>
    <site name="bench" type="box" pos="0.5 0 0.05" size="0.6 0.3 0.05"/>
    <site name="dot" pos="0 0 0"/>
  </worldbody>
  <keyframe>
    <key name="start" qpos="0.1 0.2 0.3 0.7 3 3 0.1 1 0 0 0"/>
  </keyframe>
</mujoco>
"""

BIN = """
<mujoco><worldbody><body name="bin" pos="1 0.2 0.3"><geom size="0.1"/></body></worldbody></mujoco>
"""


@pytest.fixture
def gantry_path(tmp_path: Path) -> Path:
    (tmp_path / "bin.xml").write_text(BIN)
    path = tmp_path / "gantry.xml"
    path.write_text(GANTRY)
    return path


@pytest.fixture
def gantry(gantry_path: Path):
    from pipeline.replay import load_scene

    return load_scene(gantry_path, end_effector="hook", joints=["rail", "swing", "bow"])
