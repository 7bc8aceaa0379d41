"""The kinesthetic demonstration against the lab's alternatives: the posterior equals that of the slow loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pipeline.choice import LESS, Boltzmann, infer, select_bandwidth, theta_grid
from pipeline.formats.mcap.joint_states import read_joint_states
from pipeline.replay.features import bind_features
from pipeline.replay.scene import load_scene
from pipeline.trajectories.timebase import moving_part
from tests.oracles import slow_choice

ROOT = Path(__file__).resolve().parents[2]
THETAS, BETAS = theta_grid([[0, 0.5, 1]] * 3), (0.1, 1.0, 10.0, 100.0)
FEATURES = {
    "efficiency": {"kind": "efficiency"},
    "laptop": {"kind": "proximity", "object": "laptop", "radius_m": 0.4},
    "table": {"kind": "height"},
}


@pytest.fixture(scope="module")
def phi(shared: Path) -> tuple[np.ndarray, np.ndarray]:
    """Features of 1,427 alternatives and of the demonstration, each divided by its range over the alternatives."""
    scene = load_scene(ROOT / "datasets" / "scenes" / "laptop.xml", end_effector="j2s7s300_link_7")
    features = bind_features(scene, FEATURES)
    table = pl.read_parquet(shared / "real" / "jaco" / "alternatives.parquet")
    paths = table["waypoints"].to_numpy().reshape(-1, 41, 7)
    recorded = read_joint_states(
        shared / "real" / "jaco" / "recordings" / "kinesthetic_ID0_task0.mcap", joints=scene.joints
    )
    time_s = (recorded.time_ns - recorded.time_ns[0]) * 1e-9
    part = moving_part(time_s, recorded.positions, scene.continuous)
    waypoints = part.waypoints(paths[0, 0], scene.continuous, 41)
    alternatives, demonstration = features.evaluate(paths), features.evaluate(waypoints[None])
    scale = np.ptp(alternatives, axis=0)
    return alternatives / scale, demonstration / scale


@pytest.mark.parametrize("name", ["boltzmann", "less"])
def test_posterior_of_the_kinesthetic_demonstration(phi: tuple[np.ndarray, np.ndarray], name: str) -> None:
    alternatives, demonstration = phi
    assert alternatives.shape == (1427, 3)
    sigma = select_bandwidth(alternatives).value
    posterior = infer(Boltzmann() if name == "boltzmann" else LESS(), demonstration, alternatives, THETAS, BETAS)
    rows = [*alternatives.tolist(), demonstration[0].tolist()]
    log_w = (slow_choice.boltzmann if name == "boltzmann" else slow_choice.less(sigma))(rows)
    likelihoods = [[slow_choice.log_choice(rows, log_w, theta, beta)[-1] for beta in BETAS] for theta in THETAS]
    expected = slow_choice.log_posterior([likelihoods], np.zeros((len(THETAS), len(BETAS))))
    np.testing.assert_allclose(posterior.log_probability, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(posterior.marginal_theta, np.exp(expected).sum(axis=1), rtol=1e-9)
