"""Choice models, bandwidth scores and posteriors as their equations read: one loop per sum, exact sums, no arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

Row = Sequence[float]
LogWeights = Callable[[list[Row]], list[float]]


def squared_distance(x: Row, y: Row) -> float:
    return math.fsum((a - b) ** 2 for a, b in zip(x, y, strict=True))


def log_sum_exp(terms: Sequence[float]) -> float:
    peak = max(terms)
    if peak == -math.inf:
        return peak
    return peak + math.log(math.fsum(math.exp(term - peak) for term in terms))


def log_density(rows: Sequence[Row], sigma: float, at: Sequence[Row] | None = None) -> list[float]:
    return [
        log_sum_exp([-squared_distance(x, row) / (2 * sigma**2) for row in rows]) for x in (rows if at is None else at)
    ]


def boltzmann(rows: list[Row]) -> list[float]:
    return [0.0 for _ in rows]


def less(sigma: float) -> LogWeights:
    return lambda rows: [-value for value in log_density(rows, sigma)]


def attribute_rule(rows: list[Row]) -> list[float]:
    return [-math.log(sum(tuple(other) == tuple(row) for other in rows)) for row in rows]


def path_size(lengths: Row) -> LogWeights:
    def log_weights(rows: list[Row]) -> list[float]:
        values = []
        for path in rows:
            links = [a for a, used in enumerate(path) if used]
            whole = math.fsum(lengths[a] for a in links)
            values.append(math.log(math.fsum(lengths[a] / whole / sum(other[a] for other in rows) for a in links)))
        return values

    return log_weights


def log_choice(features: Sequence[Row], log_w: Sequence[float], theta: Row, beta: float) -> list[float]:
    terms = [
        beta * math.fsum(t * f for t, f in zip(theta, phi, strict=True)) + w
        for phi, w in zip(features, log_w, strict=True)
    ]
    # term - log_sum_exp(terms) would round a large sum.
    peak = max(terms)
    rest = log_sum_exp([term - peak for term in terms])
    return [term - peak - rest for term in terms]


def log_likelihood(
    log_weights: LogWeights,
    demonstration: Row | int,
    alternatives: Sequence[Row],
    theta: Row,
    beta: float,
    compared: Sequence[Row] | None = None,
    demonstration_compared: Row | None = None,
) -> float:
    """Of one demonstration; outside the set it joins the set as its last member."""
    rows = list(alternatives if compared is None else compared)
    if isinstance(demonstration, int):
        return log_choice(alternatives, log_weights(rows), theta, beta)[demonstration]
    rows.append(demonstration if demonstration_compared is None else demonstration_compared)
    return log_choice([*alternatives, demonstration], log_weights(rows), theta, beta)[-1]


def log_posterior(
    likelihoods: Sequence[Sequence[Sequence[float]]], log_prior: Sequence[Sequence[float]]
) -> list[list[float]]:
    """(K, B) from (n, K, B)."""
    joint = [
        [prior + math.fsum(one[k][b] for one in likelihoods) for b, prior in enumerate(row)]
        for k, row in enumerate(log_prior)
    ]
    whole = log_sum_exp([value for row in joint for value in row])
    return [[value - whole for value in row] for row in joint]


def predict(
    log_weights: LogWeights,
    alternatives: Sequence[Row],
    thetas: Sequence[Row],
    betas: Row,
    posterior: Sequence[Sequence[float]],
) -> list[float]:
    log_w = log_weights(list(alternatives))
    total = [0.0 for _ in alternatives]
    for k, theta in enumerate(thetas):
        for b, beta in enumerate(betas):
            for i, value in enumerate(log_choice(alternatives, log_w, theta, beta)):
                total[i] += math.exp(posterior[k][b] + value)
    return total


def held_out(likelihoods: Sequence[Sequence[Sequence[float]]], log_prior: Sequence[Sequence[float]]) -> list[float]:
    scores = []
    for left_out, own in enumerate(likelihoods):
        others = log_posterior([one for i, one in enumerate(likelihoods) if i != left_out], log_prior)
        terms = [others[k][b] + value for k, row in enumerate(own) for b, value in enumerate(row)]
        scores.append(log_sum_exp(terms))
    return scores


def leave_one_out_score(rows: Sequence[Row], sigma: float) -> float:
    dimensions = len(rows[0])
    total = []
    for row in rows:
        others = [other for other in rows if tuple(other) != tuple(row)]
        total.append(
            log_density(others, sigma, [row])[0]
            - math.log(len(others))
            - dimensions * math.log(sigma * math.sqrt(2 * math.pi))
        )
    return math.fsum(total)


def literal_score(rows: Sequence[Row], sigma: float) -> float:
    return math.fsum(value - math.log(sigma * math.sqrt(2 * math.pi)) for value in log_density(rows, sigma))
