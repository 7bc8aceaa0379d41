"""What people want as continuous weights omega = beta theta: posteriors, their draws, and groups of people."""

from pipeline.choice.weights.choices import Choices
from pipeline.choice.weights.draws import WeightDraws, weighted_quantiles
from pipeline.choice.weights.hierarchy import GroupDraws, GroupPrior, sample_group
from pipeline.choice.weights.importance import sample_weights
from pipeline.choice.weights.pareto import pareto_smoothed
from pipeline.choice.weights.prior import WeightPrior

__all__ = [
    "Choices",
    "GroupDraws",
    "GroupPrior",
    "WeightDraws",
    "WeightPrior",
    "pareto_smoothed",
    "sample_group",
    "sample_weights",
    "weighted_quantiles",
]
