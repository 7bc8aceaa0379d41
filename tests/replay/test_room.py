"""Where an arm may be: the scene's limits, whatever the ends are; above the surface; and untouching, if asked."""

from __future__ import annotations

from math import radians
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pipeline.errors import SceneError, StageError
from pipeline.replay import load_scene
from pipeline.replay.contacts import Contacts, between, spread_first, with_drawn_solids
from pipeline.replay.mechanism.limits import TOLERANCE_RAD
from pipeline.replay.room import Room
from pipeline.trajectories.paths import Anchor, straight_path, within_limits
from pipeline.trajectories.samplers import Deformation, Fate

JOINTS = ["rail", "swing", "bow"]
LEVEL, ASIDE = np.array([0.0, -0.8, 0.0]), np.array([0.0, 0.8, 0.0])


def room(scene, start=LEVEL, goal=ASIDE, surface="bench", collisions=False):
    return Room.of(scene, surface, collisions, Anchor(start, goal), "demonstration 'p01'")


def changed(gantry, *changes):
    text = gantry.path.read_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    path = gantry.path.with_name("changed.xml")
    path.write_text(text)
    return load_scene(path, end_effector="hook", joints=JOINTS)


def test_an_end_a_little_beyond_a_limit_is_moved_onto_it(gantry):
    over = np.array([0.0, -0.8, 2.0 + 0.9 * TOLERANCE_RAD])
    made = room(gantry, start=over)
    assert made.anchor.start.tolist() == [0.0, -0.8, 2.0]
    assert made.anchor.goal.tolist() == ASIDE.tolist()
    assert made.remarks == ("start of demonstration 'p01' is 0.047 beyond a limit of 'bow'; paths keep to the limit",)
    drawn = made.draw(Deformation(0.3), np.random.default_rng(0), 50, 11).waypoints
    assert within_limits(drawn, gantry.lower, gantry.upper).all()


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (
            [0.0, 0.8, 2.0 + 1.1 * TOLERANCE_RAD],
            r"goal of demonstration 'p01': joint 'bow' is at 2\.0576; its limits are -2 to 2",
        ),
        ([0.0, 0.8, 1.0 + 2 * np.pi], r"joint 'bow' is at 7\.28319, a whole turn from its limits"),
        ([2.05, 0.8, 0.0], r"joint 'rail' is at 2\.05; its limits are -1 to 2 m\."),
    ],
)  # fmt: skip
def test_an_end_further_beyond_is_refused(gantry, goal, message):
    with pytest.raises(StageError, match=message):
        room(gantry, goal=np.array(goal))


def test_the_room_is_no_wider_for_what_was_found(gantry):
    """Three degrees beyond at the start: not one path goes beyond the limit, there or anywhere else."""
    made = room(gantry, start=np.array([0.0, -0.8, 2.0 + radians(2.9)]), goal=np.array([0.0, 0.8, 1.9]))
    drawn = made.draw(Deformation(0.2), np.random.default_rng(1), 200, 21)
    assert drawn.waypoints[:, :, 2].max() <= 2.0
    assert drawn.tallies[0].outside_limits > 0


# the bench's top is at 0.1; with the carriage at 0.4 the hook, a ball of 0.02, hangs at 0.4 - 0.3 sin(bow)
LOW = ('carriage" pos="0 0 0.5"', 'carriage" pos="0 0 0.4"')


def test_the_surface_gives_way_as_far_as_an_end_is_under_it(gantry):
    scene = changed(gantry, LOW)
    at = np.array([0.0, 0.0, np.pi / 2])  # 0.02 deep with the hook's ball alone
    with pytest.raises(
        StageError, match=r"goal of demonstration 'p01' has the arm or what it carries 10 cm under 'bench', 2 cm are"
    ):
        room(scene, goal=at)  # the site `tip`, 0.1 beyond the hook
    near = np.array([0.0, 0.0, 0.81])
    deepest = 0.1 - (0.4 - 0.4 * np.sin(0.81))
    assert -0.02 < deepest < 0.0
    assert room(scene, goal=near).remarks == ()
    touching = np.array([0.0, 0.0, 0.88])
    deepest = 0.1 - (0.4 - 0.4 * np.sin(0.88))
    assert 0.0 < deepest < 0.02
    made = room(scene, goal=touching)
    assert made.remarks == (
        f"goal of demonstration 'p01' has the arm or what it carries {100 * deepest:.2g} cm under 'bench'; "
        "paths may go as deep",
    )
    line = straight_path(Anchor(LEVEL, touching), 11)
    deeper = line + np.sin(np.linspace(0, np.pi, 11))[:, None] * [0, 0, 0.5]
    assert made.judge(np.stack([line, deeper])).tolist() == [Fate.KEPT, Fate.THROUGH_SURFACE]
    assert made.admissible(line[None]).tolist() == [True]


