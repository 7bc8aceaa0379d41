"""Within-subjects statistics against a textbook example, closed forms, slow versions, pingouin and statsmodels."""

from __future__ import annotations

import math
import warnings
from itertools import combinations, product

import numpy as np
import pandas
import polars as pl
import pytest
from scipy import stats
from scipy.stats import f as fisher
from scipy.stats import studentized_range, ttest_1samp, ttest_rel

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError
from pipeline.studies.statistics import crossed_lead, repeated_logistic, repeated_measures_anova, tukey_hsd
from tests.oracles.slow_statistics import logit_factorial, two_way_f, two_way_sphericity


def long(y: FloatArray, seed: int = 0) -> pl.DataFrame:
    """y (subjects, a, b) as a table with its rows in random order."""
    n, na, nb = y.shape
    s, a, b = (index.ravel() for index in np.indices((n, na, nb)))
    table = pl.DataFrame({"s": s, "a": [f"a{i}" for i in a], "b": [f"b{i}" for i in b], "y": y.ravel()})
    return table.sample(fraction=1.0, shuffle=True, seed=seed)


def measurements(n: int, na: int, nb: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    effect = rng.normal(size=(1, na, nb))
    return rng.normal(size=(n, 1, 1)) + 0.4 * effect + rng.normal(size=(n, na, nb))


def test_textbook_example() -> None:
    # fitness of six people before, after 3 and after 6 months of exercise: Laerd Statistics' worked example,
    # F(2, 10) = 12.534, and p = .009 after the Greenhouse-Geisser correction (epsilon 0.638)
    pre, mid, post = [45, 42, 36, 39, 51, 44], [50, 42, 41, 35, 55, 49], [55, 45, 43, 40, 59, 56]
    table = pl.DataFrame({"s": [*range(6)] * 3, "time": ["0"] * 6 + ["3"] * 6 + ["6"] * 6, "y": pre + mid + post})
    (row,) = repeated_measures_anova(table, "y", ["time"], "s").to_dicts()
    assert (row["effect"], row["df_effect"], row["df_error"]) == ("time", 2, 10)
    assert row["f"] == pytest.approx(12.534, abs=5e-4)
    assert row["p_value"] == pytest.approx(0.002, abs=5e-4)
    assert row["p_greenhouse_geisser"] == pytest.approx(0.009, abs=5e-4)
    assert row["partial_eta_squared"] == pytest.approx(0.715, abs=5e-4)


def test_interaction_of_two_by_two_is_a_squared_paired_t() -> None:
    y = measurements(60, 2, 2, seed=1)
    table = repeated_measures_anova(long(y), "y", ["a", "b"], "s")
    rows = {row["effect"]: row for row in table.to_dicts()}
    assert list(rows) == ["a", "b", "a:b"]
    t = {
        "a": ttest_rel(y[:, 0].mean(axis=1), y[:, 1].mean(axis=1)),
        "b": ttest_rel(y[:, :, 0].mean(axis=1), y[:, :, 1].mean(axis=1)),
        "a:b": ttest_rel(y[:, 0, 0] - y[:, 0, 1], y[:, 1, 0] - y[:, 1, 1]),
    }
    for effect, row in rows.items():
        assert row["f"] == pytest.approx(t[effect].statistic ** 2, rel=1e-10)
        assert row["p_value"] == pytest.approx(t[effect].pvalue, rel=1e-8)
        assert row["p_greenhouse_geisser"] == pytest.approx(row["p_value"], rel=1e-12)
        assert (row["df_effect"], row["df_error"]) == (1, 59)


@pytest.mark.parametrize("shape", [(12, 2, 5), (7, 3, 4)])
def test_two_way_agrees_with_sums_of_squares(shape: tuple[int, int, int]) -> None:
    y = measurements(*shape, seed=2)
    table = repeated_measures_anova(long(y), "y", ["a", "b"], "s")
    assert table["f"].to_numpy() == pytest.approx(two_way_f(y.tolist()), rel=1e-10)
    n, na, nb = shape
    degrees = [na - 1, nb - 1, (na - 1) * (nb - 1)]
    assert table["df_effect"].to_list() == degrees
    assert table["df_error"].to_list() == [df * (n - 1) for df in degrees]
    epsilon = np.array(two_way_sphericity(y.tolist()))
    assert (epsilon < 1).any()
    corrected = fisher.sf(table["f"], epsilon * degrees, epsilon * degrees * np.float64(n - 1))
    assert table["p_value"].to_numpy() == pytest.approx(fisher.sf(table["f"], degrees, table["df_error"]), rel=1e-12)
    assert table["p_greenhouse_geisser"].to_numpy() == pytest.approx(corrected, rel=1e-10)


@pytest.mark.parametrize("shape", [(40, 2, 2), (12, 3, 5), (6, 4, 3), (9, 5, 1)])
def test_analysis_of_variance_agrees_with_pingouin(shape: tuple[int, int, int]) -> None:
    table = long(100.0 + measurements(*shape, seed=11))
    within = ["a", "b"] if shape[2] > 1 else ["a"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pingouin 0.7 calls pandas 3 the way of pandas 2
        import pingouin

        peer = pingouin.rm_anova(
            pandas.DataFrame(table.to_dict(as_series=False)),
            dv="y", within=within, subject="s", correction=True, effsize="np2",
        )  # fmt: skip
    own = repeated_measures_anova(table, "y", within, "s")
    corrected = peer["p_GG_corr"].fillna(peer["p_unc"]) if "p_GG_corr" in peer else peer["p_unc"]
    assert peer["Source"].tolist() == [effect.replace(":", " * ") for effect in own["effect"]]
    for column, expected in (
        ("f", peer["F"]), ("p_value", peer["p_unc"]), ("p_greenhouse_geisser", corrected),
        ("partial_eta_squared", peer["np2"]), ("df_effect", peer["ddof1"]), ("df_error", peer["ddof2"]),
    ):  # fmt: skip
        assert own[column].to_numpy() == pytest.approx(expected.to_numpy(), rel=1e-9), column


def test_an_interaction_of_three_factors_is_a_squared_paired_t() -> None:
    y = measurements(30, 4, 2, seed=12).reshape(30, 2, 2, 2)
    s, a, b, c = (index.ravel() for index in np.indices(y.shape))
    table = pl.DataFrame({"s": s, "a": a, "b": b, "c": c, "y": y.ravel()})
    rows = {row["effect"]: row for row in repeated_measures_anova(table, "y", ["a", "b", "c"], "s").to_dicts()}
    assert list(rows) == ["a", "b", "c", "a:b", "a:c", "b:c", "a:b:c"]
    difference = np.diff(np.diff(np.diff(y, axis=1), axis=2), axis=3).ravel()
    main = np.diff(y.mean(axis=(1, 3)), axis=1).ravel()
    for effect, scores in (("a:b:c", difference), ("b", main)):
        t = ttest_1samp(scores, 0.0)
        assert rows[effect]["f"] == pytest.approx(t.statistic**2, rel=1e-10)
        assert rows[effect]["p_value"] == pytest.approx(t.pvalue, rel=1e-8)
        assert rows[effect]["df_error"] == 29


def test_tukey_of_two_cells_is_the_paired_t_test() -> None:
    y = measurements(25, 2, 1, seed=3)
    table = long(y)
    (row,) = tukey_hsd(table, "y", ["a"], "s").to_dicts()
    t = ttest_rel(y[:, 0, 0], y[:, 1, 0])
    assert row["p_value"] == pytest.approx(t.pvalue, abs=1e-9)
    assert row["q"] == pytest.approx(np.sqrt(2) * abs(t.statistic), rel=1e-10)
    interval = t.confidence_interval(0.95)
    assert (row["ci_low"], row["ci_high"]) == pytest.approx((interval.low, interval.high), rel=1e-6)


def test_tukey_of_four_cells() -> None:
    y = measurements(30, 2, 2, seed=4)
    table = tukey_hsd(long(y), "y", ["a", "b"], "s")
    assert table.select("a_a", "b_a", "a_b", "b_b").rows() == [
        ("a0", "b0", "a0", "b1"),
        ("a0", "b0", "a1", "b0"),
        ("a0", "b0", "a1", "b1"),
        ("a0", "b1", "a1", "b0"),
        ("a0", "b1", "a1", "b1"),
        ("a1", "b0", "a1", "b1"),
    ]
    cells = y.reshape(30, 4)
    residual = cells - cells.mean(axis=0) - cells.mean(axis=1, keepdims=True) + cells.mean()
    mean_square = (residual**2).sum() / (29 * 3)
    q = abs(cells[:, 0].mean() - cells[:, 3].mean()) / np.sqrt(mean_square / 30)
    row = table.row(2, named=True)
    assert row["q"] == pytest.approx(q, rel=1e-10)
    assert row["p_value"] == pytest.approx(float(studentized_range.sf(q, 4, 87)), rel=1e-6)
    assert row["df"] == 87
    significant = (table["ci_low"] > 0) | (table["ci_high"] < 0)
    assert significant.to_list() == (table["p_value"] < 0.05).to_list()


def test_tukey_of_pairs_on_one_level_is_part_of_all_pairs() -> None:
    table = long(measurements(9, 2, 3, seed=8))
    pairs = tukey_hsd(table, "y", ["a", "b"], "s")
    some = tukey_hsd(table, "y", ["a", "b"], "s", same="b")
    assert some["b_a"].to_list() == ["b0", "b1", "b2"]
    assert some.equals(pairs.filter(pl.col("b_a") == pl.col("b_b")))
    with pytest.raises(ArgumentError, match="same is 'c'; it must be one of the factors, a, b"):
        tukey_hsd(table, "y", ["a", "b"], "s", same="c")


def test_logistic_is_the_contrast_of_log_odds() -> None:
    rng = np.random.default_rng(6)
    latent = rng.normal(size=(300, 1, 1)) + rng.normal(size=(300, 2, 2))
    y = (latent + np.array([[0.5, -0.3], [0.1, 0.2]]) > 0).astype(np.float64)
    table = repeated_logistic(long(y), "y", ["a", "b"], "s")
    expected = logit_factorial(y.reshape(300, 4).astype(int).tolist())
    assert table["term"].to_list() == ["a", "b", "a:b"]
    for row, (estimate, error) in zip(table.to_dicts(), expected, strict=True):
        assert row["log_odds_ratio"] == pytest.approx(estimate, abs=1e-8)
        assert row["standard_error"] == pytest.approx(error, rel=1e-6)
        assert row["z"] == pytest.approx(estimate / error, rel=1e-6, abs=1e-8)
        assert row["odds_ratio"] == pytest.approx(np.exp(estimate), rel=1e-8)
        assert row["ci_low"] < row["odds_ratio"] < row["ci_high"]


@pytest.mark.parametrize("factors", [["a"], ["a", "b"], ["a", "b", "c"]])
def test_logistic_agrees_with_the_estimating_equations_of_statsmodels(factors: list[str]) -> None:
    import statsmodels.api as sm

    rng = np.random.default_rng(13)
    n, k = 250, 2 ** len(factors)
    y = (rng.normal(size=(n, 1)) + rng.normal(size=(n, k)) + rng.normal(scale=0.5, size=(1, k)) > 0).astype(np.float64)
    levels = np.array(list(product((0, 1), repeat=len(factors))))
    table = pl.DataFrame({"s": np.repeat(np.arange(n), k), "y": y.ravel()}).with_columns(
        pl.Series(name, np.tile(levels[:, i], n)) for i, name in enumerate(factors)
    )
    terms = [chosen for size in range(len(factors) + 1) for chosen in combinations(range(len(factors)), size)]
    design = np.column_stack([(levels[:, list(chosen)] - 0.5).prod(axis=1) for chosen in terms])
    fit = sm.GEE(
        y.ravel(), np.tile(design, (n, 1)), groups=table["s"].to_numpy(), family=sm.families.Binomial(),
        cov_struct=sm.cov_struct.Independence(),
    ).fit(ctol=1e-12)  # fmt: skip
    own = repeated_logistic(table, "y", factors, "s")
    assert own["term"].to_list() == [":".join(factors[i] for i in chosen) for chosen in terms[1:]]
    low, high = np.exp(fit.conf_int()).T
    for column, expected in (
        ("log_odds_ratio", fit.params), ("standard_error", fit.bse), ("z", fit.tvalues), ("p_value", fit.pvalues),
        ("odds_ratio", np.exp(fit.params)), ("ci_low", low), ("ci_high", high),
    ):  # fmt: skip
        assert own[column].to_numpy() == pytest.approx(expected[1:], rel=1e-9), column


def test_logistic_of_one_factor_and_booleans() -> None:
    y = np.zeros((40, 2, 1))
    y[:10, 0], y[:30, 1] = 1.0, 1.0
    table = long(y).with_columns(pl.col("y") > 0.5)
    (row,) = repeated_logistic(table, "y", ["a"], "s").to_dicts()
    assert row["odds_ratio"] == pytest.approx(9.0, rel=1e-8)  # (30/10) / (10/30)


def test_logistic_with_infinite_odds_estimates_nothing() -> None:
    y = np.ones((10, 2, 1))
    y[:5, 0] = 0.0
    (row,) = repeated_logistic(long(y), "y", ["a"], "s").to_dicts()
    assert row["term"] == "a"
    assert all(value is None for name, value in row.items() if name != "term")


def test_row_order_does_not_matter() -> None:
    y = measurements(20, 2, 2, seed=7)
    first, second = long(y, seed=1), long(y, seed=2)
    assert first.rows() != second.rows()
    for statistic in (repeated_measures_anova, tukey_hsd):
        assert statistic(first, "y", ["a", "b"], "s").equals(statistic(second, "y", ["a", "b"], "s"))


def test_refusals() -> None:
    table = long(measurements(5, 2, 2, seed=8))
    with pytest.raises(ArgumentError, match="no column 'z'; it has s, a, b, y"):
        repeated_measures_anova(table, "z", ["a"], "s")
    with pytest.raises(ArgumentError, match="has 4 rows in 2 of the 2 cells"):
        repeated_measures_anova(table, "y", ["a"], "s")
    with pytest.raises(ArgumentError, match="every subject needs exactly one row"):
        tukey_hsd(table.slice(1), "y", ["a", "b"], "s")
    with pytest.raises(ArgumentError, match="at least two subjects"):
        tukey_hsd(table.filter(pl.col("s") == 0), "y", ["a", "b"], "s")
    with pytest.raises(ArgumentError, match="only the level"):
        tukey_hsd(table.filter(pl.col("a") == "a0"), "y", ["a", "b"], "s")
    with pytest.raises(ArgumentError, match="other than 0 and 1"):
        repeated_logistic(table, "y", ["a", "b"], "s")
    with pytest.raises(ArgumentError, match="NaN"):
        tukey_hsd(table.with_columns(pl.lit(float("nan")).alias("y")), "y", ["a", "b"], "s")
    with pytest.raises(ArgumentError, match="missing values"):
        tukey_hsd(table.with_columns(pl.lit(None, dtype=pl.Float64).alias("y")), "y", ["a", "b"], "s")
    with pytest.raises(ArgumentError, match="each column once"):
        tukey_hsd(table, "y", ["a", "a"], "s")
    same = table.with_columns(y=(pl.col("a") == "a0").cast(pl.Float64) + pl.col("s") * 2)
    with pytest.raises(ArgumentError, match="equally in all subjects"):
        tukey_hsd(same, "y", ["a", "b"], "s")
    with pytest.raises(ArgumentError, match="no error to test against"):
        repeated_measures_anova(same, "y", ["a", "b"], "s")
    agreed = measurements(6, 2, 2, seed=9)
    agreed[:, 1] = agreed[:, 0] + 1.0
    with pytest.raises(ArgumentError, match="all subjects agree on it"):
        repeated_measures_anova(long(np.round(agreed)), "y", ["a", "b"], "s")
    wide = long(np.random.default_rng(0).integers(0, 2, (5, 3, 1)).astype(np.float64))
    with pytest.raises(ArgumentError, match="takes two"):
        repeated_logistic(wide, "y", ["a"], "s")


def test_the_lead_over_draws_and_people_against_a_mixed_model_written_out() -> None:
    """Values whose mean squares are known: two-way layout without replication."""
    values = np.array([[1.0, 2.0, 6.0], [2.0, 4.0, 9.0], [0.0, 3.0, 3.0], [1.0, 3.0, 6.0]])
    lead = crossed_lead(values)
    mean = values.mean()
    by_draw = 3 * sum((row.mean() - mean) ** 2 for row in values) / 3
    by_person = 4 * sum((column.mean() - mean) ** 2 for column in values.T) / 2
    rest = sum(
        (values[d, p] - values[d].mean() - values[:, p].mean() + mean) ** 2 for d in range(4) for p in range(3)
    ) / 6  # fmt: skip
    assert (lead.draws, lead.people, lead.mean) == (4, 3, pytest.approx(mean))
    assert lead.sd_people == pytest.approx(math.sqrt((by_person - rest) / 4))
    assert lead.sd_draws == pytest.approx(math.sqrt(max(by_draw - rest, 0) / 3))
    square = by_draw + by_person - rest
    df = square**2 / (by_draw**2 / 3 + by_person**2 / 2 + rest**2 / 6)
    half = stats.t.ppf(0.975, df) * math.sqrt(square / 12)
    assert (lead.low, lead.high) == (pytest.approx(mean - half), pytest.approx(mean + half))
    assert lead.p_paired == pytest.approx(stats.ttest_1samp(values.mean(axis=0), 0).pvalue)
    assert lead.share_below == 0


def test_its_intervals_cover_the_mean_as_often_as_they_say() -> None:
    """400 simulated studies of 20 draws and 12 people, with effects of either and of both."""
    rng = np.random.default_rng(9)
    for sd_people, sd_draws in ((0.3, 0.05), (0.05, 0.5), (0.3, 0.3)):
        covered = 0
        for _ in range(400):
            values = (
                0.2 + sd_people * rng.normal(size=12) + sd_draws * rng.normal(size=(20, 1))
                + 0.2 * rng.normal(size=(20, 12))
            )  # fmt: skip
            lead = crossed_lead(values)
            covered += lead.low <= 0.2 <= lead.high
        assert 0.92 <= covered / 400 <= 0.99  # 95 % with a standard error of 1.1 %


def test_draws_of_one_value() -> None:
    values = np.array([[1.0], [2.0], [4.0]])
    lead = crossed_lead(values)
    low, high = stats.t.interval(0.95, 2, loc=7 / 3, scale=stats.sem(values[:, 0]))
    assert (lead.low, lead.high) == (pytest.approx(low), pytest.approx(high))
    assert (lead.sd_people, lead.p_paired) == (None, None)
    with pytest.raises(ArgumentError, match="two or more draws"):
        crossed_lead(values[:1])
