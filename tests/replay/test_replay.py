import mujoco
import numpy as np
import pytest

from pipeline.errors import ArgumentError, SceneError
from pipeline.replay import body_positions, replay


@pytest.fixture
def waypoints():
    return np.random.default_rng(7).uniform(-1, 1, (23, 5, 3))


def one_by_one(scene, waypoints, kind, name):
    """The oracle: one mj_kinematics per waypoint on the model as the file has it."""
    data = mujoco.MjData(scene.model)
    positions = np.empty((*waypoints.shape[:2], 3))
    for n, t in np.ndindex(waypoints.shape[:2]):
        data.qpos[:] = scene.home
        data.qpos[scene.qpos_addresses] = waypoints[n, t]
        mujoco.mj_kinematics(scene.model, data)
        positions[n, t] = data.body(name).xpos if kind == "body" else data.site(name).xpos
    return positions


@pytest.mark.parametrize(("kind", "name"), [("body", "hook"), ("body", "parcel"), ("body", "bin"), ("site", "tip")])
def test_same_as_one_by_one(gantry, waypoints, kind, name):
    got = body_positions(gantry, waypoints, [name])[name]
    assert np.abs(got - one_by_one(gantry, waypoints, kind, name)).max() < 1e-14


def test_closed_form(gantry):
    rail, swing, bow = 0.7, 0.5, -0.3
    reach = 0.4 + 0.4 * np.cos(bow)
    expected = [rail + reach * np.cos(swing), reach * np.sin(swing), 0.5 - 0.4 * np.sin(bow)]
    got = body_positions(gantry, np.array([[[rail, swing, bow]]]), ["tip"])["tip"][0, 0]
    np.testing.assert_allclose(got, expected, atol=1e-15)


def test_joints_not_replayed_stay_at_the_start_keyframe(gantry, waypoints):
    (motion,) = replay(gantry, waypoints[:1])
    thumb, hook = motion.rotation("thumb")[0], motion.rotation("hook")[0]
    # the grip joint turns the thumb by 0.7 rad against the hook, whatever the arm does
    assert np.abs(np.trace(np.swapaxes(hook, 1, 2) @ thumb, axis1=1, axis2=2) - 1 - 2 * np.cos(0.7)).max() < 1e-14


def test_bits_do_not_depend_on_chunks(gantry):
    waypoints = np.random.default_rng(1).uniform(-1, 1, (301, 11, 3))
    whole = next(replay(gantry, waypoints, chunk=301)).position("tip")
    for chunk in (7, 64, 1, None):
        parts = [motion.position("tip") for motion in replay(gantry, waypoints, chunk=chunk)]
        assert np.concatenate(parts).tobytes() == whole.tobytes()


def test_chunks_come_in_order_and_stay_valid(gantry, waypoints):
    motions = list(replay(gantry, waypoints, chunk=10))
    assert [(motion.first, len(motion.waypoints)) for motion in motions] == [(0, 10), (10, 10), (20, 3)]
    assert (np.concatenate([m.waypoints for m in motions]) == waypoints).all()
    expected = one_by_one(gantry, waypoints, "body", "hook")
    assert np.abs(np.concatenate([m.end_effector for m in motions]) - expected).max() < 1e-14


def test_no_trajectories(gantry):
    nothing = np.empty((0, 5, 3))
    assert list(replay(gantry, nothing)) == []
    assert body_positions(gantry, nothing, ["tip"])["tip"].shape == (0, 5, 3)


@pytest.mark.parametrize("shape", [(5, 3), (2, 5, 4), (2, 0, 3)])
def test_shapes(gantry, shape):
    with pytest.raises(ArgumentError, match=r"must be \(N, T, 3\).*rail, swing, bow"):
        replay(gantry, np.zeros(shape))


def test_other_arguments(gantry, waypoints):
    waypoints[4, 2, 1] = np.nan
    with pytest.raises(ArgumentError, match="trajectory 4 are not all finite"):
        replay(gantry, waypoints)
    with pytest.raises(ArgumentError, match="chunk is 0"):
        replay(gantry, waypoints[:1], chunk=0)
    with pytest.raises(SceneError, match="'nose'"):
        body_positions(gantry, waypoints[:1], ["nose"])
