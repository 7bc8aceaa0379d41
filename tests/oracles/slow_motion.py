"""Features of a motion, one waypoint after another, with MuJoCo's own kinematics and Jacobian."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from pipeline.arrays import FloatArray
from pipeline.replay.scene import Scene


def poses(scene: Scene, trajectory: FloatArray, name: str) -> tuple[list[FloatArray], list[FloatArray]]:
    """Position (3,) and orientation (3, 3) of a body or site at every waypoint (T, J)."""
    positions, orientations = [], []
    for configuration in trajectory:
        data = _posed(scene, configuration)
        kind = "body" if mujoco.mj_name2id(scene.model, mujoco.mjtObj.mjOBJ_BODY, name) >= 0 else "site"
        place = getattr(data, kind)(name)
        positions.append(place.xpos.copy())
        orientations.append(place.xmat.reshape(3, 3).copy())
    return positions, orientations


def greatest_speed(positions: list[FloatArray], duration_s: float) -> float:
    step_s = duration_s / (len(positions) - 1)
    return max(math.dist(a, b) / step_s for a, b in pairwise(positions))


def mean_squared_jerk(positions: list[FloatArray], duration_s: float) -> float:
    """Each derivative a difference quotient of the one before."""
    step_s, rates = duration_s / (len(positions) - 1), positions
    for _ in range(3):
        rates = [(b - a) / step_s for a, b in pairwise(rates)]
    return sum(float(rate @ rate) for rate in rates) / len(rates)


def share_near(offsets: list[FloatArray], radius_m: float, samples: int = 20_000) -> float:
    """By looking at many moments of each step."""
    inside, s = 0, (np.arange(samples) + 0.5)[:, None] / samples
    for a, b in pairwise(offsets):
        inside += int((np.linalg.norm(a + s * (b - a), axis=1) <= radius_m).sum())
    return inside / samples / (len(offsets) - 1)


def angle_to_vertical(axis: FloatArray) -> float:
    return math.acos(max(-1.0, min(1.0, float(axis[2]))))


def least_volume(scene: Scene, trajectory: FloatArray, name: str) -> float:
    """Least product of the singular values of MuJoCo's Jacobian of a body's position."""
    least, dofs = math.inf, scene.model.jnt_dofadr[scene.rig.joint_ids]
    for configuration in trajectory:
        data = _posed(scene, configuration)
        mujoco.mj_comPos(scene.model, data)
        jacobian = np.zeros((3, scene.model.nv))
        mujoco.mj_jacBody(scene.model, data, jacobian, None, scene.body_id(name))
        least = min(least, float(np.prod(np.linalg.svd(jacobian[:, dofs], compute_uv=False))))
    return least


def _posed(scene: Scene, configuration: FloatArray) -> Any:
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.home
    data.qpos[scene.qpos_addresses] = configuration
    mujoco.mj_kinematics(scene.model, data)
    return data
