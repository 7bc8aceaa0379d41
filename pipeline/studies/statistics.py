"""Statistics of factorial designs within subjects: analysis of variance, Tukey's post-hoc test, logistic regression.

Every table here has one row per subject and cell of the design: a column that names the subject, one column for each
factor, and the dependent variable. Every subject must have been measured in every cell exactly once.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import sqrt

import numpy as np
import polars as pl

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError


def repeated_measures_anova(table: pl.DataFrame, dependent: str, within: Sequence[str], subject: str) -> pl.DataFrame:
    """Analysis of variance with one or two factors within subjects.

    Each effect is tested against its own interaction with the subjects (computed by pingouin); in a 2 x 2 design
    that is the square of the paired t of the effect's contrast.

    Args:
        table: one row per subject and cell.
        dependent: column of numbers.
        within: names of one or two factor columns.
        subject: column that names the subject.

    Returns:
        One row per effect (`a`, `b`, `a:b`): `effect`, `f`, `df_effect`, `df_error`, `p_value`,
        `p_greenhouse_geisser` (corrected for lack of sphericity; the same for factors of two levels) and
        `partial_eta_squared`.

    Raises:
        ArgumentError: the design is incomplete, has other than one or two factors, or an effect has no error variance.
    """
    design = _Design.of(table, dependent, within, subject)
    if len(design.factors) > 2:
        raise ArgumentError(f"within has {len(design.factors)} factors; the analysis of variance takes one or two.")
    _error_mean_square(design, dependent)
    rows = []
    for row in _pingouin_anova(design):
        effect, f, p_value = row["Source"], float(row["F"]), float(row["p_unc"])
        if not np.isfinite(f):
            raise ArgumentError(
                f"{dependent!r} gives F = {f} for {effect!r}: all subjects agree on it, so no error is left to test it "
                "against; give more subjects."
            )
        corrected = float(row.get("p_GG_corr", p_value))
        rows.append(
            {
                "effect": effect,
                "f": f,
                "df_effect": int(row["ddof1"]),
                "df_error": int(row["ddof2"]),
                "p_value": p_value,
                "p_greenhouse_geisser": corrected if np.isfinite(corrected) else p_value,
                "partial_eta_squared": float(row["np2"]),
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
    freedom, MS being the mean square of cells x subjects (Tukey's test in randomised blocks, the subject being the
    block). With two cells it is the paired t test.

    Args:
        table, dependent, within, subject: as for `repeated_measures_anova`, with any number of factors.
        confidence: of the simultaneous intervals.
        same: a factor; only pairs of cells on the same level of it are returned, judged as part of all pairs.

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

    Generalised estimating equations (statsmodels): logit P(yes) on all factors and their interactions, one cluster
    per subject, robust (sandwich) standard errors. Factors have two levels, coded -1/2 and +1/2 in sorted order, so a
    main effect is the log odds ratio averaged over the other factor. The design is complete and the model saturated,
    therefore estimates and errors are the same under every working correlation; independence is used.

    Args:
        table, dependent, within, subject: as for `repeated_measures_anova`; `dependent` holds 0/1 or booleans.

    Returns:
        One row per term (`a`, `b`, `a:b`): `term`, `log_odds_ratio`, `standard_error`, `z`, `p_value`, `odds_ratio`,
        `ci_low`, `ci_high` (95 %, of the odds ratio). In a design with a cell where all or none are yes the odds are
        infinite and there is nothing to estimate: all numbers are null.

    Raises:
        ArgumentError: the design is incomplete, a factor has other than two levels, or the measure is not yes-or-no.
    """
    design = _Design.of(table, dependent, within, subject)
    for name, levels in design.factors.items():
        if len(levels) != 2:
            raise ArgumentError(f"{name!r} has the {len(levels)} levels {levels}; the logistic regression takes two.")
    if not np.isin(design.values, (0.0, 1.0)).all():
        raise ArgumentError(f"{dependent!r} holds values other than 0 and 1; the logistic regression takes only these.")
    terms = _terms(list(design.factors))
    shares = design.values.mean(axis=0)
    numbers = ("log_odds_ratio", "standard_error", "z", "p_value", "odds_ratio", "ci_low", "ci_high")
    if (shares == 0).any() or (shares == 1).any():
        estimates = np.full((len(terms), len(numbers)), None)
    else:
        estimates = _gee(design.values, len(design.factors))
    columns = {name: pl.Series(name, list(estimates[:, i]), dtype=pl.Float64) for i, name in enumerate(numbers)}
    return pl.DataFrame({"term": terms} | columns)


@dataclass(frozen=True, eq=False)
class _Design:
    """A complete design: `values` (subjects, cells), the levels of each factor, and each cell's levels in order."""

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
    """Mean square of cells x subjects, with (k - 1)(n - 1) degrees of freedom."""
    y = design.values
    residuals = y - y.mean(axis=0) - y.mean(axis=1, keepdims=True) + y.mean()
    mean_square: float = float((residuals**2).sum()) / ((y.shape[0] - 1) * (y.shape[1] - 1))
    if mean_square <= (1e-12 * float(np.abs(y).max())) ** 2:
        raise ArgumentError(
            f"{dependent!r} differs between cells equally in all subjects, so there is no error to test against; give "
            "more subjects."
        )
    return mean_square


def _pingouin_anova(design: _Design) -> list[dict[str, float | str]]:
    import pandas as pd
    import pingouin

    subjects, k = design.values.shape
    frame = pd.DataFrame({"value": design.values.ravel(), "subject": np.repeat(np.arange(subjects), k)})
    aliases = [f"factor{i}" for i in range(len(design.factors))]  # no name of the caller's can clash with ours
    for i, alias in enumerate(aliases):
        frame[alias] = [cell[i] for cell in design.cells] * subjects
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):  # a missing error shows as F = inf
        warnings.simplefilter("ignore", DeprecationWarning)  # pingouin 0.7 calls pandas 3 the way of pandas 2
        effects = pingouin.rm_anova(
            frame, dv="value", within=aliases, subject="subject", correction=True, effsize="np2"
        )
    rows: list[dict[str, float | str]] = effects.to_dict("records")
    for row, effect in zip(rows, _terms(list(design.factors)), strict=True):
        row["Source"] = effect
    return rows


def _terms(factors: list[str]) -> list[str]:
    return [":".join(chosen) for size in range(1, len(factors) + 1) for chosen in combinations(factors, size)]


def _gee(values: FloatArray, n_factors: int) -> FloatArray:
    """Log odds ratio, standard error, z, p, odds ratio and its interval for each term but the intercept."""
    import statsmodels.api as sm

    subjects, k = values.shape
    main = np.array(list(product((-0.5, 0.5), repeat=n_factors)))  # (k, n_factors), in the order of the cells
    contrasts = [
        main[:, list(chosen)].prod(axis=1)
        for size in range(n_factors + 1)
        for chosen in combinations(range(n_factors), size)
    ]
    fit = sm.GEE(
        values.ravel(),
        np.tile(np.column_stack(contrasts), (subjects, 1)),
        groups=np.repeat(np.arange(subjects), k),
        family=sm.families.Binomial(),
        cov_struct=sm.cov_struct.Independence(),
    ).fit()
    interval = np.exp(fit.conf_int())
    columns = (fit.params, fit.bse, fit.tvalues, fit.pvalues, np.exp(fit.params), interval[:, 0], interval[:, 1])
    return np.column_stack(columns)[1:]
