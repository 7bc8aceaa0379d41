"""MuJoCo: scenes and name lookup, batched kinematic replay, the features of a trajectory."""

from pipeline.replay.features import FeatureSet, bind_features, feature
from pipeline.replay.mechanism.limits import Limits, judge_positions
from pipeline.replay.replay import Motion, body_positions, replay
from pipeline.replay.scene import Scene, load_scene, model_hash, scene_files
from pipeline.replay.surface import clear_of

__all__ = [
    "FeatureSet",
    "Limits",
    "Motion",
    "Scene",
    "bind_features",
    "body_positions",
    "clear_of",
    "feature",
    "judge_positions",
    "load_scene",
    "model_hash",
    "replay",
    "scene_files",
]
