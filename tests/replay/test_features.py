import numpy as np
import pytest

from pipeline.errors import ArgumentError, ParameterError, SceneError, StageError
from pipeline.replay import bind_features, body_positions, feature, load_scene
from pipeline.replay.features import KINDS

SPECS = {
    "effort": {"kind": "efficiency"},
    "over bin": {"kind": "height", "above": "bin"},
    "off": {"kind": "proximity", "object": "bin", "radius_m": 1},
    "way": {"kind": "path_length"},
    "lean": {"kind": "tilt", "body": "hook"},
}


@pytest.fixture
def waypoints():
    return np.random.default_rng(3).uniform(-1, 1, (40, 6, 3))


def test_against_sums_written_out(gantry, waypoints):
    features = bind_features(gantry, SPECS)
    assert features.names == ("effort", "over bin", "off", "way", "lean")
    assert features.units == ("m^2 + rad^2", "m", "m", "m", "rad")
    hook = body_positions(gantry, waypoints, ["hook"])["hook"]
    expected = np.zeros((len(waypoints), 5))
    for n in range(len(waypoints)):
        for t in range(1, 6):
            q, previous = waypoints[n, t], waypoints[n, t - 1]
            expected[n, 0] += ((q - previous) ** 2).sum()
            expected[n, 1] += hook[n, t, 2] - 0.3
            expected[n, 2] += max(0.0, 1 - np.hypot(hook[n, t, 0] - 1, hook[n, t, 1] - 0.2))
            expected[n, 3] += np.linalg.norm(hook[n, t] - hook[n, t - 1])
            expected[n, 4] += abs(q[2])  # the hook leans by the bow joint alone
    np.testing.assert_allclose(features.evaluate(waypoints), expected, rtol=1e-12, atol=1e-13)


def test_hinges_alone_give_square_radians(gantry_path):
    scene = load_scene(gantry_path, end_effector="hook", joints=["swing"])
    assert bind_features(scene, {"e": {"kind": "efficiency"}}).units == ("rad^2",)


def test_defaults_are_the_world_and_forty_centimetres(gantry, waypoints):
    plain = {"h": {"kind": "height"}, "p": {"kind": "proximity", "object": "bin"}}
    given = {
        "h": {"kind": "height", "above": "world"},
        "p": {"kind": "proximity", "object": "bin", "radius_m": 0.4},
    }
    got, same = (bind_features(gantry, specs).evaluate(waypoints) for specs in (plain, given))
    assert (got == same).all()
    assert got[:, 1].max() > 0


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({}, r"features\.f\.kind is None; allowed are clearance, contact, distance, efficiency, height"),
        ({"kind": "haste"}, r"features\.f\.kind is 'haste'; allowed are clearance"),
        ({"kind": "efficiency", "gain": 2}, r"features\.f\.gain is unknown to efficiency; allowed are \(none\)"),
        ({"kind": "proximity", "radius": 2}, r"features\.f\.radius is unknown .* allowed are object, of, radius_m"),
        ({"kind": "proximity"}, r"features\.f\.object is missing"),
        ({"kind": "proximity", "object": 3}, r"features\.f\.object is 3; it must be of type str"),
        ({"kind": "proximity", "object": "bin", "radius_m": "1"}, r"radius_m is '1'; it must be of type float"),
        ({"kind": "proximity", "object": "bin", "radius_m": True}, r"radius_m is True"),
        ({"kind": "proximity", "object": "bin", "radius_m": -1.0}, r"features\.f: radius_m is -1\.0"),
    ],
)
def test_specs_are_checked(gantry, spec, message):
    with pytest.raises(ParameterError, match=message):
        bind_features(gantry, {"f": spec})


def test_objects_are_looked_up(gantry):
    with pytest.raises(SceneError, match=r"features\.f: .*no body or site named 'cup'; its bodies are bin, boom"):
        bind_features(gantry, {"f": {"kind": "proximity", "object": "cup"}})


def test_no_feature(gantry):
    with pytest.raises(ParameterError, match="features is empty"):
        bind_features(gantry, {})


@pytest.fixture
def registered():
    before = dict(KINDS)
    yield
    KINDS.clear()
    KINDS.update(before)


@pytest.mark.usefixtures("registered")
def test_a_kind_of_ones_own(gantry, waypoints):
    @feature("furthest", unit="m")
    def furthest(motion, *, of: str, times: int = 1):
        return motion.position(of)[..., 0].max(axis=1) * times

    features = bind_features(gantry, {"reach": {"kind": "furthest", "of": "tip", "times": 2}})
    tip = body_positions(gantry, waypoints, ["tip"])["tip"]
    assert features.evaluate(waypoints)[:, 0].tolist() == (2 * tip[..., 0].max(axis=1)).tolist()
    with pytest.raises(ArgumentError, match="'furthest' is registered already"):
        feature("furthest", unit="m")(furthest)


@pytest.mark.usefixtures("registered")
def test_not_finite_is_an_error_that_says_where(gantry):
    @feature("inverse", unit="1/rad")
    def inverse(motion):
        with np.errstate(divide="ignore"):
            return 1 / motion.waypoints[:, -1, 2]

    features = bind_features(gantry, {"f": {"kind": "inverse"}})
    waypoints = np.ones((2000, 6, 3))
    waypoints[1700, -1, 2] = 0
    with pytest.raises(StageError, match="feature 'f' is inf for trajectory 1700;"):
        features.evaluate(waypoints)


@pytest.mark.usefixtures("registered")
def test_one_number_per_trajectory(gantry):
    feature("raw", unit="rad")(lambda motion: motion.waypoints)
    with pytest.raises(StageError, match=r"'f' returned shape \(1, 4, 3\)"):
        bind_features(gantry, {"f": {"kind": "raw"}})
