"""What the robustness figures show beyond the tables."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy.special import stdtrit

from pipeline.views.robustness import ACCURACY, POINT, accuracy, changed_answers, example, middle_size, per_pair


def robustness(truth: bool = True) -> pl.DataFrame:
    angles = [0.1, 0.5, 0.2, 0.3]
    return pl.DataFrame(
        {
            "regime": "independent", "model": "less", "set_size": 10, "demonstration_id": ["a", "b", "c", "all"],
            "participant": ["a", "b", "c", "all"], "kl_low": 100.0, "kl_high": 200.0,
            "map_angle_rad": angles, "true_posterior": [0.2, 0.4, 0.9, 0.7] if truth else [None] * 4,
            "truth_to_grid_rad": [0.05] * 4, "map_changed": [1.0, 0.5, 0.0, 0.25], "sets": 4,
        },
        schema_overrides={"true_posterior": pl.Float64},
    )  # fmt: skip


def test_accuracy_has_medians_and_all_together_without_the_interval_of_another_measure() -> None:
    table = accuracy(robustness())
    assert table["measure"].unique(maintain_order=True).to_list() == list(ACCURACY)
    values = {(row["measure"], row["demonstrations"]): row["value"] for row in table.iter_rows(named=True)}
    assert values["map_angle_rad", "single"] == 0.2
    assert values["true_posterior", "single"] == 0.4
    assert values["true_posterior", "batch"] == 0.7
    assert values["map_angle_rad", "batch"] == 0.3
    assert table["low"].null_count() == table["high"].null_count() == table.height


def test_nothing_is_said_about_accuracy_where_no_truth_is_known() -> None:
    table = accuracy(robustness(truth=False))
    assert table.is_empty()
    assert {"measure", "regime", "model", "set_size"} <= set(table.columns)


def test_accuracy_of_all_together_has_an_interval_over_the_sets() -> None:
    # three thetas at 0, 60 and 90 degrees to the truth, and four sets of which one errs by 60
    thetas = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)], [0.0, 1.0]])
    probability = [[0.6, 0.3, 0.1], [0.8, 0.1, 0.1], [0.3, 0.6, 0.1], [0.7, 0.2, 0.1]]
    rows = [
        ("independent", "less", 10, f"{number}", theta_id, thetas[theta_id].tolist(), p)
        for number, of_set in enumerate(probability)
        for theta_id, p in enumerate(of_set)
    ]
    names = ["regime", "model", "set_size", "set_id", "theta_id", "theta", "posterior"]
    together = pl.DataFrame(rows, schema=names, orient="row").with_columns(pl.col("theta").list.to_array(2))
    table = accuracy(robustness(), together, np.array([1.0, 0.0]))
    batch = {row["measure"]: row for row in table.filter(demonstrations="batch").iter_rows(named=True)}
    half = float(stdtrit(3, 0.975)) * np.std([0.6, 0.8, 0.3, 0.7], ddof=1) / 2
    assert batch["true_posterior"]["low"] == pytest.approx(0.6 - half)
    assert batch["true_posterior"]["high"] == pytest.approx(0.6 + half)
    assert batch["map_angle_rad"]["low"] == 0.0, "no angle is below zero"
    third = np.pi / 3
    assert batch["map_angle_rad"]["high"] == pytest.approx(third / 4 + float(stdtrit(3, 0.975)) * third / 4)
    assert table.filter(demonstrations="single")["low"].null_count() == len(ACCURACY)


def test_a_pair_of_sets_reads_the_same_whatever_the_number_of_sets() -> None:
    points = pl.DataFrame(
        {"regime": ["independent"], "model": ["less"], "set_size": [10], "value": [24.0], "low": [12.0], "high": [None],
         "mean": [36.0]}, schema_overrides={"high": pl.Float64}
    )  # fmt: skip
    found = per_pair(points, robustness(), POINT)
    assert found.columns == points.columns
    assert found.select("value", "low", "high", "mean").row(0) == (2.0, 1.0, None, 3.0)  # 4 sets have 12 ordered pairs


def test_changed_answers_are_those_of_all_together() -> None:
    sensitivity = robustness().with_columns(choice=pl.lit("beta"), setting=pl.lit("joint"), is_default=pl.lit(False))
    table = changed_answers(sensitivity)
    assert table.select("setting", "demonstrations", "value", "low", "high").rows() == [
        ("joint", "batch", 0.25, None, None)
    ]


def test_the_example_is_the_first_demonstration_with_the_outer_sets() -> None:
    sizes = pl.DataFrame({"set_size": [1000, 10, 100, 300, 30]})
    assert middle_size(sizes) == 100
    rows = [
        (regime, size, set_id, person, 0.5)
        for regime, ids in (("independent", ("00", "01", "02")), ("sampler-shift", ("z", "m", "a")))
        for size in (10, 30, 100)
        for set_id in ids
        for person in ("p", "q", "all")
    ]
    names = ["regime", "set_size", "set_id", "demonstration_id", "posterior"]
    shown = example(pl.DataFrame(rows, schema=names, orient="row"))
    assert (shown.demonstration_id, shown.set_size) == ("p", 30)
    assert shown.set_ids == {"independent": ("00", "02"), "sampler-shift": ("z", "a")}
    assert shown.posteriors.height == 6
    assert shown.posteriors["posterior"].sum() == pytest.approx(3.0)
