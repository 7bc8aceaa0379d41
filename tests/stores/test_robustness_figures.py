"""The figures show what the tables say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

from pipeline.stores.figures import write_figure
from pipeline.stores.robustness_figures import duplicates_figure, kl_figure, sensitivity_figure, two_posteriors_figure

VALUES = {"boltzmann": 3.0, "less": 2.0, "boltzmann-weighted": 50.0, "less-clean-bandwidth": 1.0}


def points(models: tuple[str, ...], **columns: list[object]) -> pl.DataFrame:
    """One row per model, kind and combination of the columns' values."""
    table = pl.DataFrame({"model": models}).join(pl.DataFrame({"demonstrations": ["single", "batch"]}), how="cross")
    for name, values in columns.items():
        table = table.join(pl.DataFrame({name: values}), how="cross")
    value = pl.col("model").replace_strict(VALUES, return_dtype=pl.Float64)
    return table.with_columns(
        value=value * (pl.int_range(pl.len()) + 1),
        low=pl.when(demonstrations="single").then(0.5 * value),
        high=pl.when(demonstrations="single").then(500 * value),
    )


def test_aggregate_against_size() -> None:
    table = points(
        ("boltzmann", "less", "boltzmann-weighted"), regime=["sampler-shift", "known-density"], set_size=[10, 100]
    )
    figure = kl_figure(table, ("sampler-shift", "known-density"))
    assert len(figure.axes) == 4
    for axes, kind, regime in zip(
        figure.axes, ("single", "single", "batch", "batch"), ("sampler-shift", "known-density") * 2, strict=True
    ):
        for line, model in zip(axes.get_lines(), ("boltzmann", "less", "boltzmann-weighted"), strict=True):
            rows = table.filter(model=model, demonstrations=kind, regime=regime)
            np.testing.assert_array_equal(line.get_ydata(), rows["value"])
            np.testing.assert_allclose(line.get_xdata(), rows["set_size"], rtol=0.13)
        assert len(axes.collections[0].get_segments()) == (2 if kind == "single" else 0)


def test_two_posteriors() -> None:
    rows = pl.DataFrame({"model": ["boltzmann", "less"]}).join(pl.DataFrame({"set_id": ["a", "b", "c"]}), how="cross")
    rows = rows.join(pl.DataFrame({"theta_id": [0, 1]}), how="cross").with_columns(
        demonstration_id=pl.lit("d"), set_size=100, posterior=pl.int_range(12) / 12.0
    )
    figure = two_posteriors_figure(rows, "d", 100, ("a", "c"), ("near", "far"))
    heights = [[bar.get_height() for bar in axes.patches] for axes in figure.axes]
    np.testing.assert_allclose(heights, np.array([[0, 1, 4, 5], [6, 7, 10, 11]]) / 12, rtol=1e-15)


def test_duplicates() -> None:
    table = points(("boltzmann", "less", "less-clean-bandwidth"), copies=[1, 10], spread=[0.0, 0.1])
    figure = duplicates_figure(table)
    assert [axes.get_title("left") for axes in figure.axes] == ["exact copies", "spread 0.1"]
    rows = table.filter(pl.col("spread") == 0.1, model="less", demonstrations="single")
    np.testing.assert_array_equal(figure.axes[1].get_lines()[1].get_ydata(), rows["value"])


def test_sensitivity_and_its_bytes(tmp_path: Path) -> None:
    table = points(
        ("boltzmann", "less"), choice=["beta"], setting=["marginal", "10"], regime=["independent"], set_size=[30]
    )
    table = table.with_columns(is_default=pl.col("setting") == "marginal")
    figure = sensitivity_figure(table, "independent", 30)
    marks = [line for line in figure.axes[0].get_lines() if line.get_marker() == "o"]
    assert [line.get_markerfacecolor() == "white" for line in marks] == [False, True, False, True]
    assert [float(line.get_xdata()[0]) for line in marks] == table.filter(demonstrations="single")["value"].to_list()
    for name in ("one", "two"):
        write_figure(tmp_path / name, "figure", sensitivity_figure(table, "independent", 30))
    for ending in ("svg", "png"):
        assert (tmp_path / "one" / f"figure.{ending}").read_bytes() == (
            tmp_path / "two" / f"figure.{ending}"
        ).read_bytes()
