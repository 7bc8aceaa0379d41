"""Contacts as features see them, against known geometry and against `mj_forward`."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import bind_features, load_scene, replay
from pipeline.replay.features import KINDS
from pipeline.replay.scene import Scene

# a ball of 10 cm on a rail, a wall whose face is at 1 m, a post on the other side, a box that lies on the floor
RAIL = """<mujoco><worldbody>
<geom name="floor" type="plane" size="5 5 .1" pos="0 0 -1"/>
<body name="wall" pos="1.1 0 0"><geom type="box" size=".1 1 1"/></body>
<body name="post" pos="-1 0 0"><geom type="cylinder" size=".1 1"/></body>
<body name="parcel" pos="3 0 -.95"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
<body name="cart"><joint name="x" type="slide" axis="1 0 0" range="-2 2"/><geom type="box" size=".01 .01 .01"/>
<body name="hand" pos="0 0 .3"><joint name="turn" axis="0 0 1" range="-3 3"/><geom type="sphere" size=".1"/>
<body name="cup" pos="0 .4 0"><geom type="sphere" size=".05"/></body></body></body>
</worldbody></mujoco>"""


@pytest.fixture
def rail(tmp_path: Path) -> Scene:
    (tmp_path / "rail.xml").write_text(RAIL)
    return load_scene(tmp_path / "rail.xml", end_effector="hand", joints=["x", "turn"])


def moving(x: list[float]) -> np.ndarray:
    return np.stack([np.array(x), np.zeros(len(x))], axis=1)[None]


def test_the_share_of_the_time_in_which_balls_are_at_a_wall(rail: Scene) -> None:
    specs = {
        "any": {"kind": "contact"},
        "wall": {"kind": "contact", "object": "wall"},
        "post": {"kind": "contact", "object": "post"},
        "cup": {"kind": "contact", "of": "cup", "object": "wall"},
        "cart": {"kind": "contact", "of": "cart", "object": "wall"},
    }
    # the hand (10 cm) is at the wall from 0.9 on, the cup (5 cm) from 0.95 on; at the post (10 cm) the hand from -0.8
    waypoints = moving([-0.79, -0.81, 0.0, 0.89, 0.91, 0.94, 0.96, 0.8])
    (found,) = bind_features(rail, specs).evaluate(waypoints)
    assert (found * 8).tolist() == [4, 3, 1, 1, 3]
    kind = KINDS["contact"]
    assert (kind.unit, kind.direction, kind.over_time) == ("share of the time", "cost", "mean")


def test_the_table_of_contacts_says_which_bodies_and_how_deep(rail: Scene) -> None:
    (motion,) = replay(rail, moving([0.0, 0.96]))
    touches = motion.contacts
    assert motion.contacts is touches  # found once
    names = {tuple(sorted(rail.model.body(int(body)).name for body in pair)) for pair in touches.bodies}
    assert names == {("hand", "wall"), ("cup", "wall")}
    assert touches.configuration.tolist() == [1, 1]
    np.testing.assert_allclose(sorted(touches.depth), [0.01, 0.06], atol=1e-9)


def test_against_mj_forward_everywhere(rail: Scene) -> None:
    waypoints = np.random.default_rng(0).uniform([-2, -3], [2, 3], (40, 6, 2))
    (motion,) = replay(rail, waypoints)
    model, data = rail.model, mujoco.MjData(rail.model)
    moved = {model.body(name).id for name in ("cart", "hand", "cup")}
    expected = np.zeros((3, 40, 6), dtype=bool)
    for n, t in np.ndindex(40, 6):
        data.qpos[:] = rail.home
        data.qpos[model.joint("x").qposadr[0]], data.qpos[model.joint("turn").qposadr[0]] = waypoints[n, t]
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            bodies = {int(model.geom_bodyid[geom]) for geom in contact.geom}
            if contact.dist < 0 and bodies & moved:
                expected[:, n, t] |= [True, model.body("wall").id in bodies, model.body("cup").id in bodies]
    assert (data.ncon > 0) or expected.any()
    for found, wanted in zip(
        (motion.touching(), motion.touching("", "wall"), motion.touching("cup")), expected, strict=True
    ):
        np.testing.assert_array_equal(found, wanted)
        assert 0.02 < wanted.mean() < 0.9


def test_what_lies_on_the_floor_does_not_touch(rail: Scene) -> None:
    (motion,) = replay(rail, moving([0.0, 0.1]))
    assert not motion.touching("parcel").any()


def test_what_cannot_be_is_said(rail: Scene, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"features\.c: .*no body named 'mug'; it has"):
        bind_features(rail, {"c": {"kind": "contact", "object": "mug"}})
    (tmp_path / "ghost.xml").write_text(RAIL.replace("<geom ", '<geom contype="0" conaffinity="0" '))
    ghost = load_scene(tmp_path / "ghost.xml", end_effector="hand", joints=["x", "turn"])
    with pytest.raises(SceneError, match=r"features\.c: .*geoms that collide, or leave features of contacts out"):
        bind_features(ghost, {"c": {"kind": "contact"}})
