"""Nothing that the joints move goes through the surface: links, end effector, and what it carries, solids included."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import clear_of, load_scene, replay
from pipeline.replay.outline import Solid
from pipeline.replay.surface import Surface, carried_bodies

JOINTS = ["rail", "swing", "bow"]
UPRIGHT = 'pos="0.5 0 0.05" size="0.6 0.3 0.05"'


def changed(gantry, *changes, **options):
    """The gantry, its file changed."""
    text = gantry.path.read_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    path = gantry.path.with_name("changed.xml")
    path.write_text(text)
    return load_scene(path, **({"end_effector": "hook", "joints": JOINTS} | options))


def test_over_under_and_beside(gantry):
    # the bench's top is at 0.1 and the hook, a ball of 0.02, at z = 0.5 - 0.3 sin(bow), so never under it
    down = np.array([[[0.0, 0.0, 1.5]]])
    assert clear_of(gantry, down, "bench").tolist() == [True]
    scene = changed(gantry, ('carriage" pos="0 0 0.5"', 'carriage" pos="0 0 0.35"'))
    level, dipped = [0.0, 0.0, 0.0], [0.0, 0.0, 1.5]  # hook at z = 0.05
    beyond, beside = [1.0, 0.0, 1.5], [0.0, np.pi / 2, 1.5]  # as deep, off its end (x > 1.1) and side (y > 0.3)
    trajectories = np.array([[level, level], [level, dipped], [dipped, level], [beyond, level], [beside, level]])
    assert clear_of(scene, trajectories, "bench").tolist() == [True, False, False, True, True]


def test_a_tilted_surface_written_out(gantry):
    scene = changed(gantry, (UPRIGHT, 'pos="0.5 0 0.4" size="0.6 0.3 0.05" euler="0.3 -0.4 0.5"'))
    waypoints = np.random.default_rng(5).uniform(-1.5, 1.5, (400, 4, 3))
    expected, depths = [], []
    data, bench = scene.rig.data(), scene.site_id("bench")
    for trajectory in waypoints:
        deepest = 0.0
        for configuration in trajectory:
            scene.rig.pose(data, configuration)
            # of the links the origins; the hook and its thumb are balls of 0.02 around theirs, the tip is a site
            for place, radius in [
                *((data.body(body).xpos, 0.0) for body in ("carriage", "boom", "wrist")),
                *((data.body(body).xpos, 0.02) for body in ("hook", "thumb")),
                (data.site("tip").xpos, 0.0),
            ]:
                x, y, z = (place - data.site_xpos[bench]) @ data.site_xmat[bench].reshape(3, 3)
                if abs(x) <= 0.6 and abs(y) <= 0.3:
                    deepest = max(deepest, 0.05 + radius - z)
        expected.append(deepest <= 0)
        depths.append(deepest)
    assert 0.1 < np.mean(expected) < 0.9
    assert clear_of(scene, waypoints, "bench").tolist() == expected
    top = Surface(scene, "bench")
    np.testing.assert_allclose(np.concatenate([top.depth(m) for m in replay(scene, waypoints)]), depths, atol=1e-14)
    yielding = Surface(scene, "bench", yields_m=0.1)
    cleared = np.concatenate([yielding.cleared_by(m) for m in replay(scene, waypoints)])
    assert cleared.tolist() == [depth <= 0.1 for depth in depths]
    assert cleared.sum() > np.sum(expected)


def test_no_trajectories(gantry):
    assert clear_of(gantry, np.empty((0, 5, 3)), "bench").shape == (0,)


@pytest.mark.parametrize(
    ("end_effector", "change", "carried"),
    [
        ("tip", [], ["hook", "thumb"]),  # a site: its body and what is below it
        ("hook", [], ["hook", "thumb"]),
        ("wrist", [], ["hook", "thumb", "wrist"]),
        (
            "tip", [("</worldbody>", '</worldbody><equality><weld body1="thumb" body2="parcel"/></equality>')],
            ["hook", "parcel", "thumb"],
        ),
    ],
)  # fmt: skip
def test_what_the_end_effector_carries(gantry, end_effector, change, carried):
    scene = changed(gantry, *change, end_effector=end_effector)
    assert sorted(scene.model.body(body).name for body in carried_bodies(scene)) == carried


@pytest.mark.parametrize(
    ("change", "depth"),
    [
        ([], 0.05),  # the site `tip`, the end effector, 0.1 beyond the hook
        ([('name="tip" pos="0.1 0 0"', 'name="tip" pos="0.02 0 0"')], 0.05 - 0.08),
        ([('<site name="tip"', '<site name="mark" pos="0.15 0 0"/><site name="tip"')], 0.1),  # a site beside it
        ([('<site name="tip"', '<geom type="box" pos="0.12 0 0" size="0.05 0.01 0.01"/><site name="tip"')], 0.12),
        (
            [('<site name="tip"', '<geom type="sphere" pos="0.12 0 0" size="0.05" rgba="1 1 1 0"/><site name="tip"')],
            0.12,
        ),
        (  # neither seen nor touched
            [(
                '<site name="tip"',
                '<geom pos="0.12 0 0" size="0.05" rgba="1 1 1 0" contype="0" conaffinity="0"/><site name="tip"',
            )],
            0.05,
        ),
        (  # a parcel that a weld hangs on the hook
            [(
                "</worldbody>",
                '</worldbody><equality><weld body1="hook" body2="parcel" relpose="0.12 0 0 1 0 0 0"/></equality>',
            )],
            0.17,
        ),
    ],
)  # fmt: skip
def test_all_that_is_carried_counts(gantry, change, depth):
    """The hook is turned straight down over the bench; how deep it goes is known for each thing that it carries."""
    scene = changed(gantry, ('carriage" pos="0 0 0.5"', 'carriage" pos="0 0 0.45"'), *change, end_effector="tip")
    down = np.array([[[0.0, 0.0, np.pi / 2]]])  # the hook at 0.45 - 0.3 = 0.15, the bench's top at 0.1
    (motion,) = replay(scene, down)
    assert Surface(scene, "bench").depth(motion)[0] == pytest.approx(max(depth, 0), abs=1e-12)
    assert clear_of(scene, down, "bench").tolist() == [depth < 0]


SOLIDS = {
    "sphere": '<geom type="sphere" size="0.1" pos="0.3 0.1 0"/>',
    "capsule": '<geom type="capsule" size="0.05 0.2" euler="0.5 0.3 0.1" pos="0.1 0.2 0.3"/>',
    "cylinder": '<geom type="cylinder" size="0.08 0.15" euler="0.5 0.3 0.1"/>',
    "box": '<geom type="box" size="0.1 0.2 0.02" euler="0.5 0.3 0.1" pos="0 0 0.1"/>',
    "ellipsoid": '<geom type="ellipsoid" size="0.1 0.2 0.05" euler="-0.5 0.3 0.1"/>',
    "mesh": '<geom type="mesh" mesh="ball" pos="0.1 0 0" euler="0.5 0 0"/>',
}


def solid(tmp_path: Path, name: str):
    corners = np.random.default_rng(0).normal(size=(700, 3))
    corners *= np.array([0.1, 0.05, 0.2]) / np.linalg.norm(corners, axis=1, keepdims=True)
    mesh = f'<asset><mesh name="ball" vertex="{" ".join(f"{x:.6f}" for x in corners.ravel())}"/></asset>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{mesh}<worldbody><body>{SOLIDS[name]}</body></worldbody></mujoco>")


@pytest.mark.parametrize("name", SOLIDS)
def test_an_outline_reaches_as_far_as_its_solid(tmp_path, name):
    """In every direction: never less far than MuJoCo's own distance to a plane says, and little further."""
    model = solid(tmp_path, name)
    solid_of_geom = Solid.of(model, 0)
    points, radii = solid_of_geom.points, solid_of_geom.radii
    size = np.ptp(points, axis=0).max() + 2 * radii.max()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for direction in np.random.default_rng(1).normal(size=(200, 3)):
        direction /= np.linalg.norm(direction)
        reach = float((points @ direction + radii).max())
        exact = support(model, data, direction)
        assert -1e-6 <= reach - exact <= 0.03 * size
        own = solid_of_geom.reach(direction[:, None])[0]
        assert own == pytest.approx(exact, abs=0.01 * size if name == "mesh" else 1e-12)


