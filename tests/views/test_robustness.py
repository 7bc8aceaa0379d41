"""What the robustness figures show beyond the tables."""

from __future__ import annotations

import polars as pl
import pytest

from pipeline.views.robustness import ACCURACY, accuracy, entropies, example, middle_size


def robustness(truth: bool = True) -> pl.DataFrame:
    angles = [0.1, 0.5, 0.2, 0.3]
    return pl.DataFrame(
        {
            "regime": "independent", "model": "less", "set_size": 10, "demonstration_id": ["a", "b", "c", "all"],
            "participant": ["a", "b", "c", "all"], "kl_low": 100.0, "kl_high": 200.0,
            "map_angle_rad": angles, "true_posterior": [0.2, 0.4, 0.9, 0.7] if truth else [None] * 4,
            "truth_to_grid_rad": [0.05] * 4, "entropy": [1.0, 3.0, 2.0, 0.5],
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


def test_entropies_leave_out_joint_posteriors() -> None:
    sensitivity = pl.concat(
        [
            robustness().with_columns(
                choice=pl.lit("beta"), setting=pl.lit(name), is_default=pl.lit(name == "marginal")
            )
            for name in ("marginal", "joint")
        ]
    )
    table = entropies(sensitivity)
    assert table.select("setting", "demonstrations", "value").rows() == [
        ("marginal", "single", 2.0),
        ("marginal", "batch", 0.5),
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
