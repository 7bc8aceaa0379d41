"""A small project of another kind: a planar arm of two hinges on a slide, its own features, its own recordings."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from pipeline.formats.mcap.joint_states import write_joint_states
from pipeline.workspace.project import Project

GANTRY = """
<mujoco model="gantry">
  <compiler angle="radian"/>
  <worldbody>
    <site name="floor" type="box" size="2 2 0.01" pos="0 0 -0.5"/>
    <body name="vase" pos="0.4 0.3 0"><geom type="sphere" size="0.05"/></body>
    <body name="carriage">
      <joint name="rail" type="slide" axis="1 0 0" range="-1 1" limited="true"/>
      <geom type="box" size="0.1 0.05 0.05"/>
      <body name="upper">
        <joint name="swing" type="hinge" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03"/>
        <body name="fore" pos="0.4 0 0">
          <joint name="bend" type="hinge" axis="0 1 0" range="-2 2" limited="true"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
          <body name="tip" pos="0.3 0 0"><geom type="sphere" size="0.03"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <keyframe>
    <key name="start" qpos="-0.3 -0.6 0.1"/>
    <key name="goal" qpos="0.3 0.9 -0.2"/>
  </keyframe>
</mujoco>
"""
PARAMETERS: dict[str, Any] = {
    "seed": 7,
    "tasks": {
        "sweep": {
            "scene": "gantry.xml",
            "end_effector": "tip",
            "surface": "floor",
            "collisions": False,
            "recordings": "mine",
            "anchor": "task",
            "features": {
                "effort": {"kind": "efficiency"},
                "vase": {"kind": "proximity", "object": "vase", "radius_m": 0.5},
            },
            "preferences": {"effort": {"kind": "efficiency"}, "lift": {"kind": "height"}},
            "thetas": "grid",
        }
    },
    "simulate": {
        "participants": 3, "spread_rad": 0.1, "skill": [0.5, 0.9], "topic": "/joint_states",
        "extra_joints": ["gripper"], "weights": {"sweep": {"effort": 1.0, "lift": 0.5}},
    },
    "ingest": {"waypoints": 15, "idle_rad": 0.01, "on_rejected": "stop"},
    "sample": {
        "sizes": [5, 20], "sets": 2, "working_set": 30, "sampler": "mixture", "given": None,
        "deformation": {"width_rad": 0.2, "modes": 4}, "via-point": {"reach_rad": 0.4},
        "planner": {"paths": 3, "width_rad": 0.05},
    },
    "compute": {"partition": 50_000, "memory_gb": 1},
    "features": {"scale": "range"},
    "density": {"bandwidth": "leave-one-out"},
    "studies": {
        "human_choice": {"choices": "choices.csv", "options": None, "alpha": 0.05, "compare_with_paper": False},
        "grid_world": {
            "size": 4, "objects": [[0, 3], [3, 0]], "beta": 5.0, "demonstrations": 3, "seeds": 4,
        },
    },
    "infer": {"models": ["boltzmann", "less"], "theta_values": [0, 0.5, 1], "betas": [0.3, 3, 30]},
    "explore": {
        "explorations": 2, "evaluations": 2000, "most_evaluations": 4000, "tolerance": 0.02, "effort_multiple": None,
        "width_rad": None, "modes": 4, "largest_step": None, "cell": None,
    },
    "robustness": {
        "samplers": {
            "near": {"kind": "deformation", "width_rad": 0.1}, "far": {"kind": "deformation", "width_rad": 0.3},
            "both": {"kind": "mixture", "of": ["near", "far"]}, "via": {"kind": "via-point", "reach_rad": 0.4},
            "planned": {"kind": "planner", "paths": 2},
        },
        "duplicates": {"set_size": 20, "copied": 2, "copies": [1, 4], "spreads": [0, 0.05]},
        "bandwidth_factors": [0.5, 1],
    },
}  # fmt: skip


@pytest.fixture
def parameters() -> dict[str, Any]:
    """Parameters of the small project, to be changed at will."""
    return deepcopy(PARAMETERS)


@pytest.fixture
def make_project(tmp_path: Path) -> Callable[[dict[str, Any]], Project]:
    """Write a project with the given parameters, the gantry's scene and three good recordings."""

    def make(parameters: dict[str, Any]) -> Project:
        root = tmp_path / "project"
        root.mkdir(exist_ok=True)
        (root / "gantry.xml").write_text(GANTRY)
        with (root / "params.yaml").open("w") as stream:
            YAML(typ="safe", pure=True).dump(parameters, stream)
        for number in range(3):
            record(root / "mine" / f"demo-{number}.mcap", bow=0.1 * number)
        return Project(root)

    return make


def record(
    path: Path,
    bow: float = 0.0,
    names: tuple[str, ...] = ("bend", "gripper", "rail", "swing"),
    start: tuple[float, float, float] = (-0.3, -0.6, 0.1),
    goal: tuple[float, float, float] = (0.3, 0.9, -0.2),
    participant: str | None = None,
) -> None:
    """A recording at 100 Hz, by default from the scene's start to its goal, joints in an order of their own, idle at
    both ends; `start` and `goal` give rail, swing and bend.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    s = np.clip(np.linspace(-0.2, 1.2, 280), 0, 1)[:, None]
    pose = np.array(start) + s * (np.array(goal) - np.array(start)) + bow * np.sin(np.pi * s)
    columns = {"rail": pose[:, 0], "swing": pose[:, 1] + 2 * np.pi, "bend": pose[:, 2], "gripper": 0 * pose[:, 0]}
    positions = np.stack([columns.get(name, columns["gripper"]) for name in names], axis=1)
    time_ns = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(280)
    about = {"demonstration": {"participant": participant or path.stem.replace("demo", "person")}}
    write_joint_states(path, time_ns, names, positions, topic="/arm/joints", metadata=about)
