"""Five ways to come by alternatives, side by side: how much answers differ, how right they are, and what they cost.

The sets of the robustness study come from one sampler or from different ones. Here two cures stand beside them. In
`with-optima` each set of a different sampler gets planned paths: for every theta a few of the best that a short search
finds. In `explored` there is no set at all: each answer rests on an exploration of the choice space that began from
another sampler's trajectories.

How right they are is asked of simulated people. They choose from what one exploration covered, so their choices do not
come from the sampler whose set judges them, and the prior is that of inference. Then a credible set that says 90 % has
to hold the truth in 90 % of cases, if what it rests on is enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray, IntArray
from pipeline.choice import LESS, Boltzmann, angle_to, log_likelihood, select_bandwidth
from pipeline.choice.explored import region_log_likelihood
from pipeline.choice.logspace import log_sum_exp
from pipeline.studies.robustness.divergence import measures
from pipeline.studies.robustness.problem import Problem, log_posteriors, theta_marginals
from pipeline.studies.robustness.tests import median_interval
from pipeline.vocabulary import ALL, BATCH, BOLTZMANN, SINGLE

LEVEL = 0.9
MOST_THETAS = 24  # that simulated people have; of more, those furthest from one another


@dataclass(frozen=True, eq=False)
class SimulatedPeople:
    """P people, each of whom makes C choices with weights from the prior.

    Attributes:
        theta: (P,) number of each one's theta.
        beta: (P,) their inverse temperatures.
        choices: (P, C, F) scaled features.
    """

    theta: IntArray
    beta: FloatArray
    choices: FloatArray


def simulate_people(
    rng: np.random.Generator,
    features: FloatArray,
    log_w: FloatArray,
    thetas: FloatArray,
    betas: FloatArray,
    which: IntArray,
    repetitions: int,
    count: int,
) -> SimulatedPeople:
    """People who choose from the rows that stand for a space, independently.

    Args:
        rng: random stream.
        features: (N, F) scaled features of the rows.
        log_w: (N,) their log weights under a model.
        thetas: (K, F) all hypotheses.
        betas: (B,) inverse temperatures.
        which: numbers of the thetas that people have.
        repetitions: people for each theta and beta.
        count: C choices of each.
    """
    theta, beta, chosen = [], [], []
    for k in which.tolist():
        for inverse_temperature in betas.tolist():
            log_p = inverse_temperature * features @ thetas[k] + log_w
            p = np.exp(log_p - log_sum_exp(log_p))
            rows = rng.choice(len(features), size=(repetitions, count), p=p / p.sum())
            chosen.append(features[rows])
            theta += [k] * repetitions
            beta += [inverse_temperature] * repetitions
    return SimulatedPeople(np.array(theta), np.array(beta), np.concatenate(chosen))


def judged_by_set(
    model: str, people: SimulatedPeople, alternatives: FloatArray, bandwidth: str | float, thetas: FloatArray,
    betas: FloatArray,
) -> FloatArray:  # fmt: skip
    """(P, C, K, B) log likelihoods of choices that join a sampled set one by one.

    Raises:
        BandwidthError: the set has fewer than two distinct rows.
    """
    of = Boltzmann() if model == BOLTZMANN else LESS(select_bandwidth(alternatives, bandwidth).value)
    flat = people.choices.reshape(-1, people.choices.shape[2])
    values = log_likelihood(of, flat, alternatives, thetas, betas)
    return values.reshape(*people.choices.shape[:2], *values.shape[1:])


def judged_by_space(
    people: SimulatedPeople, features: FloatArray, log_w: FloatArray, thetas: FloatArray, betas: FloatArray
) -> FloatArray:
    """(P, C, K, B) log likelihoods of choices among all that an exploration covered."""
    flat = people.choices.reshape(-1, people.choices.shape[2])
    values = region_log_likelihood(flat, features, log_w, thetas, betas)
    return values.reshape(*people.choices.shape[:2], *values.shape[1:])


def recovered(
    rng: np.random.Generator, people: SimulatedPeople, likelihoods: FloatArray, thetas: FloatArray
) -> pl.DataFrame:
    """How well one choice, and all choices of a person together, tell what the person wants.

    Args:
        rng: random stream, for the randomised credible set.
        people: who chose.
        likelihoods: (P, C, K, B).
        thetas: (K, F).

    Returns:
        For each number of `choices` and `true_beta`: `repetitions`; `covered`, how often the smallest credible set of
        probability 0.9 holds the truth; `covered_randomised`, the same if of the last hypothesis to enter only the part
        counts that is needed, which is 0.9 exactly where inference is right; means of `true_posterior`, `true_match`
        (is the most probable theta the true one?) and `map_angle_rad`; `learned` (nats, from the prior).
    """
    angles = np.array([[angle_to(a, b) for b in thetas] for a in thetas])
    parts = []
    for count in sorted({1, people.choices.shape[1]}):
        joint = likelihoods.reshape(-1, 1, *likelihoods.shape[2:]) if count == 1 else likelihoods
        repeat = len(joint) // len(people.theta)
        theta, beta = people.theta.repeat(repeat), people.beta.repeat(repeat)
        log_p = theta_marginals(log_posteriors(joint.sum(axis=1)[None]))[0, :-1]
        p = np.exp(log_p)
        true = p[np.arange(len(p)), theta]
        before = np.where(p > true[:, None], p, 0.0).sum(axis=1)  # probability of what is more probable than the truth
        best = p.argmax(axis=1)
        learned = np.log(len(thetas)) + np.where(p > 0, p * log_p, 0.0).sum(axis=1)
        parts.append(
            pl.DataFrame(
                {
                    "true_beta": beta,
                    "covered": before < LEVEL,
                    "covered_randomised": before + rng.random(len(p)) * true < LEVEL,
                    "true_posterior": true,
                    "true_match": best == theta,
                    "map_angle_rad": angles[theta, best],
                    "learned": learned,
                }
            )
            .group_by("true_beta", maintain_order=True)
            .agg(pl.len().cast(pl.Int64).alias("repetitions"), pl.all().cast(pl.Float64).mean())
            .select(pl.lit(count, pl.Int64).alias("choices"), pl.all())
        )
    return pl.concat(parts)


def measured(
    problem: Problem, log_marginals: FloatArray, regime: str, model: str, set_size: int, looked_at: int
) -> pl.DataFrame:
    """Rows of the table `regimes`: robustness and accuracy of the posteriors from R samplings or explorations.

    Args:
        problem: demonstrations and hypotheses.
        log_marginals: (R, n + 1, K) log posteriors over theta, all demonstrations together last.
        regime, model: columns of the table.
        set_size: how many alternatives a set has; 0 where there is no set.
        looked_at: trajectories that one posterior has cost.
    """
    rows = measures(log_marginals, problem.demonstrations, problem.truth_angles)
    about = (pl.lit(regime).alias("regime"), pl.lit(model).alias("model"), pl.lit(set_size, pl.Int64).alias("set_size"))
    return with_costs(rows.select(*about, pl.all()), len(problem.thetas), pl.lit(looked_at))


def with_costs(rows: pl.DataFrame, thetas: int, looked_at: pl.Expr) -> pl.DataFrame:
    """Rows with the columns of `measures`, and with `learned` (nats, from a uniform prior) and `trajectories`."""
    learned = (np.log(thetas) - pl.col("entropy")).clip(0.0)
    return rows.with_columns(learned=learned, trajectories=looked_at.cast(pl.Int64))


def summarised(rows: pl.DataFrame) -> pl.DataFrame:
    """Rows of the table `regimes_summary`, from those of `regimes`.

    KLAggregate is put on the scale of ten samplings, 90 times the mean of an ordered pair, so that regimes of other
    numbers compare. `value` is the median over participants with its interval, `largest` the largest of them.
    """
    by = ["regime", "model", "set_size"]
    scaled = rows.with_columns(ten=90.0 * pl.col("kl_mean"))
    means = [pl.col(name).mean() for name in ("learned", "true_posterior", "map_angle_rad")]
    people = (
        scaled.filter(pl.col("demonstration_id") != ALL)
        .group_by(*by, "participant", maintain_order=True)
        .agg(pl.col("ten").mean(), pl.col("trajectories").first(), *means)
    )
    found = []
    for key, group in people.group_by(by, maintain_order=True):
        values = group["ten"].to_numpy()
        low, high = median_interval(values) or (None, None)
        numbers = {"value": float(np.median(values)), "low": low, "high": high, "largest": float(values.max())}
        others = {name: group[name].mean() for name in ("learned", "true_posterior", "map_angle_rad")}
        labels = {"demonstrations": SINGLE, "participants": len(values), "trajectories": group["trajectories"][0]}
        found.append(dict(zip(by, key, strict=True)) | labels | numbers | others)
    for row in scaled.filter(demonstration_id=ALL).iter_rows(named=True):
        numbers = {"value": row["ten"], "low": None, "high": None, "largest": row["ten"]}
        others = {name: row[name] for name in ("learned", "true_posterior", "map_angle_rad")}
        labels = {"demonstrations": BATCH, "participants": 1, "trajectories": row["trajectories"]}
        found.append({name: row[name] for name in by} | labels | numbers | others)
    floats = ("value", "low", "high", "largest", "learned", "true_posterior", "map_angle_rad")
    whole = ("set_size", "participants", "trajectories")
    overrides = {**dict.fromkeys(floats, pl.Float64), **dict.fromkeys(whole, pl.Int64)}
    return pl.DataFrame(found, schema_overrides=overrides).sort(
        "demonstrations", "regime", "model", "set_size", descending=[True, False, False, False]
    )


def pooled_recovery(parts: list[pl.DataFrame]) -> pl.DataFrame:
    """Rows of the table `regimes_calibration`: means over the sets or explorations that judged."""
    by = ["regime", "model", "set_size", "choices", "true_beta"]
    numbers = ("covered", "covered_randomised", "true_posterior", "true_match", "map_angle_rad", "learned")
    weighted = [((pl.col(name) * pl.col("repetitions")).sum() / pl.col("repetitions").sum()) for name in numbers]
    found = (
        pl.concat(parts)
        .group_by(by, maintain_order=True)
        .agg(
            pl.len().cast(pl.Int64).alias("sets"),
            pl.col("covered").std().alias("covered_sd"),
            *[one.alias(name) for one, name in zip(weighted, numbers, strict=True)],
            pl.col("repetitions").sum().alias("total"),
        )
    )
    return found.rename({"total": "repetitions"}).select(*by, "sets", "repetitions", *numbers, "covered_sd").sort(by)