WALL = (
    "</worldbody>",
    '<body name="wall" pos="0.6 0 0.5"><geom name="wall" type="box" size="0.02 0.02 0.3"/></body></worldbody>',
)
LOOSE = ("<worldbody>", '<default><geom contype="0" conaffinity="0"/></default><worldbody>')


def touched(scene, trajectory):
    """The oracle: `mj_fwdPosition`'s contacts at very many poses, between bodies that the joints move apart."""
    data = scene.rig.data()
    moving = set(scene.moving_bodies().tolist())
    found = set()
    for configuration in between(trajectory, 0.005):
        scene.rig.pose(data, configuration)
        mujoco.mj_fwdPosition(scene.model, data)
        for contact in data.contact:
            bodies = {int(scene.model.geom_bodyid[geom]) for geom in contact.geom}
            if contact.dist < 0 and bodies & moving and bodies != {scene.body_id("hook"), scene.body_id("thumb")}:
                found.add(tuple(sorted(scene.model.body(body).name for body in bodies)))
    return found


def test_contacts_are_mujocos(gantry):
    """A pillar stands in the way of the arm: the paths that touch are those that MuJoCo says do."""
    scene = changed(gantry, WALL)
    contacts = Contacts(scene)
    paths = Deformation(0.5).sample(np.random.default_rng(0), Anchor(LEVEL, ASIDE), 60, 15)
    expected = [not touched(scene, path) for path in paths]
    assert 0.1 < np.mean(expected) < 0.9
    assert contacts.free(paths).tolist() == expected
    assert contacts.free(np.empty((0, 15, 3))).shape == (0,)


def overlapping(scene, trajectory):
    """The oracle: MuJoCo's distance of each solid that moves from each that stays, at many poses."""
    data = scene.rig.data()
    moved = scene.rig.carrier[scene.model.geom_bodyid] >= 0
    for configuration in between(trajectory, 0.05):
        scene.rig.pose(data, configuration)
        for one in np.flatnonzero(moved).tolist():
            for other in np.flatnonzero(~moved).tolist():
                if mujoco.mj_geomDistance(scene.model, data, one, other, 1.0, None) < 0:
                    return True
    return False


def test_what_is_drawn_touches_where_the_scene_lets_nothing_touch(gantry):
    scene = changed(gantry, LOOSE, WALL)
    with pytest.raises(SceneError, match="nothing that the joints move can touch anything"):
        Contacts(scene)
    paths = Deformation(0.5).sample(np.random.default_rng(0), Anchor(LEVEL, ASIDE), 40, 15)
    expected = [not overlapping(scene, path) for path in paths]
    assert 0.1 < np.mean(expected) < 0.9
    drawn = with_drawn_solids(scene)
    assert Contacts(drawn).free(paths).tolist() == expected
    assert not scene.model.geom_contype.any()
    without = Contacts(with_drawn_solids(changed(gantry, LOOSE))).free(paths)
    assert without.mean() > np.mean(expected)
    for unseen in ('rgba="1 1 1 0"', 'group="4"'):
        wall = (WALL[0], WALL[1].replace('type="box"', f'type="box" {unseen}'))
        assert Contacts(with_drawn_solids(changed(gantry, LOOSE, wall))).free(paths).tolist() == without.tolist()


