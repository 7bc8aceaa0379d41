"""Statistics of factorial designs within subjects: analysis of variance, Tukey's post-hoc test, logistic regression.

A cell of the design is a combination of one level of each factor. Every table has exactly one row for each subject and
cell, with a column that names the subject, one column for each factor, and the dependent variable.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import sqrt

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError


def repeated_measures_anova(table: pl.DataFrame, dependent: str, within: Sequence[str], subject: str) -> pl.DataFrame:
    """Analysis of variance with all factors within subjects.

    Each effect has `df` orthonormal contrasts of the cells, and each subject a score on each of them. With n subjects,
    the mean m (df,) and the covariance S (df, df) of the scores, F = n m.m / tr S on df and df (n - 1) degrees of
    freedom: each effect is tested against its own interaction with the subjects. In a 2 x 2 design F is the square of
    the paired t of the effect's contrast. The test assumes that the scores are independent with equal variances
    (sphericity). Where they are not, p is corrected by multiplying both degrees of freedom by (tr S)^2 / (df tr S^2)
    (Greenhouse and Geisser, "On Methods in the Analysis of Profile Data", Psychometrika 24, 1959).

    Args:
        table: one row per subject and cell.
        dependent: column of numbers.
        within: names of the factor columns.
        subject: column that names the subject.

    Returns:
        One row per effect (`a`, `b`, `a:b`): `effect`, `f`, `df_effect`, `df_error`, `p_value`,
        `p_greenhouse_geisser` (equal to `p_value` for factors of two levels) and `partial_eta_squared`, the effect's
        sum of squares divided by itself plus that of its error.

    Raises:
        ArgumentError: the design is incomplete, or an effect has no error variance.
    """
    from scipy.special import fdtrc

    design = _Design.of(table, dependent, within, subject)
    _error_mean_square(design, dependent)
    n = len(design.values)
    rows = []
    for chosen, contrasts in _effects(design.factors):
        effect = ":".join(chosen)
        scores = design.values @ contrasts.T
        mean = scores.mean(axis=0)
        covariance = np.atleast_2d(np.cov(scores, rowvar=False))
        df, variance = len(mean), float(np.trace(covariance))
        if _is_rounding(variance, design):
            raise ArgumentError(
                f"{dependent!r} cannot be tested for {effect!r}: all subjects agree on it, so no error is left to test "
                "it against; give more subjects."
            )
        f = n * float(mean @ mean) / variance
        sphericity = variance**2 / (df * float((covariance**2).sum()))
        rows.append(
            {
                "effect": effect,
                "f": f,
                "df_effect": df,
                "df_error": df * (n - 1),
                "p_value": float(fdtrc(df, df * (n - 1), f)),
                "p_greenhouse_geisser": float(fdtrc(sphericity * df, sphericity * df * (n - 1), f)),
                "partial_eta_squared": f / (f + n - 1),
            }
        )
    return pl.DataFrame(rows)


def tukey_hsd(
    table: pl.DataFrame,
    dependent: str,
    within: Sequence[str],
    subject: str,
    confidence: float = 0.95,
    same: str | None = None,
) -> pl.DataFrame:
    """Tukey's honestly significant differences between all cells of a design within subjects.

    q = |difference| / sqrt(MS / n) is compared with the studentised range of k cells and (k - 1)(n - 1) degrees of
    freedom, where MS is the mean square of cells x subjects (Tukey's test in randomised blocks, which here are the
    subjects). With two cells it is the paired t test.

    Args:
        table, dependent, within, subject: as for `repeated_measures_anova`, with any number of factors.
        confidence: confidence level of the simultaneous intervals.
        same: name of a factor. If given, only pairs of cells with the same level of it are returned; the test still
            accounts for all pairs.

    Returns:
        One row per pair of cells: each factor twice (`<factor>_a`, `<factor>_b`), `mean_a`, `mean_b`, `difference`
        (a - b), `ci_low`, `ci_high`, `q`, `df` and `p_value` (as accurate as SciPy's studentised range: about 1e-11).

    Raises:
        ArgumentError: the design is incomplete, or the differences have no variance.
    """
    from scipy.stats import studentized_range

    design = _Design.of(table, dependent, within, subject)
    if not 0 < confidence < 1:
        raise ArgumentError(f"confidence is {confidence}; it must be between 0 and 1.")
    if same is not None and same not in within:
        raise ArgumentError(f"same is {same!r}; it must be one of the factors, {', '.join(within)}.")
    place = None if same is None else list(within).index(same)
    n, k = design.values.shape
    means = design.values.mean(axis=0)
    df = (n - 1) * (k - 1)
    standard_error = sqrt(_error_mean_square(design, dependent) / n)
    half_width = standard_error * float(studentized_range.ppf(confidence, k, df))
    rows = []
    for a, b in combinations(range(k), 2):
        if place is not None and design.cells[a][place] != design.cells[b][place]:
            continue
        difference = float(means[a] - means[b])
        q = abs(difference) / standard_error
        cells = {f"{name}_a": level for name, level in zip(within, design.cells[a], strict=True)}
        cells |= {f"{name}_b": level for name, level in zip(within, design.cells[b], strict=True)}
        rows.append(
            cells
            | {
                "mean_a": float(means[a]),
                "mean_b": float(means[b]),
                "difference": difference,
                "ci_low": difference - half_width,
                "ci_high": difference + half_width,
                "q": q,
                "df": df,
                "p_value": float(np.clip(studentized_range.sf(q, k, df), 0.0, 1.0)),
            }
        )
    return pl.DataFrame(rows)


def repeated_logistic(table: pl.DataFrame, dependent: str, within: Sequence[str], subject: str) -> pl.DataFrame:
    """Factorial logistic regression of a yes-or-no measure, with repeated measures.

    logit P(yes) on all factors and their interactions, with standard errors that allow for the repeated measures of a
    subject: generalised estimating equations with one cluster per subject and robust (sandwich) errors (Liang and
    Zeger, "Longitudinal Data Analysis Using Generalized Linear Models", Biometrika 73, 1986). As the design is complete
    and the model has a parameter for every cell, the equations have the same solution for every working correlation:
    contrasts of the cells' log odds, with errors from the covariance of the cells across subjects. Factors have two
    levels, coded -1/2 and +1/2 in sorted order, so a main effect is the log odds ratio averaged over the other factor.

    Args:
        table, dependent, within, subject: as for `repeated_measures_anova`; `dependent` holds 0/1 or booleans.

    Returns:
        One row per term (`a`, `b`, `a:b`): `term`, `log_odds_ratio`, `standard_error`, `z`, `p_value`, `odds_ratio`,
        `ci_low`, `ci_high` (95 % interval of the odds ratio). All numbers are null if in some cell all subjects or none
        say yes, because the log odds are then infinite.

    Raises:
        ArgumentError: the design is incomplete, a factor has other than two levels, or the measure is not yes-or-no.
    """
    design = _Design.of(table, dependent, within, subject)
    for name, levels in design.factors.items():
        if len(levels) != 2:
            raise ArgumentError(f"{name!r} has the {len(levels)} levels {levels}; the logistic regression takes two.")
    if not np.isin(design.values, (0.0, 1.0)).all():
        raise ArgumentError(f"{dependent!r} holds values other than 0 and 1; the logistic regression takes only these.")
    shares = design.values.mean(axis=0)
    numbers = ("log_odds_ratio", "standard_error", "z", "p_value", "odds_ratio", "ci_low", "ci_high")
    if (shares == 0).any() or (shares == 1).any():
        columns = [[None] * (2 ** len(design.factors) - 1)] * len(numbers)
    else:
        columns = [column.tolist() for column in _log_odds_ratios(design)]
    estimates = [pl.Series(name, column, dtype=pl.Float64) for name, column in zip(numbers, columns, strict=True)]
    return pl.DataFrame([pl.Series("term", [":".join(chosen) for chosen, _ in _effects(design.factors)]), *estimates])


@dataclass(frozen=True, eq=False)
class _Design:
    """A complete design.

    Attributes:
        values: (subjects, cells) the dependent variable.
        factors: the sorted levels of each factor.
        cells: for each cell, its level of each factor.
    """

    values: FloatArray
    factors: dict[str, list[str]]
    cells: list[tuple[str, ...]]

    @classmethod
    def of(cls, table: pl.DataFrame, dependent: str, within: Sequence[str], subject: str) -> _Design:
        names = [subject, *within, dependent]
        for name in names:
            if name not in table.columns:
                raise ArgumentError(f"the table has no column {name!r}; it has {', '.join(table.columns)}.")
        if not within or len(set(names)) != len(names):
            raise ArgumentError(f"within is {list(within)}; give at least one factor, each column once.")
        if table.select(names).null_count().sum_horizontal().item():
            raise ArgumentError(f"one of the columns {', '.join(names)} has missing values; give every measurement.")
        y = table[dependent].cast(pl.Float64)
        if not y.is_finite().all():
            raise ArgumentError(f"{dependent!r} holds NaN or infinite values; give finite numbers.")
        factors = {name: sorted(table[name].cast(pl.String).unique().to_list()) for name in within}
        for name, levels in factors.items():
            if len(levels) < 2:
                raise ArgumentError(f"the factor {name!r} has only the level {levels}; it must have at least two.")
        cells = list(product(*factors.values()))
        keyed = table.select(subject, *(pl.col(name).cast(pl.String) for name in within), y.alias(dependent))
        keyed = keyed.sort(subject, *within)
        counts = keyed.group_by(subject, maintain_order=True).agg(pl.struct(within).n_unique().alias("n"), pl.len())
        incomplete = counts.filter((pl.col("n") != len(cells)) | (pl.col("len") != len(cells)))
        if incomplete.height:
            raise ArgumentError(
                f"the subject {incomplete[subject][0]!r} has {incomplete['len'][0]} rows in {incomplete['n'][0]} of "
                f"the {len(cells)} cells; every subject needs exactly one row in each."
            )
        if counts.height < 2:
            raise ArgumentError(f"{subject!r} has one value; a design within subjects needs at least two subjects.")
        return cls(keyed[dependent].to_numpy().reshape(-1, len(cells)), factors, cells)


def _error_mean_square(design: _Design, dependent: str) -> float:
    """The mean square of cells x subjects, which has (k - 1)(n - 1) degrees of freedom."""
    y = design.values
    residuals = y - y.mean(axis=0) - y.mean(axis=1, keepdims=True) + y.mean()
    mean_square: float = float((residuals**2).sum()) / ((y.shape[0] - 1) * (y.shape[1] - 1))
    if _is_rounding(mean_square, design):
        raise ArgumentError(
            f"{dependent!r} differs between cells equally in all subjects, so there is no error to test against; give "
            "more subjects."
        )
    return mean_square


def _is_rounding(variance: float, design: _Design) -> bool:
    """Whether a variance of the measurements is so small that it may be zero but for rounding."""
    return variance <= (1e-12 * float(np.abs(design.values).max())) ** 2


def _effects(factors: dict[str, list[str]]) -> Iterator[tuple[tuple[str, ...], FloatArray]]:
    """For each effect, its factors and its orthonormal contrasts (df, cells); main effects first, then interactions.

    The contrasts are Kronecker products of one matrix per factor: contrasts of its levels if it belongs to the effect,
    else the mean over its levels.
    """
    from scipy.linalg import helmert

    for chosen in (chosen for size in range(1, len(factors) + 1) for chosen in combinations(factors, size)):
        contrasts = np.ones((1, 1))
        for name, levels in factors.items():
            k = len(levels)
            mean = np.full((1, k), 1 / sqrt(k))
            contrasts = np.kron(contrasts, -helmert(k) if name in chosen else mean)  # each level minus those before it
        yield chosen, contrasts


def _log_odds_ratios(design: _Design) -> tuple[FloatArray, ...]:
    """Log odds ratios, standard errors, z, p, odds ratios, and lower and upper ends of intervals; each (effects,)."""
    from scipy.special import logit, ndtr, ndtri

    n, k = design.values.shape
    # with factors coded -1/2 and 1/2, the coefficient of m factors is the sum of the cells' log odds times -2^m/k or
    # 2^m/k, where the orthonormal contrast has -1/sqrt(k) or 1/sqrt(k)
    contrasts = np.concatenate([contrast * 2 ** len(chosen) / sqrt(k) for chosen, contrast in _effects(design.factors)])
    shares = design.values.mean(axis=0)
    estimates = contrasts @ logit(shares)
    # the influence of each subject on n times each estimate
    influence = (design.values - shares) / (shares * (1 - shares)) @ contrasts.T
    errors = np.sqrt((influence**2).sum(axis=0)) / n
    z = estimates / errors
    half_width = float(ndtri(0.975)) * errors
    low, high = np.exp(estimates - half_width), np.exp(estimates + half_width)
    return estimates, errors, z, 2 * ndtr(-np.abs(z)), np.exp(estimates), low, high


@dataclass(frozen=True)
class CrossedLead:
    """The mean of values that depend on who was asked and on what was drawn.

    Attributes:
        draws, people: how many.
        mean: over both.
        low, high: 95 % interval over both; over the draws alone if there is one person.
        sd_people, sd_draws: standard deviations of the two random effects; the first is None with one person.
        p_paired: t test of the people's means over the draws against 0; None with one person.
        share_below: of the draws, those whose mean is below 0.
    """

    draws: int
    people: int
    mean: float
    low: float
    high: float
    sd_people: float | None
    sd_draws: float
    p_paired: float | None
    share_below: float


def crossed_lead(values: FloatArray) -> CrossedLead:
    """The mean of (draws, people) values with an interval over both, as two crossed random effects.

    value = mean + draw + person + rest. With the mean squares of the balanced layout, MS_p of n people, MS_d of D draws
    and MS_e of what is left over, (MS_p + MS_d - MS_e) / (n D) estimates the variance of the mean, on Satterthwaite's
    degrees of freedom (Searle, Casella and McCulloch, "Variance Components", 1992, chapter 4). Where the estimate falls
    below what one effect alone gives, that one is taken, which errs to the wide side.

    Args:
        values: (D, n); with one person, D draws of one value.

    Raises:
        ArgumentError: values is not such a table of finite numbers, or there is one draw.
    """
    from scipy.special import stdtr, stdtrit

    if values.ndim != 2 or len(values) < 2 or not np.isfinite(values).all():
        raise ArgumentError(f"values have shape {values.shape}; finite (draws, people) with two or more draws needed.")
    count, n = values.shape
    mean, of_draws, of_people = float(values.mean()), values.mean(axis=1), values.mean(axis=0)
    sd_people = p_paired = None
    if n > 1:
        rest = values - of_draws[:, None] - of_people + mean
        error = float((rest**2).sum()) / ((count - 1) * (n - 1))
        by_draw, by_person = n * float(of_draws.var(ddof=1)), count * float(of_people.var(ddof=1))
        square = max(by_draw + by_person - error, by_draw, by_person)
        spread = by_draw**2 / (count - 1) + by_person**2 / (n - 1) + error**2 / ((count - 1) * (n - 1))
        df = square**2 / spread if spread > 0 else float("inf")
        sd_people = sqrt(max(by_person - error, 0.0) / count)
        sd_draws = sqrt(max(by_draw - error, 0.0) / n)
        error_of_people = float(of_people.std(ddof=1)) / sqrt(n)
        p_paired = 2 * float(stdtr(n - 1, -abs(mean) / error_of_people)) if error_of_people > 0 else None
    else:
        square, df = float(of_draws.var(ddof=1)), float(count - 1)
        sd_draws = sqrt(square)
    half_width = float(stdtrit(df, 0.975)) * sqrt(square / (count * n))
    below = float((of_draws < 0).mean())
    return CrossedLead(count, n, mean, mean - half_width, mean + half_width, sd_people, sd_draws, p_paired, below)
