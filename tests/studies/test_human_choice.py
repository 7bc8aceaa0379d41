"""Section 3: the 77 choices, the paper's numbers, other people's data, and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pipeline.choice import AttributeRule, log_probabilities
from pipeline.errors import ArgumentError, TableError
from pipeline.studies.goodness_of_fit import chi_square_test, wellek_minimum_epsilon
from pipeline.studies.human_choice import HumanChoiceStudy, analyse_choices, compare_with_paper

CHOICES = Path(__file__).resolve().parents[2] / "datasets/studies/human_choice/choices.csv"


@pytest.fixture(scope="module")
def study() -> HumanChoiceStudy:
    return analyse_choices(pl.read_csv(CHOICES))


def choices(*rows: tuple[str, str, str, int]) -> pl.DataFrame:
    """Rows (trial, choice, group, how many)."""
    one_each = [row[:3] for row in rows for _ in range(row[3])]
    table = pl.DataFrame(one_each, schema=["trial", "choice", "group"], orient="row")
    return table.with_row_index("participant")


CONTROL = (("control", "a", "A", 6), ("control", "b", "B", 3), ("control", "c", "C", 1))
EXPERIMENTAL = (("experimental", "a", "A", 5), ("experimental", "b1", "B", 2), ("experimental", "b2", "B", 4),
                ("experimental", "c", "C", 1))  # fmt: skip


def test_seventy_seven_participants() -> None:
    table = pl.read_csv(CHOICES)
    assert table.columns == ["participant", "trial", "choice", "group"]
    assert table.height == table["participant"].n_unique() == 77
    counts = dict(table.group_by("trial", "choice").len().select(pl.concat_str("trial", "choice"), "len").iter_rows())
    assert counts == {
        "controlleft": 19, "controlright": 21,
        "experimentalL": 15, "experimentalR1": 5, "experimentalR2": 12, "experimentalR3": 5,
    }  # fmt: skip


def test_the_split_is_the_only_one_that_gives_the_papers_statistics() -> None:
    boltzmann = np.array([19, 21, 21, 21]) / 82
    less = np.array([0.475, 0.175, 0.175, 0.175])
    fits = []
    for left in range(38):
        for r1 in range(38 - left):
            for r2 in range(38 - left - r1):
                counts = [left, r1, r2, 37 - left - r1 - r2]
                if (
                    counts[2] == max(counts[1:])
                    and round(left / 37, 2) == 0.41
                    and round(chi_square_test(counts, boltzmann).statistic, 2) == 9.72
                    and round(chi_square_test(counts, less).statistic, 2) == 5.76
                    # chi-square sees only the sum of squares, which 3, 11, 8 shares; epsilon tells them apart
                    and round(wellek_minimum_epsilon(counts, boltzmann), 2) == 0.36
                    and round(wellek_minimum_epsilon(counts, less), 2) == 0.29
                ):
                    fits.append(counts)
    assert fits == [[15, 5, 12, 5]]


# the reference numbers are computed from the counts with scipy.stats.chisquare and Wellek's formula by hand
@pytest.mark.parametrize(
    ("comparison", "model", "chi_square", "df", "p_value", "epsilon"),
    [
        ("groups", "boltzmann", 6.2708, 1, 0.0123, 0.3906),
        ("groups", "less", 0.7186, 1, 0.3966, 0.2160),
        ("options", "boltzmann", 9.7183, 3, 0.0211, 0.3582),
        ("options", "less", 5.7637, 3, 0.1237, 0.2883),
    ],
)
def test_published_numbers(
    study: HumanChoiceStudy, comparison: str, model: str, chi_square: float, df: int, p_value: float, epsilon: float
) -> None:
    row = study.tests.filter(comparison=comparison, model=model).row(0, named=True)
    assert row["chi_square"] == pytest.approx(chi_square, abs=6e-5)
    assert row["degrees_of_freedom"] == df
    assert row["p_value"] == pytest.approx(p_value, abs=6e-5)
    assert row["minimum_epsilon"] == pytest.approx(epsilon, abs=6e-5)
    assert row["n"] == 37


def test_predictions(study: HumanChoiceStudy) -> None:
    left = study.predictions.filter(comparison="groups", group="left")
    assert dict(left.select("model", "predicted").iter_rows()) == pytest.approx(
        {"boltzmann": 19 / 82, "less": 0.475}, rel=1e-14
    )
    assert left["observed"].to_list() == [15 / 37] * 2
    sums = study.predictions.group_by("comparison", "model").agg(pl.col("observed", "predicted").sum())
    assert sums.select("observed", "predicted").to_numpy() == pytest.approx(np.ones((6, 2)), abs=1e-12)
    within = study.predictions.filter(comparison="within")
    assert within["predicted"].to_numpy() == pytest.approx(np.full(6, 1 / 3), rel=1e-12)
    assert within["option"].to_list() == ["R1", "R2", "R3"] * 2


def test_attribute_rule_predicts_what_less_does(study: HumanChoiceStudy) -> None:
    reward = np.log([[19 / 40], [21 / 40], [21 / 40], [21 / 40]])
    location = np.array([[0.0], [1.0], [1.0], [1.0]])
    p = np.exp(log_probabilities(AttributeRule(), reward, [1.0], similarity=location))
    less = study.predictions.filter(comparison="options", model="less")
    assert less["predicted"].to_numpy() == pytest.approx(p, rel=1e-14)


def test_comparison_with_the_paper(study: HumanChoiceStudy) -> None:
    table = compare_with_paper(study)
    disagreeing = table.filter(~pl.col("agrees"))
    assert disagreeing.select("quantity", "comparison", "printed", "value").rows() == [
        ("degrees_of_freedom", "options", "1", 3.0),
        ("degrees_of_freedom", "options", "1", 3.0),
    ]
    assert disagreeing["note"].str.contains("misprint").all()
    assert table.height == 18


def test_other_groups_and_labels() -> None:
    result = analyse_choices(choices(*CONTROL, *EXPERIMENTAL))
    assert result.control.rows() == [("A", 6, 0.6), ("B", 3, 0.3), ("C", 1, 0.1)]
    groups = result.predictions.filter(comparison="groups")
    less = groups.filter(model="less")["predicted"].to_numpy()
    assert less == pytest.approx([0.6, 0.3, 0.1], rel=1e-13)
    boltzmann = groups.filter(model="boltzmann")["predicted"].to_numpy()
    assert boltzmann == pytest.approx(np.array([0.6, 0.6, 0.1]) / 1.3, rel=1e-13)
    assert result.tests["degrees_of_freedom"].to_list() == [2, 2, 3, 3]


def test_an_option_that_nobody_chose() -> None:
    table = choices(*CONTROL, *EXPERIMENTAL)
    result = analyse_choices(table, options={"A": ["a"], "B": ["b1", "b2", "b3"], "C": ["c"]})
    row = result.predictions.filter(comparison="options", option="b3", model="boltzmann").row(0, named=True)
    assert (row["count"], row["observed"]) == (0, 0.0)
    assert row["predicted"] == pytest.approx(0.3 / 1.6, rel=1e-13)
    without_b = table.filter(~((pl.col("trial") == "experimental") & (pl.col("group") == "B")))
    result = analyse_choices(without_b, options={"A": ["a"], "B": ["b1", "b2"], "C": ["c"]})
    assert result.predictions.filter(comparison="within", group="B")["observed"].null_count() == 4


def test_the_order_of_rows_does_not_matter() -> None:
    table = choices(*CONTROL, *EXPERIMENTAL)
    first, second = analyse_choices(table), analyse_choices(table.reverse())
    assert first.predictions.equals(second.predictions)
    assert first.tests.equals(second.tests)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (choices(*CONTROL).drop("group"), "lacks the column 'group'; it has participant, trial, choice"),
        (choices(*CONTROL).with_columns(choice=pl.lit(None, dtype=pl.String)), "no 'choice' in row 1"),
        (choices(*CONTROL, ("pilot", "a", "A", 1)), "the trial 'pilot'; allowed are control, experimental"),
        (choices(*CONTROL).with_columns(participant=pl.lit(7)), "participant 7 has more than one row"),
        (choices(*CONTROL, ("control", "b9", "B", 1)), "the group 'B' has the options b, b9"),
        (choices(CONTROL[0], *EXPERIMENTAL), "the control trial has 1 groups"),
        (choices(*CONTROL, *EXPERIMENTAL[:3]), "the group 'C' has no option in the experimental trial"),
        (choices(*CONTROL, *EXPERIMENTAL, ("experimental", "d", "D", 1)), "nobody chose the group 'D' in the control"),
        (choices(*CONTROL, *EXPERIMENTAL, ("experimental", "b1", "A", 1)), "'b1' appears more than once"),
    ],
)
def test_refusals(table: pl.DataFrame, message: str) -> None:
    with pytest.raises(TableError, match=message):
        analyse_choices(table)


def test_refusals_with_options() -> None:
    table = choices(*CONTROL, *EXPERIMENTAL)
    with pytest.raises(TableError, match="the choice 'b2' of the group 'B' is not among the options"):
        analyse_choices(table, options={"A": ["a"], "B": ["b1"], "C": ["c"]})
    only_control = choices(*CONTROL)
    with pytest.raises(TableError, match="no row of the experimental trial"):
        analyse_choices(only_control, options={"A": ["a"], "B": ["b"], "C": ["c"]})
    with pytest.raises(ArgumentError, match="alpha is 0"):
        analyse_choices(table, alpha=0.0)


def test_somebody_elses_choices_are_not_compared_with_the_paper() -> None:
    rows = [("control", "a", "A"), ("control", "b", "B"), ("experimental", "a", "A"), ("experimental", "b", "B")]
    table = pl.DataFrame(
        [(i, *row) for i, row in enumerate(rows)], schema=["participant", "trial", "choice", "group"], orient="row"
    )
    with pytest.raises(TableError, match="not the paper's choices; set it to false"):
        compare_with_paper(analyse_choices(table))
    with pytest.raises(TableError, match="no row of the experimental trial"):
        analyse_choices(table.head(2))
