"""Which features to propose for a scene: those in which motions of its arm differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import few_of
from pipeline.replay.features import bind_features
from pipeline.replay.scene import Scene

RADIUS_M = 0.4
REACH = 64  # straight paths between random poses, from all over what the joints reach
SAME = 1e-9  # of a feature's size, within which numbers differ by rounding alone
_SEED = 0

Terms = dict[str, dict[str, object]]


def proposed_features(scene: Scene, objects: Sequence[str], recorded: FloatArray) -> tuple[Terms, list[str]]:
    """Features that differ from motion to motion, and a sentence on those that do not.

    They are efficiency, height, and nearness to each object; the length of the path where but one of these is left,
    as one feature by itself leaves nothing to choose.

    Args:
        scene: with the task's joints and end effector.
        objects: bodies.
        recorded: (N, T, J) demonstrations, rad or m; they are tried beside paths from all over the joints' ranges.
    """
    terms: Terms = {"efficiency": {"kind": "efficiency"}, "height": {"kind": "height"}}
    terms |= {name: {"kind": "proximity", "object": name, "radius_m": RADIUS_M} for name in objects}
    paths = np.concatenate([recorded, _reachable(scene, recorded.shape[1])])
    values = bind_features(scene, terms).evaluate(paths)
    spread, size = np.ptp(values, axis=0), np.abs(values).max(axis=0)
    still = [name for name, varies in zip(terms, spread > SAME * size, strict=True) if not varies]
    terms = {name: term for name, term in terms.items() if name not in still}
    lines = []
    if still:
        one = len(still) == 1
        lines = [
            f"Left out of the features: {few_of(still, 8)}, which {'is' if one else 'are'} the same for all motions of "
            "this arm."
        ]
    if len(terms) == 1:
        terms["path_length"] = {"kind": "path_length"}
    return terms, [f"Features: {', '.join(terms)}; docs/features.md has more kinds.", *lines]


def _reachable(scene: Scene, waypoints: int) -> FloatArray:
    """Straight paths (REACH, T, J) between random poses; joints without a limit within a turn, or 2 m."""
    widest = np.where(scene.slides, 1.0, np.pi)
    lower = np.where(np.isfinite(scene.lower), scene.lower, -widest)
    upper = np.where(np.isfinite(scene.upper), scene.upper, widest)
    ends = np.random.default_rng(_SEED).uniform(lower, upper, (2, REACH, len(lower)))
    share = np.linspace(0, 1, waypoints)[:, None]
    paths: FloatArray = ends[0][:, None] + share * (ends[1] - ends[0])[:, None]
    return paths
