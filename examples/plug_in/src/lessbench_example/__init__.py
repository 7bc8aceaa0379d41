"""A feature, a model of choice and a sampler of one's own; docs/plug-ins.md explains them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from pipeline.choice import LESS, ChoiceModel, WeightedSet
from pipeline.replay import Motion, feature


@feature("sharpest_turn", unit="rad", direction="cost", over_time="greatest")
def sharpest_turn(motion: Motion) -> np.ndarray:
    """Greatest angle between one step of the end effector and the next."""
    steps = np.diff(motion.end_effector, axis=1)
    lengths = np.linalg.norm(steps, axis=2)
    products = np.maximum(lengths[:, 1:] * lengths[:, :-1], 1e-12)
    cosine = np.einsum("ntd,ntd->nt", steps[:, 1:], steps[:, :-1]) / products
    return np.arccos(np.clip(cosine, -1, 1)).max(axis=1)


@dataclass(frozen=True)
class HalfLess(ChoiceModel):
    """Half way between Boltzmann and LESS: log weights are half of those of LESS."""

    bandwidth: str | float = "leave-one-out"
    name: ClassVar[str] = "half-less"

    @classmethod
    def with_bandwidth(cls, bandwidth: str | float) -> Self:
        """The model with the bandwidth that `density.bandwidth` in params.yaml asks for."""
        return cls(bandwidth)

    def weigh(self, compared: Any) -> WeightedSet:
        """Half of the log weights of LESS, also when a demonstration joins the set."""
        less = LESS(self.bandwidth).weigh(compared)

        def joined(row: Any) -> tuple[np.ndarray, float]:
            log_w, own = less.joined(row)
            return log_w / 2, own / 2

        return WeightedSet(less.log_w / 2, joined)


@dataclass(frozen=True)
class Arcs:
    """Straight joint paths, bent sideways into half a sine wave of random height."""

    height_rad: float = 0.5

    def sample(self, rng: np.random.Generator, anchor: Any, count: int, n_waypoints: int) -> np.ndarray:
        """Draw (count, n_waypoints, joints) paths from anchor.start to anchor.goal."""
        s = np.linspace(0.0, 1.0, n_waypoints)[None, :, None]
        straight = (1 - s) * anchor.start + s * anchor.goal
        heights = rng.normal(scale=self.height_rad, size=(count, 1, anchor.start.size))
        return straight + heights * np.sin(np.pi * s) * (s < 1)
