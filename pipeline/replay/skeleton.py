"""The bodies, joints and sites of a compiled scene without anything to see or touch: all that replay needs."""

from __future__ import annotations

from typing import Any

import mujoco


def skeleton_of(model: Any) -> Any:
    """A model with the same bodies, joints and sites, in the same order, and nothing else.

    Built from the compiled values and not by deleting geoms from the file's specification, because tendons,
    sensors, actuators and inertias may depend on geoms. `qpos`, body and site indices mean the same in both models;
    forward kinematics agrees to rounding.

    Args:
        model: `mujoco.MjModel`.

    Returns:
        `mujoco.MjModel`.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = [spec.worldbody]
    for index in range(1, model.nbody):
        body = bodies[model.body_parentid[index]].add_body(pos=model.body_pos[index], quat=model.body_quat[index])
        body.explicitinertial = True  # a moving body must have one; kinematics does not use it
        body.mass, body.inertia = 1.0, [1.0, 1.0, 1.0]
        bodies.append(body)
    for index in range(model.njnt):
        bodies[model.jnt_bodyid[index]].add_joint(
            type=mujoco.mjtJoint(model.jnt_type[index]),
            pos=model.jnt_pos[index],
            axis=model.jnt_axis[index],
            ref=model.qpos0[model.jnt_qposadr[index]],
        )
    for index in range(model.nsite):
        bodies[model.site_bodyid[index]].add_site(
            pos=model.site_pos[index], quat=model.site_quat[index], size=[0.01] * 3
        )
    return spec.compile()
