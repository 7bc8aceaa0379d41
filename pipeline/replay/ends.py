"""How far the ends of a trajectory are from the start and the goal of its scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.replay.replay import body_positions
from pipeline.replay.scene import Scene

TURN = 2 * np.pi


@dataclass(frozen=True)
class Distance:
    """From one configuration of J joints to another.

    Attributes:
        joint: name of the joint that is farthest.
        slides: it slides (m) and does not turn (rad).
        size: how far that is, rad or m; joints without limits are compared within one turn.
        turned_rad, slid_m: the same for the hinges alone and for the slides alone, 0 if there are none.
        end_effector_m: how far the end effector is.
    """

    joint: str
    slides: bool
    size: float
    turned_rad: float
    slid_m: float
    end_effector_m: float

    def __str__(self) -> str:
        """Such as "0.31 rad ('elbow') and 5.2 cm (end effector)"."""
        unit = "m" if self.slides else "rad"
        return f"{self.size:.2g} {unit} ({self.joint!r}) and {100 * self.end_effector_m:.2g} cm (end effector)"


def distances(scene: Scene, configurations: FloatArray, target: FloatArray) -> list[Distance]:
    """From each of (N, J) configurations to the configuration (J,)."""
    apart = np.abs(configurations - target)
    wrapped = np.abs(apart - TURN * np.rint(apart / TURN))
    apart = np.where(scene.continuous, wrapped, apart)
    hands = body_positions(scene, np.vstack([configurations, target])[:, None], [scene.end_effector])
    hand = hands[scene.end_effector][:, 0]
    reach = np.linalg.norm(hand[:-1] - hand[-1], axis=1)
    return [_distance(scene, row, float(one)) for row, one in zip(apart, reach, strict=True)]


def _distance(scene: Scene, apart: FloatArray, end_effector_m: float) -> Distance:
    farthest = int(apart.argmax())
    turned, slid = apart[~scene.slides], apart[scene.slides]
    return Distance(
        scene.joints[farthest],
        bool(scene.slides[farthest]),
        float(apart[farthest]),
        float(turned.max(initial=0.0)),
        float(slid.max(initial=0.0)),
        end_effector_m,
    )