def test_a_clearance_is_kept_from_what_stays(gantry):
    scene = changed(gantry, WALL)
    wall = scene.model.geom("wall").id
    moved = np.flatnonzero(scene.rig.carrier[scene.model.geom_bodyid] >= 0).tolist()
    pairs = [(one, other) for one in range(scene.model.ngeom) for other in range(one) if wall not in (one, other)]
    others = {(min(pair), max(pair)): 1.0 for pair in pairs}
    paths = Deformation(0.5).sample(np.random.default_rng(0), Anchor(LEVEL, ASIDE), 60, 15)
    data = scene.rig.data()

    def least(path):
        found = []
        for configuration in between(path, 0.05):
            scene.rig.pose(data, configuration)
            found += [mujoco.mj_geomDistance(scene.model, data, one, wall, 1.0, None) for one in moved]
        return min(found)

    nearest = np.array([least(path) for path in paths])
    for clearance_m in (0.0, 0.05):
        expected = nearest >= clearance_m
        assert 0.1 < expected.mean() < 0.9
        assert Contacts(scene, others, clearance_m=clearance_m).free(paths).tolist() == expected.tolist()
    assert ((nearest >= 0) != (nearest >= 0.05)).any()
    assert not scene.model.geom_margin.any()
    # what is nearer at an end may be as near on the way
    near = Anchor(*(path[np.argmin([least(path[[i, i]]) for i in range(15)])] for path in paths[nearest >= 0][:2]))
    assert Room.of(scene, None, True, near, "the plan", 0.5).admissible(np.array([[near.start] * 2])).all()


def test_a_thin_wall_is_met_between_two_waypoints(gantry):
    scene = changed(gantry, WALL)
    two = np.array([[[0.0, -0.8, 0.0], [0.0, 0.8, 0.0]]])  # on either side of the pillar
    assert Contacts(scene).depths(two[0, 0]) == {}
    assert Contacts(scene).depths(two[0, 1]) == {}
    assert Contacts(scene).free(two).tolist() == [False]


def test_meshes_touch(gantry):
    corners = "0.02 0.02 0.3 -0.02 0.02 0.3 0.02 -0.02 0.3 -0.02 -0.02 0.3 0 0 -0.3"
    mesh = ("<worldbody>", f'<asset><mesh name="spike" vertex="{corners}"/></asset><worldbody>')
    spike = (WALL[0], WALL[1].replace('type="box" size="0.02 0.02 0.3"', 'type="mesh" mesh="spike"'))
    scene = changed(gantry, mesh, spike)
    paths = Deformation(0.5).sample(np.random.default_rng(0), Anchor(LEVEL, ASIDE), 40, 15)
    expected = [not touched(scene, path) for path in paths]
    assert 0.1 < np.mean(expected) < 0.9
    assert Contacts(scene).free(paths).tolist() == expected


def test_what_is_carried_touches_too(gantry):
    # wide enough that the arm passes over, the parcel that hangs from the hook does not
    low = (WALL[0], WALL[1].replace('pos="0.6 0 0.5"', 'pos="0.6 0 0.1"'))
    held = (
        "</worldbody>",
        '</worldbody><equality><weld body1="hook" body2="parcel" relpose="0 0 -0.2 1 0 0 0"/></equality>',
    )
    path = np.linspace(LEVEL, ASIDE, 15)[None]
    assert Contacts(changed(gantry, low)).free(path).tolist() == [True]
    assert Contacts(changed(gantry, low, held)).free(path).tolist() == [False]


def test_what_stays_may_touch_and_what_is_held_too(gantry):
    """A bin in the floor, and a parcel gripped by the thumb: neither is changed by the joints."""
    floor = ("</worldbody>", '<geom type="plane" size="5 5 0.1" pos="0 0 0.25"/></worldbody>')
    scene = changed(gantry, floor)
    assert Contacts(scene).depths(LEVEL) == {}
    assert Contacts(scene).free(np.linspace(LEVEL, ASIDE, 5)[None]).tolist() == [True]
    gripped = (
        "</worldbody>",
        '</worldbody><equality><weld body1="hook" body2="parcel" relpose="0.05 0 0 1 0 0 0"/></equality>',
    )
    assert Contacts(changed(gantry, floor, gripped)).depths(LEVEL) == {}


def test_what_touches_at_the_ends_may_touch_as_deep_on_the_way(gantry):
    at = 0.5 - 0.02 + 0.005  # the hook's ball is half a centimetre in the shelf
    shelf = ("</worldbody>", f'<geom name="shelf" type="box" size="2 2 0.01" pos="0 0 {at - 0.01}"/></worldbody>')
    exclude = (
        "<keyframe>",
        '<contact><exclude body1="world" body2="carriage"/><exclude body1="world" body2="boom"/>'
        '<exclude body1="world" body2="wrist"/></contact><keyframe>',
    )
    scene = changed(gantry, shelf, exclude)
    made = room(scene, surface=None, collisions=True)
    assert len(made.remarks) == 4  # hook and thumb, at both ends
    assert (
        made.remarks[0]
        == "start of demonstration 'p01' has 'world' and 'hook' 0.5 cm in each other; paths may have them as deep"
    )
    line = straight_path(Anchor(LEVEL, ASIDE), 9)
    deeper = line + np.sin(np.linspace(0, np.pi, 9))[:, None] * [0, 0, 0.1]
    higher = line - np.sin(np.linspace(0, np.pi, 9))[:, None] * [0, 0, 0.1]
    assert made.judge(np.stack([line, deeper, higher])).tolist() == [Fate.KEPT, Fate.IN_COLLISION, Fate.KEPT]
    deep = ("</worldbody>", '<geom name="shelf" type="box" size="2 2 0.01" pos="0 0 0.49"/></worldbody>')
    with pytest.raises(
        StageError,
        match=r"start of demonstration 'p01' has 'world' and 'hook' 2 cm in each other, 1 cm are tolerated; .* "
        r"<exclude",
    ):
        room(changed(gantry, deep, exclude), surface=None, collisions=True)