def support(model, data, direction):
    """How far a geom reaches along a direction, from its definition."""
    local, size = data.geom_xmat[0].reshape(3, 3).T @ direction, model.geom_size[0]
    types = mujoco.mjtGeom
    reach = {
        types.mjGEOM_SPHERE: lambda: size[0],
        types.mjGEOM_CAPSULE: lambda: size[0] + size[1] * abs(local[2]),
        types.mjGEOM_CYLINDER: lambda: size[0] * np.hypot(*local[:2]) + size[1] * abs(local[2]),
        types.mjGEOM_BOX: lambda: size @ np.abs(local),
        types.mjGEOM_ELLIPSOID: lambda: np.linalg.norm(size * local),
        types.mjGEOM_MESH: lambda: (model.mesh_vert @ local).max(),
    }[int(model.geom_type[0])]
    return float(data.geom_xpos[0] @ direction + reach())


def test_a_plank_across_a_narrow_surface_is_seen(gantry):
    """Its corners are beside the bench, its middle under the top."""
    plank = '<geom type="box" size="0.02 0.25 0.02"/><site name="tip"'
    narrow = (UPRIGHT, 'pos="0.5 0 0.45" size="0.6 0.06 0.06"')
    over = (UPRIGHT, 'pos="0.5 0 0.42" size="0.6 0.06 0.05"')
    level = np.array([[[0.0, 0.0, 0.0]]])  # the plank from 0.48 to 0.52
    assert clear_of(changed(gantry, ('<site name="tip"', plank), narrow), level, "bench").tolist() == [False]
    assert clear_of(changed(gantry, ('<site name="tip"', plank), over), level, "bench").tolist() == [True]


def test_a_surface_must_be_a_box_site_that_stays(gantry):
    nothing = np.zeros((1, 1, 3))
    with pytest.raises(SceneError, match=r"no site named 'table_top'; it has bench, dot, tip\.$"):
        clear_of(gantry, nothing)
    with pytest.raises(SceneError, match=r"'dot' .* is not a box"):
        clear_of(gantry, nothing, "dot")
    scene = changed(gantry, ('<site name="tip"', '<site name="tray" type="box" size="0.1 0.1 0.1"/><site name="tip"'))
    with pytest.raises(SceneError, match=r"'tray' .* is moved by the joints"):
        clear_of(scene, nothing, "tray")


def test_a_surface_on_a_mocap_body_is_where_the_keyframe_has_it(gantry):
    moved = (
        '<body name="parcel"',
        '<body name="desk" mocap="true" pos="9 9 9"><site name="desk" type="box" size="0.6 0.3 0.05"/></body>'
        '<body name="parcel"',
    )
    key = ('<key name="start"', '<key name="start" mpos="0.5 0 0.3"')
    scene = changed(gantry, moved, key)
    assert clear_of(scene, np.array([[[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]]), "desk").tolist() == [True, False]
