"""Models of choice over a finite set of trajectories, and inference of what the chooser wanted.

Arrays are float64 and features are already scaled; every error derives from `pipeline.errors.WorkbenchError`.
"""

from pipeline.choice.held_out import HeldOutScore, compare_held_out, held_out_from, held_out_score
from pipeline.choice.hypotheses import theta_grid
from pipeline.choice.inference import Posterior, infer, infer_sequential, posterior_from, predict
from pipeline.choice.kernel.bandwidth import Bandwidth, BandwidthWarning, select_bandwidth
from pipeline.choice.kernel.cost_model import EngineChoice
from pipeline.choice.kernel.density import choose_engine, log_density
from pipeline.choice.likelihood import log_likelihood, log_probabilities
from pipeline.choice.metrics import angle_to, entropy, kl_aggregate, true_match, true_posterior
from pipeline.choice.models import LESS, AttributeRule, Boltzmann, ChoiceModel, Model, PathSize, WeightedSet

__all__ = [
    "AttributeRule",
    "Bandwidth",
    "BandwidthWarning",
    "Boltzmann",
    "ChoiceModel",
    "EngineChoice",
    "Model",
    "HeldOutScore",
    "LESS",
    "PathSize",
    "Posterior",
    "WeightedSet",
    "angle_to",
    "choose_engine",
    "compare_held_out",
    "entropy",
    "held_out_from",
    "held_out_score",
    "infer",
    "infer_sequential",
    "kl_aggregate",
    "log_density",
    "log_likelihood",
    "log_probabilities",
    "posterior_from",
    "predict",
    "select_bandwidth",
    "theta_grid",
    "true_match",
    "true_posterior",
]