def test_a_ring_may_turn_on_the_column_that_it_sits_on(tmp_path: Path) -> None:
    """Its depth is the same at every angle, but not to the last bit."""
    (tmp_path / "ring.xml").write_text("""<mujoco><worldbody>
      <body name="base"><geom type="cylinder" pos="0 0 0.08" size="0.043 0.074"/>
        <body name="link" pos="0 0 0.15675" xyaxes="-1 0 0 0 1 0">
          <joint name="turn" axis="0 0 1"/><geom type="cylinder" size="0.0445 0.007"/>
        </body></body></worldbody>
      <keyframe><key name="start" qpos="1.8186"/><key name="goal" qpos="3.6792"/></keyframe></mujoco>""")
    scene = load_scene(tmp_path / "ring.xml", end_effector="link", joints=["turn"])
    made = Room.of(scene, None, True, Anchor(np.array([1.8186]), np.array([3.6792])), "the plan")
    assert len(made.remarks) == 2
    paths = np.linspace(1.8186, np.linspace(2.0, 6.0, 20), 15)[..., None].swapaxes(0, 1)
    assert made.admissible(paths).all()


def test_where_nothing_can_touch_it_is_said(gantry):
    with pytest.raises(SceneError, match=r"nothing that the joints move can touch anything, .* contype meets"):
        room(changed(gantry, LOOSE), collisions=True)
    disabled = ("<worldbody>", '<option><flag contact="disable"/></option><worldbody>')
    with pytest.raises(SceneError, match="contacts are disabled"):
        Contacts(changed(gantry, disabled))
    paired = ("<keyframe>", '<contact><pair geom1="wall" geom2="tool"/></contact><keyframe>')
    tool = ('<site name="tip"', '<geom name="tool" size="0.1"/><site name="tip"')
    path = np.linspace(LEVEL, ASIDE, 15)[None]
    assert Contacts(changed(gantry, LOOSE, WALL, tool, paired)).free(path).tolist() == [False]


def test_fates_are_judged_in_order(gantry):
    """What goes through the surface is not looked at for contacts; what does not is, in one replay."""
    scene = changed(gantry, LOW, WALL)
    made = room(scene, collisions=True)
    wave = np.sin(np.linspace(0, np.pi, 11))[:, None]
    line = straight_path(made.anchor, 11)
    over, down = line + wave * [0, 0, -1.2], line + wave * [0, 0, 1.5]
    assert made.judge(np.stack([line, over, down])).tolist() == [Fate.IN_COLLISION, Fate.KEPT, Fate.THROUGH_SURFACE]
    drawn = made.draw(Deformation(0.8), np.random.default_rng(0), 20, 11)
    (tally,) = drawn.tallies
    assert tally.kept == 20
    assert tally.in_collision > 0
    assert tally.through_surface > 0
    assert made.admissible(drawn.waypoints).all()


@pytest.mark.parametrize("count", [1, 2, 3, 7, 8, 9, 41])
def test_every_pose_is_looked_at_once(count):
    poses = np.arange(float(count))[:, None]
    assert sorted(pose[0] for pose in spread_first(poses)) == list(range(count))


def test_steps_between_waypoints_are_cut():
    path = np.array([[0.0, 0.0], [0.1, 0.24], [0.1, 0.25], [0.1, 0.25]])
    cut = between(path, 0.05)
    assert len(cut) == 5 + 1 + 1 + 1
    assert np.abs(np.diff(cut, axis=0)).max() <= 0.05
    for waypoint in path:
        assert (cut == waypoint).all(axis=1).any()
