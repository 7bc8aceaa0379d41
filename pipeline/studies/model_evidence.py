"""How much choices tell two models apart, and how many more people would.

The control trial leaves the groups' rewards uncertain. So a model's evidence for the experimental trial is its
likelihood averaged over the shares that the control trial allows, a Dirichlet distribution with the counts plus one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice import LESS, Boltzmann
from pipeline.errors import ArgumentError
from pipeline.studies.human_choice import HumanChoiceStudy

_DRAWS = 200_000  # of shares: the error of a log evidence is below 0.01 where it matters, see the test
_SEED = 0
MOST_PEOPLE = 1_000_000


@dataclass(frozen=True)
class Evidence:
    """What the experimental trial says about the models.

    Attributes:
        log_evidence: by model, nats; multinomial coefficients left out, as they are the same for all.
        posterior: by model, with equal prior probabilities.
        more_people: by model, how many further people in the experimental trial would make a chi-square test reject
            the other models' predictions with the power asked for, if this model is right; 0 if as many took part
            already, None if the predictions are equal or more than a million would be needed.
    """

    log_evidence: dict[str, float]
    posterior: dict[str, float]
    more_people: dict[str, int | None]


def evidence(study: HumanChoiceStudy, alpha: float = 0.05, power: float = 0.8) -> Evidence:
    """Compare the models on the options of the experimental trial.

    Args:
        study: of at least two groups.
        alpha: level of the test that people are counted for.
        power: probability with which it is to reject a wrong model.

    Raises:
        ArgumentError: alpha or power is not between 0 and 1.
    """
    for name, value in (("alpha", alpha), ("power", power)):
        if not 0 < value < 1:
            raise ArgumentError(f"{name} is {value}; it must lie between 0 and 1")
    options = study.predictions.filter(pl.col("comparison") == "options")
    groups = study.control["group"].to_list()
    models = options["model"].unique(maintain_order=True).to_list()
    rows = {model: options.filter(pl.col("model") == model) for model in models}
    first = rows[models[0]]
    counts = first["count"].to_numpy().astype(float)
    member = np.array([groups.index(group) for group in first["group"]])
    shares = np.random.default_rng(_SEED).dirichlet(study.control["count"].to_numpy() + 1.0, _DRAWS)
    log_evidence = {
        model: _log_mean(np.log(_predicted(model, shares, member)) @ counts) for model in models
    }  # fmt: skip
    top = max(log_evidence.values())
    total = sum(math.exp(value - top) for value in log_evidence.values())
    predicted = {model: rows[model]["predicted"].to_numpy() for model in models}
    return Evidence(
        log_evidence,
        {model: math.exp(value - top) / total for model, value in log_evidence.items()},
        {model: _more(model, predicted, int(counts.sum()), alpha, power) for model in models},
    )


def with_uncertain_control(study: HumanChoiceStudy) -> pl.DataFrame:
    """The study's tests, with what they become when the control trial's shares are estimates, as they are.

    The paper's chi-square takes the control trial's shares as known. The likelihood ratio test estimates them from both
    trials together: G^2 = 2 (log L of each trial's own shares - log L of the model's best shares), chi-square with as
    many degrees of freedom as the experimental trial has (Wilks 1938).

    Returns:
        The table `tests` with `likelihood_ratio` (G^2), `p_uncertain_control`, and `log_bayes_factor`: the log of how
        many times more probable the choices are under the model than under Boltzmann (see `evidence`).
    """
    from scipy.stats import chi2

    control = study.control["count"].to_numpy().astype(float)
    groups, rows = study.control["group"].to_list(), []
    for row in study.tests.iter_rows(named=True):
        cells = study.predictions.filter(comparison=row["comparison"], model=row["model"])
        counts = cells["count"].to_numpy().astype(float)
        options = study.predictions.filter(comparison="options", model=row["model"])["group"]
        sizes = np.array([int((options == group).sum()) for group in groups])
        member = np.array([groups.index(group) for group in cells["group"]])
        weight = np.ones(len(member))
        if row["comparison"] == "groups" and row["model"] != LESS.name:
            weight = sizes[member].astype(float)
        elif row["comparison"] == "options" and row["model"] == LESS.name:
            weight = 1.0 / sizes[member]
        ratio = _likelihood_ratio(control, counts, member, weight)
        rows.append({"likelihood_ratio": ratio, "p_uncertain_control": float(chi2.sf(ratio, len(counts) - 1))})
    added = pl.DataFrame(rows)
    found = evidence(study).log_evidence
    factors = [found[model] - found[Boltzmann.name] for model in study.tests["model"]]
    return study.tests.with_columns(added["likelihood_ratio"], added["p_uncertain_control"]).with_columns(
        log_bayes_factor=pl.Series(factors)
    )


def _likelihood_ratio(control: FloatArray, counts: FloatArray, member: IndexArray, weight: FloatArray) -> float:
    """G^2 of experimental counts whose probabilities are weight * share of the member's group, up to their sum."""
    from scipy.optimize import minimize
    from scipy.special import xlogy

    def negative(logits: FloatArray) -> float:
        log_shares = logits - np.logaddexp.reduce(logits)
        log_p = np.log(weight) + log_shares[member]
        return float(-(control @ log_shares + counts @ (log_p - np.logaddexp.reduce(log_p))))

    start = np.log(control + 0.5)
    best = minimize(negative, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 20_000})
    own = float(xlogy(control, control / control.sum()).sum() + xlogy(counts, counts / counts.sum()).sum())
    return max(0.0, 2 * (own + float(best.fun)))


def people_needed(truth: FloatArray, other: FloatArray, alpha: float, power: float) -> int | None:
    """How many choices make a chi-square test reject `other` with this power if they follow `truth`.

    From the noncentral chi-square distribution with noncentrality n sum (truth - other)^2 / other (Cohen 1988,
    Statistical power analysis for the behavioral sciences, chapter 7).

    Returns:
        The least such n; None if it is above a million, or the two are equal.
    """
    from scipy.stats import chi2, ncx2

    effect = float(((truth - other) ** 2 / other).sum())
    degrees = len(truth) - 1
    critical = float(chi2.isf(alpha, degrees))

    def enough(n: int) -> bool:
        return bool(ncx2.sf(critical, degrees, n * effect) >= power)

    if effect <= 0 or not enough(MOST_PEOPLE):
        return None
    low, high = 0, MOST_PEOPLE
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def _predicted(model: str, shares: FloatArray, member: IndexArray) -> FloatArray:
    """(D, options) predictions of a model for draws of the groups' shares."""
    options_of = np.bincount(member)
    p = shares[:, member] / (options_of[member] if model == LESS.name else 1)
    probabilities: FloatArray = p / p.sum(axis=1, keepdims=True)
    return probabilities


def _log_mean(values: FloatArray) -> float:
    top = float(values.max())
    return top + math.log(float(np.exp(values - top).mean()))


def _more(model: str, predicted: dict[str, FloatArray], done: int, alpha: float, power: float) -> int | None:
    needed = [people_needed(predicted[model], p, alpha, power) for name, p in predicted.items() if name != model]
    known = [n for n in needed if n is not None]
    return max(0, max(known) - done) if len(known) == len(needed) else None
