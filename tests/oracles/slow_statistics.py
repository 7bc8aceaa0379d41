"""Slow, obvious versions of the statistics: loops over every subject and cell, written from the definitions."""

from __future__ import annotations

from math import sqrt
from statistics import NormalDist, fmean


def wellek(alpha: float, n: int, k: int, epsilon: float, x: list[int], p0: list[float]) -> dict[str, float]:
    """The published program of Wellek's book, loop by loop (argument order of EQUIVNONINF's gofsimpt)."""
    p_hat = [x[j] / n for j in range(k)]
    squared_distance = first = second = 0.0
    for j in range(k):
        squared_distance += (p_hat[j] - p0[j]) ** 2
        first += (p_hat[j] - p0[j]) ** 2 * p_hat[j]
    for i in range(k):
        for j in range(k):
            second += (p_hat[i] - p0[i]) * (p_hat[j] - p0[j]) * p_hat[i] * p_hat[j]
    standard_error = sqrt((4 / n) * (first - second))
    critical = epsilon**2 - NormalDist().inv_cdf(1 - alpha) * standard_error
    return {"squared_distance": squared_distance, "standard_error": standard_error, "critical_value": critical}


def two_way_f(y: list[list[list[float]]]) -> tuple[float, float, float]:
    """F of A, of B and of A x B for y[subject][a][b], from sums of squares of deviations."""
    n, na, nb = len(y), len(y[0]), len(y[0][0])
    subjects, levels_a, levels_b = range(n), range(na), range(nb)
    grand = fmean(y[s][a][b] for s in subjects for a in levels_a for b in levels_b)
    m_s = [fmean(y[s][a][b] for a in levels_a for b in levels_b) for s in subjects]
    m_a = [fmean(y[s][a][b] for s in subjects for b in levels_b) for a in levels_a]
    m_b = [fmean(y[s][a][b] for s in subjects for a in levels_a) for b in levels_b]
    m_ab = [[fmean(y[s][a][b] for s in subjects) for b in levels_b] for a in levels_a]
    m_sa = [[fmean(y[s][a][b] for b in levels_b) for a in levels_a] for s in subjects]
    m_sb = [[fmean(y[s][a][b] for a in levels_a) for b in levels_b] for s in subjects]
    ss_a = n * nb * sum((m - grand) ** 2 for m in m_a)
    ss_b = n * na * sum((m - grand) ** 2 for m in m_b)
    ss_ab = n * sum((m_ab[a][b] - m_a[a] - m_b[b] + grand) ** 2 for a in levels_a for b in levels_b)
    error_a = nb * sum((m_sa[s][a] - m_s[s] - m_a[a] + grand) ** 2 for s in subjects for a in levels_a)
    error_b = na * sum((m_sb[s][b] - m_s[s] - m_b[b] + grand) ** 2 for s in subjects for b in levels_b)
    error_ab = 0.0
    for s in subjects:
        for a in levels_a:
            for b in levels_b:
                residual = y[s][a][b] - m_ab[a][b] - m_sa[s][a] - m_sb[s][b] + m_s[s] + m_a[a] + m_b[b] - grand
                error_ab += residual**2
    # both degrees of freedom hold the effect's own as a factor: F = (SS / df) / (SS_error / (df (n - 1)))
    return ss_a / error_a * (n - 1), ss_b / error_b * (n - 1), ss_ab / error_ab * (n - 1)


def two_way_sphericity(y: list[list[list[float]]]) -> tuple[float, float, float]:
    """Box's epsilon of A, of B and of A x B for y[subject][a][b], from the covariances of centred cells.

    (sum of variances)^2 / (df * sum of squared covariances) over what each subject's measures are but for what belongs
    to other effects: centred marginal means for a main effect, doubly centred cells for the interaction.
    """
    n, na, nb = len(y), len(y[0]), len(y[0][0])
    of_a, of_b, of_ab = [], [], []
    for cells in y:
        mean = fmean(cells[a][b] for a in range(na) for b in range(nb))
        row = [fmean(cells[a]) - mean for a in range(na)]
        column = [fmean(cells[a][b] for a in range(na)) - mean for b in range(nb)]
        of_a.append(row)
        of_b.append(column)
        of_ab.append([cells[a][b] - row[a] - column[b] - mean for a in range(na) for b in range(nb)])
    results = []
    for scores, df in ((of_a, na - 1), (of_b, nb - 1), (of_ab, (na - 1) * (nb - 1))):
        cells_of = range(len(scores[0]))
        centre = [fmean(score[i] for score in scores) for i in cells_of]
        covariance = [
            [sum((score[i] - centre[i]) * (score[j] - centre[j]) for score in scores) / (n - 1) for j in cells_of]
            for i in cells_of
        ]
        variances = sum(covariance[i][i] for i in cells_of)
        squares = sum(covariance[i][j] ** 2 for i in cells_of for j in cells_of)
        results.append(variances**2 / (df * squares))
    return results[0], results[1], results[2]


def logit_factorial(y: list[list[int]]) -> list[tuple[float, float]]:
    """(estimate, standard error) of A, B and A x B on the logit scale for y[subject] = cells (a-b-, a-b+, a+b-, a+b+).

    The factors are coded -1/2, +1/2. Estimates are contrasts of the cells' log odds; errors follow by the delta method
    from the covariance of the four measures across subjects.
    """
    from math import log

    n = len(y)
    share = [fmean(row[c] for row in y) for c in range(4)]
    log_odds = [log(p / (1 - p)) for p in share]
    slope = [1 / (p * (1 - p)) for p in share]
    covariance = [[fmean((row[i] - share[i]) * (row[j] - share[j]) for row in y) for j in range(4)] for i in range(4)]
    results = []
    for contrast in ((-0.5, -0.5, 0.5, 0.5), (-0.5, 0.5, -0.5, 0.5), (1.0, -1.0, -1.0, 1.0)):
        gradient = [c * g for c, g in zip(contrast, slope, strict=True)]
        variance = sum(gradient[i] * covariance[i][j] * gradient[j] for i in range(4) for j in range(4)) / n
        results.append((sum(c * v for c, v in zip(contrast, log_odds, strict=True)), sqrt(variance)))
    return results
