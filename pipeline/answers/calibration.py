"""Would these demonstrations tell? People are simulated on the user's own alternatives and inferred back.

Truths are drawn from the prior (or given), choices from a model, and the posterior of each model is taken. Where a
model infers what it chose itself, the place of the truth in its posterior is uniform between 0 and 1, whatever the
alternatives: that is simulation-based calibration. Where the pool that people choose from is wider than the
alternatives, or the models differ, the same numbers say what that costs.

Source: Talts, Betancourt, Simpson, Vehtari and Gelman (2018), Validating Bayesian inference algorithms with
simulation-based calibration, arXiv 1804.06788.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.answers.flatness import Flatness, flatness
from pipeline.arrays import FloatArray
from pipeline.choice.explored import Region
from pipeline.choice.metrics import angle_to
from pipeline.choice.models import Model
from pipeline.choice.validation import matrix
from pipeline.choice.weights import Choices, WeightDraws, WeightPrior, sample_weights
from pipeline.choice.weights.held_out import leave_one_out
from pipeline.choice.weights.prior import DEFAULT
from pipeline.errors import ArgumentError

LEVEL = 0.9
BINS, ENOUGH = 10, 50  # bins of a rank histogram, and repetitions that it needs; fewer could hardly show anything
BETA, DIRECTION = "beta", "direction"


@dataclass(frozen=True, eq=False)
class Recovery:
    """What R simulated repetitions came to, people choosing by one model and inferred by another.

    Attributes:
        truth: (R, F) the weights that people had.
        place: (R, F) posterior probability of a smaller weight than the true one, for each weight.
        beta_place: (R,) the same for beta.
        direction_place: (R,) posterior probability of a direction nearer to the mean one than the true one.
        angle: (R,) rad, between the mean direction and the true one.
        cap: (R,) rad, within which the direction lies with probability 0.9, as the posterior says.
        width: (R, F) of the central 0.9 interval of each weight.
        log_evidence: (R,) of the inferring model.
        held_out: (R,) mean held-out log score of a demonstration; NaN for a single one, and where one model alone is
            tried.
        pareto_k: (R,) of the draws.
    """

    truth: FloatArray
    place: FloatArray
    beta_place: FloatArray
    direction_place: FloatArray
    angle: FloatArray
    cap: FloatArray
    width: FloatArray
    log_evidence: FloatArray
    held_out: FloatArray
    pareto_k: FloatArray

    def coverage(self, level: float = LEVEL) -> float:
        """How often the truth was among the `level` nearest directions."""
        return float((self.direction_place <= level).mean())


@dataclass(frozen=True, eq=False)
class Comparison:
    """Whether demonstrations tell two models apart.

    Attributes:
        log_bayes_factor: (R,) log evidence of the model that people chose by, less that of the other.
        held_out: (R,) the same difference in mean held-out score.
    """

    log_bayes_factor: FloatArray
    held_out: FloatArray

    @property
    def favoured(self) -> float:
        """How often the evidence is on the side of the model that people chose by."""
        return float((self.log_bayes_factor > 0).mean())

    def told(self, odds: float = 10.0) -> float:
        """How often it is so by at least these odds."""
        return float((self.log_bayes_factor > np.log(odds)).mean())

    def misled(self, odds: float = 10.0) -> float:
        """How often the other model is favoured by at least these odds."""
        return float((self.log_bayes_factor < -np.log(odds)).mean())


@dataclass(frozen=True, eq=False)
class Calibration:
    """Every pair of a model that people choose by and one that infers.

    Attributes:
        recoveries: by (chosen by, inferred by).
    """

    recoveries: dict[tuple[str, str], Recovery]

    def comparison(self, chosen_by: str, other: str) -> Comparison:
        """Whether people who choose by the one are told from those of the other."""
        own, wrong = self.recoveries[chosen_by, chosen_by], self.recoveries[chosen_by, other]
        return Comparison(own.log_evidence - wrong.log_evidence, own.held_out - wrong.held_out)

    def rank_histograms(self, features: Sequence[str]) -> dict[tuple[str, str], Flatness]:
        """Where the truth falls in its posterior, if a model infers what it chose itself.

        They are flat if the inference is right, and the truths were drawn from its prior.

        Args:
            features: (F,) names of the weights.

        Returns:
            By model and by what is placed: a feature's weight, `BETA` or `DIRECTION`. Empty with fewer repetitions
            than `ENOUGH`.
        """
        own = {chosen_by: one for (chosen_by, other), one in self.recoveries.items() if chosen_by == other}
        found = {}
        for label, one in own.items():
            if len(one.angle) < ENOUGH:
                return {}
            places = [*one.place.T, one.beta_place, one.direction_place]
            for name, column in zip((*features, BETA, DIRECTION), places, strict=True):
                found[label, name] = flatness(column, BINS, len(own) * len(places))
        return found


def calibrate(
    rng: np.random.Generator,
    models: dict[str, Model],
    alternatives: ArrayLike,
    demonstrations: int,
    repetitions: int,
    prior: WeightPrior = DEFAULT,
    truths: ArrayLike | None = None,
    pool: ArrayLike | None = None,
    count: int = 1024,
    tracked: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> Calibration:
    """Simulate people on these alternatives under each model, and infer them under each.

    Args:
        rng: random stream.
        models: by label.
        alternatives: (N, F) scaled features that inference knows of.
        demonstrations: n, of each repetition.
        repetitions: R for each model.
        prior: of inference, from which the truths are drawn.
        truths: (R, F) weights that people have, if not drawn from the prior, e.g. draws of a posterior.
        pool: (M, F) what people choose from if not the alternatives; each of their choices joins these.
        count: draws of each posterior.
        tracked: goes through the repetitions, and may show how far it is.

    Raises:
        ArgumentError: an argument is out of range.
    """
    rows = matrix("alternatives", alternatives)
    options = rows if pool is None else matrix("pool", pool, columns=rows.shape[1])
    if demonstrations < 1 or repetitions < 1:
        raise ArgumentError(f"demonstrations is {demonstrations} and repetitions {repetitions}; both must be >= 1.")
    given = None if truths is None else matrix("truths", truths, columns=rows.shape[1])
    found: dict[tuple[str, str], list[_One]] = {}
    weights = {label: model.weigh(rows) for label, model in models.items()}
    option_log_w = {label: model.weigh(options).log_w for label, model in models.items()}
    for number in tracked(range(len(models) * repetitions)):
        label, repetition = list(models)[number // repetitions], number % repetitions
        truth = prior.draw(rng, 1, rows.shape[1])[0] if given is None else given[repetition % len(given)]
        chosen = choose(rng, truth, options, option_log_w[label], demonstrations)
        for other, weighing in weights.items():
            if pool is None:
                choices = Choices(rows, weighing.log_w, rows[chosen], weighing.log_w[chosen])
            else:
                choices = Choices.joining(weighing, options[chosen], rows)
            draws = sample_weights(rng, choices, prior, count)
            one = _One.of(draws, choices, truth, with_score=len(models) > 1)
            found.setdefault((label, other), []).append(one)
    return Calibration({pair: _together(some) for pair, some in found.items()})


def recover(
    rng: np.random.Generator,
    truths: FloatArray,
    options: Region,
    infer: Callable[[FloatArray], Choices],
    demonstrations: int,
    prior: WeightPrior = DEFAULT,
    draws: int = 1024,
) -> Recovery:
    """Simulate people who choose from an explored choice space, and infer them back.

    Args:
        rng: random stream.
        truths: (R, F) the weights that people have, one after another.
        options: what they choose from.
        infer: from features (n, F) of what was chosen to choices; it may know of another exploration.
        demonstrations: n, of each person.
        prior: of inference.
        draws: of each posterior.
    """
    found = []
    for truth in truths:
        rows = choose(rng, truth, options.features, options.log_w, demonstrations)
        choices = infer(options.features[rows])
        found.append(_One.of(sample_weights(rng, choices, prior, draws), choices, truth, with_score=False))
    return _together(found)


def choose(
    rng: np.random.Generator, omega: FloatArray, alternatives: FloatArray, log_w: FloatArray, count: int
) -> np.ndarray:
    """(count,) rows chosen independently with probabilities softmax(omega . phi + log_w)."""
    utility = alternatives @ omega + log_w
    p = np.exp(utility - utility.max())
    return np.asarray(rng.choice(len(p), size=count, p=p / p.sum()))


@dataclass(frozen=True, eq=False)
class _One:
    """One repetition; names as in `Recovery`."""

    truth: FloatArray
    place: FloatArray
    beta_place: float
    direction_place: float
    angle: float
    cap: float
    width: FloatArray
    log_evidence: float
    held_out: float
    pareto_k: float

    @classmethod
    def of(cls, draws: WeightDraws, choices: Choices, truth: FloatArray, with_score: bool) -> _One:
        interval, held_out = draws.interval(LEVEL), np.nan
        if with_score and choices.count > 1:
            held_out = leave_one_out(draws, choices.log_likelihood(draws.omega)).score.mean
        return cls(
            truth,
            draws.weight @ (draws.omega < truth),
            float(draws.weight @ (draws.beta < np.linalg.norm(truth))),
            draws.within(truth),
            angle_to(draws.direction, truth),
            draws.cap(LEVEL),
            interval[:, 1] - interval[:, 0],
            draws.log_evidence,
            held_out,
            draws.pareto_k,
        )


def _together(some: list[_One]) -> Recovery:
    names = Recovery.__dataclass_fields__
    return Recovery(**{name: np.array([getattr(one, name) for one in some]) for name in names})
