"""The weights of a model from choices among drawn paths, and how well it predicts choices."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.choice.conditional_logit import ChoiceSets
from pipeline.choice.nested_choice_sets import NestedChoiceSets
from pipeline.studies.trips.choices import Drawn
from pipeline.studies.trips.path_models import NESTED


class Estimator:
    """A model of choice on the sets of one sampler.

    Its parameters are the weights of the features, and after them the coefficient of its own feature or the
    dissimilarity of its nests, if it has one.
    """

    def __init__(self, drawn: Drawn, model: str) -> None:
        self._sets: ChoiceSets | NestedChoiceSets = drawn.nested(model) if model in NESTED else drawn.sets(model)
        self._log_w = drawn.log_weights(model)

    def fit(self, counts: FloatArray | None = None, start: FloatArray | None = None) -> FloatArray:
        """The parameters of the greatest likelihood.

        Args:
            counts: (n,) how often each trip counts; once if not given.
            start: parameters to begin at.

        Raises:
            ArgumentError: the search does not come to an end.
        """
        if isinstance(self._sets, ChoiceSets):
            return self._sets.estimate(self._log_w, counts, start)
        weights, dissimilarity = self._sets.estimate(self._log_w, counts, start)
        return np.append(weights, dissimilarity)

    def log_p(self, parameters: FloatArray) -> FloatArray:
        """(n,) log probability of the path taken among those of its set."""
        if isinstance(self._sets, ChoiceSets):
            return self._sets.log_probabilities(parameters, self._log_w)[self._sets.chosen]
        return self._sets.log_probabilities(parameters[:-1], float(parameters[-1]), self._log_w)

    def held_out(self, parameters: list[FloatArray], folds: list[BoolArray]) -> FloatArray:
        """(n,) log probability of the path taken, for each trip under the parameters of the fold that leaves it out."""
        scores = np.empty(len(folds[0]))
        for part, held in zip(parameters, folds, strict=True):
            scores[held] = self.log_p(part)[held]
        return scores
