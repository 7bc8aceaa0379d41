"""Kinds of features that average or take an extreme, against MuJoCo waypoint by waypoint."""

import numpy as np
import pytest

from pipeline.errors import ArgumentError, ParameterError, SceneError
from pipeline.replay import bind_features, body_positions, load_scene, replay
from pipeline.replay.features import KINDS
from pipeline.vocabulary import DIRECTIONS, OVER_TIME
from tests.oracles import slow_motion

SPECS = {
    "speed": {"kind": "speed", "duration_s": 4},
    "tip speed": {"kind": "speed", "of": "tip"},
    "jerk": {"kind": "jerk", "duration_s": 2.0},
    "over bench": {"kind": "clearance", "over": "bench"},
    "over bin": {"kind": "clearance", "over": "bin", "of": "tip"},
    "from bin": {"kind": "distance", "object": "bin"},
    "from point": {"kind": "point_distance", "x_m": 1, "y_m": 0.5, "z_m": 0},
    "cup": {"kind": "upright", "body": "hook"},
    "sideways": {"kind": "upright", "body": "tip", "axis": "x"},
    "near": {"kind": "time_near", "object": "bin", "radius_m": 0.8},
    "limits": {"kind": "limit_nearness"},
    "agile": {"kind": "manipulability"},
}


@pytest.fixture
def waypoints():
    return np.random.default_rng(3).uniform(-0.9, 0.9, (8, 6, 3))


def expected(scene, trajectory):
    hook, turned = slow_motion.poses(scene, trajectory, "hook")
    tip, tip_turned = slow_motion.poses(scene, trajectory, "tip")
    bin_at = np.array([1, 0.2, 0.3])
    rail, bow = trajectory[:, 0], trajectory[:, 2]
    return [
        slow_motion.greatest_speed(hook, 4),
        slow_motion.greatest_speed(tip, 1),
        slow_motion.mean_squared_jerk(hook, 2),
        min(place[2] for place in hook) - 0.1,  # the bench is 0.1 m high
        min(place[2] for place in tip) - 0.3,
        np.mean([np.linalg.norm(place - bin_at) for place in hook]),
        np.mean([np.linalg.norm(place - [1, 0.5, 0]) for place in hook]),
        max(slow_motion.angle_to_vertical(axes[:, 2]) for axes in turned),
        max(slow_motion.angle_to_vertical(axes[:, 0]) for axes in tip_turned),
        slow_motion.share_near([place - bin_at for place in hook], 0.8),
        max(max(abs(x - 0.5) / 1.5 for x in rail), max(abs(x) / 2 for x in bow)),  # swing has no limits
        slow_motion.least_volume(scene, trajectory, "hook"),
    ]


def test_against_one_waypoint_after_another(gantry, waypoints):
    found = bind_features(gantry, SPECS).evaluate(waypoints)
    slow = np.array([expected(gantry, trajectory) for trajectory in waypoints])
    near = list(SPECS).index("near")
    np.testing.assert_allclose(found[:, near], slow[:, near], atol=1e-4)
    np.testing.assert_allclose(np.delete(found, near, 1), np.delete(slow, near, 1), rtol=1e-7, atol=1e-12)
    assert np.ptp(found, axis=0).min() > 0


def test_every_kind_says_what_it_is(gantry):
    features = bind_features(gantry, SPECS)
    assert set(features.directions) <= set(DIRECTIONS)
    assert set(features.over_time) <= set(OVER_TIME)
    assert dict(zip(features.names, features.units, strict=True))["jerk"] == "m^2/s^6"
    assert all(KINDS[name].direction == "cost" for name in ("efficiency", "height", "proximity", "path_length", "tilt"))
    assert all(KINDS[name].direction == "wish" for name in ("clearance", "manipulability"))


def test_rates_are_difference_quotients(gantry, waypoints):
    (motion,) = replay(gantry, waypoints)
    assert motion.time.tolist() == [0, 0.2, 0.4, 0.6000000000000001, 0.8, 1]
    for rates, values in ((motion.joint_velocities, waypoints), (motion.velocity("tip"), motion.position("tip"))):
        for t in range(6):
            before, after = max(t - 1, 0), min(t + 1, 5)
            by_hand = (values[:, after] - values[:, before]) / ((after - before) / 5)
            np.testing.assert_allclose(rates[:, t], by_hand, rtol=1e-12, atol=1e-12)
    (single,) = replay(gantry, waypoints[:, :1])
    with pytest.raises(ArgumentError, match="a velocity needs at least 2 waypoints"):
        single.velocity("tip")


COUPLED = """
<mujoco><compiler angle="radian"/><worldbody>
  <body><joint name="a" axis="0 0 1"/><geom size=".05"/>
    <body pos=".4 0 0"><joint name="b" axis="0 1 0"/><geom size=".05"/>
      <body name="end" pos=".3 0 0"><joint name="c" axis="0 1 0"/><geom size=".05"/>
        <site name="tip" pos=".2 0 0"/></body>
    </body></body></worldbody>
  <equality><joint joint1="c" joint2="b" polycoef="0 0.5 0.3 0 0"/></equality>
</mujoco>
"""


def test_the_jacobian_follows_what_the_joints_lead(tmp_path):
    (tmp_path / "coupled.xml").write_text(COUPLED)
    scene = load_scene(tmp_path / "coupled.xml", end_effector="tip")
    assert scene.joints == ("a", "b")
    waypoints = np.random.default_rng(1).uniform(-1, 1, (3, 4, 2))
    (motion,) = replay(scene, waypoints)
    for joint in range(2):
        step = 1e-6 * np.eye(2)[joint]
        ends = [body_positions(scene, waypoints + sign * step, ["tip"])["tip"] for sign in (1, -1)]
        np.testing.assert_allclose(motion.jacobian("tip")[..., joint], (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def test_a_turned_surface_is_as_high_as_its_highest_corner(tmp_path):
    text = COUPLED.replace("<worldbody>", '<worldbody><site name="desk" type="box" size="1 1 .1" euler="0 .5 0"/>')
    (tmp_path / "desk.xml").write_text(text)
    features = bind_features(load_scene(tmp_path / "desk.xml"), {"c": {"kind": "clearance", "over": "desk"}})
    assert features.evaluate(np.zeros((1, 4, 2))) == pytest.approx(-(np.sin(0.5) + 0.1 * np.cos(0.5)))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"kind": "speed", "duration_s": 0}, r"features\.f: duration_s is 0\.0; it must be positive"),
        ({"kind": "upright", "body": "hook", "axis": "up"}, r"axis is 'up'; allowed are x, y, z"),
        ({"kind": "time_near", "object": "bin", "radius_m": -1}, r"radius_m is -1\.0"),
    ],
)
def test_what_is_out_of_range_is_said(gantry, spec, message):
    with pytest.raises(ParameterError, match=message):
        bind_features(gantry, {"f": spec})


def test_no_limits_no_nearness(gantry_path):
    scene = load_scene(gantry_path, end_effector="hook", joints=["swing"])
    with pytest.raises(SceneError, match=r"features\.f: .*no joint has limits, so none can be near"):
        bind_features(scene, {"f": {"kind": "limit_nearness"}})


def test_jerk_needs_four_waypoints(gantry, waypoints):
    features = bind_features(gantry, {"f": {"kind": "jerk"}})
    with pytest.raises(ArgumentError, match="jerk needs at least 4 waypoints"):
        features.evaluate(waypoints[:, :3])
