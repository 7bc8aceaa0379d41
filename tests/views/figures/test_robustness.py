"""The figures of the robustness study show what the tables say, legibly, and as the same bytes every time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.views.figures.robustness import (
    accuracy_figure,
    duplicates_figure,
    importance_figure,
    kl_figure,
    sensitivity_figure,
    two_posteriors_figure,
)
from pipeline.views.figures.style import model_color, write_figure
from tests.support.drawn_text import unreadable

VALUES = {"boltzmann": 3.0, "less": 2.0, "boltzmann-weighted": 50.0, "less-clean-bandwidth": 1.0}
BOTH, REGIMES = ("boltzmann", "less"), ["independent", "sampler-shift"]
SIZES = [10, 30, 100, 300, 1000]
LABELS = [f"½ efficiency + table + {k} laptop" for k in range(19)]


def points(models: tuple[str, ...], **columns: list[object]) -> pl.DataFrame:
    """One row per model, kind and combination of the columns' values."""
    table = pl.DataFrame({"model": models}).join(pl.DataFrame({"demonstrations": ["single", "batch"]}), how="cross")
    for name, values in columns.items():
        table = table.join(pl.DataFrame({name: values}), how="cross")
    value = pl.col("model").replace_strict(VALUES, return_dtype=pl.Float64)
    return table.with_columns(value=value * (pl.int_range(pl.len()) + 1)).with_columns(
        low=pl.when(demonstrations="single").then(pl.col("value") / 2),
        high=pl.when(demonstrations="single").then(pl.col("value") * 2),
    )


def accuracies(regimes: list[object]) -> pl.DataFrame:
    table = points(
        BOTH, measure=["map_angle_rad", "true_posterior", "truth_to_grid_rad"], regime=regimes, set_size=SIZES
    )
    return table.with_columns(pl.col("value", "low", "high") / 1000)


def summary() -> pl.DataFrame:
    return points((*BOTH, "boltzmann-weighted"), regime=[*REGIMES, "known-density"], set_size=SIZES)


def sets() -> pl.DataFrame:
    rows = [(size, share * size) for size in SIZES for share in (0.1, 0.3, 0.8)]
    return pl.DataFrame(rows, schema=["set_size", "effective_sample_size"], orient="row").vstack(
        pl.DataFrame(
            {"set_size": [10], "effective_sample_size": [None]}, schema_overrides={"effective_sample_size": float}
        )
    )


def settings(largest: float = 1.0) -> pl.DataFrame:
    chosen = {
        "bandwidth": ["0.25", "1"],
        "selector": ["leave-one-out", "literal"],
        "beta": ["marginal", "joint", "0.01"],
    }
    table = pl.DataFrame(
        [(choice, setting) for choice in chosen for setting in chosen[choice]],
        schema=["choice", "setting"],
        orient="row",
    )
    table = points(BOTH, regime=list(REGIMES), set_size=[1000]).drop("low", "high").join(table, how="cross")
    return table.with_columns(
        is_default=pl.col("setting").is_in(["1", "leave-one-out", "marginal"]),
        value=pl.when(setting="0.01").then(1e-9).otherwise(pl.col("value") * largest),
        low=pl.lit(None, pl.Float64),
        high=pl.lit(None, pl.Float64),
    )


def changed() -> pl.DataFrame:
    return settings().with_columns(value=pl.when(is_default=True).then(0.0).otherwise(0.3))


def two_posteriors() -> Figure:
    rows = pl.DataFrame({"model": BOTH}).join(pl.DataFrame({"regime": REGIMES}), how="cross")
    rows = rows.join(pl.DataFrame({"set_id": ["a", "b", "c"]}), how="cross").join(
        pl.DataFrame({"theta_id": range(19)}), how="cross"
    )
    rows = rows.with_columns(
        posterior=(pl.int_range(pl.len()) + 1) / pl.len(), demonstration_id=pl.lit("ana-2"), set_size=pl.lit(1000)
    )
    return two_posteriors_figure(rows, {"independent": ("a", "c"), "sampler-shift": ("b", "c")}, LABELS, "weights")


FIGURES: dict[str, Callable[[], Figure]] = {
    "robustness": lambda: kl_figure(summary()),
    "importance": lambda: importance_figure(summary(), accuracies(["known-density"]), sets()),
    "importance_without_truth": lambda: importance_figure(summary(), accuracies(["known-density"]).clear(), sets()),
    "accuracy": lambda: accuracy_figure(accuracies(list(REGIMES)), 19),
    "two_posteriors": two_posteriors,
    "duplicates": lambda: duplicates_figure(
        points((*BOTH, "less-clean-bandwidth"), copies=[1, 3, 10, 30], spread=[0.0, 0.001, 0.01, 0.03, 0.1])
    ),
    "sensitivity": lambda: sensitivity_figure(settings(), changed()),
}


def curve(ax: Axes, place: int) -> np.ndarray:
    return np.asarray(ax.get_lines()[place].get_ydata(), dtype=float)


@pytest.mark.parametrize("name", FIGURES)
def test_the_same_tables_give_the_same_bytes(name: str, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write_figure(tmp_path / folder, name, FIGURES[name]())
    for kind in ("svg", "png"):
        first, second = ((tmp_path / folder / f"{name}.{kind}").read_bytes() for folder in ("a", "b"))
        assert first == second, kind


@pytest.mark.parametrize("name", FIGURES)
def test_all_text_can_be_read(name: str) -> None:
    assert unreadable(FIGURES[name]()) == []


def test_divergence_against_size() -> None:
    table = summary()
    figure = kl_figure(table, ("sampler-shift", "known-density"))
    cells = [(kind, regime) for kind in ("single", "batch") for regime in ("sampler-shift", "known-density")]
    for axes, (kind, regime) in zip(figure.axes, cells, strict=True):
        assert axes.get_yscale() == "log"
        for place, model in enumerate(("boltzmann", "less", "boltzmann-weighted")):
            rows = table.filter(model=model, demonstrations=kind, regime=regime)
            np.testing.assert_array_equal(curve(axes, place), rows["value"])
            np.testing.assert_allclose(axes.get_lines()[place].get_xdata(), rows["set_size"], rtol=0.07)
        bars = axes.collections[0].get_segments()
        assert len(bars) == (5 if kind == "single" else 0)
        if bars:
            np.testing.assert_allclose(
                bars[0][:, 1], table.filter(demonstrations=kind, regime=regime)["value"][0] * np.array([0.5, 2])
            )


def test_an_interval_without_end_leaves_the_values_visible() -> None:
    table = summary().with_columns(high=pl.when(model="less", set_size=1000).then(1e300).otherwise("high"))
    bottom, top = kl_figure(table).axes[0].get_ylim()
    values = table.filter(pl.col("regime") != "known-density")["value"]
    assert bottom < values.min()
    assert values.max() < top <= 10 * values.max()


def test_importance_weights_and_how_many_count() -> None:
    figure = FIGURES["importance"]()
    titles = [ax.get_title("left") for ax in figure.axes]
    assert titles == ["single demonstrations", "all together", "single demonstrations", "the weights"]
    known = summary().filter(regime="known-density", demonstrations="batch", model="boltzmann-weighted")
    np.testing.assert_array_equal(curve(figure.axes[1], 2), known["value"])
    each, median, everything = (curve(figure.axes[3], place) for place in range(3))
    assert each.size == 15
    np.testing.assert_allclose(median, 0.3 * np.array(SIZES))
    np.testing.assert_array_equal(everything, SIZES)
    assert len(FIGURES["importance_without_truth"]().axes) == 3


def test_accuracy_is_in_degrees_beside_chance_and_the_best_there_is() -> None:
    table = accuracies(list(REGIMES))
    figure = accuracy_figure(table, 19)
    assert len(figure.axes) == 8
    rows = table.filter(demonstrations="batch", regime="sampler-shift", model="less")
    np.testing.assert_allclose(curve(figure.axes[3], 1), np.degrees(rows.filter(measure="map_angle_rad")["value"]))
    best = table.filter(demonstrations="batch", regime="sampler-shift", measure="truth_to_grid_rad")["value"][0]
    assert curve(figure.axes[3], 2)[0] == pytest.approx(np.degrees(best))
    np.testing.assert_allclose(curve(figure.axes[7], 1), rows.filter(measure="true_posterior")["value"])
    assert curve(figure.axes[7], 2)[0] == pytest.approx(1 / 19)
    for ax in figure.axes:
        assert ax.get_ylim()[0] == 0
        assert ax.get_ylim()[1] >= max(curve(ax, place).max() for place in range(3))


def test_two_posteriors() -> None:
    figure = two_posteriors()
    # rows are models, then regimes, then sets, 19 thetas each; the ten with the largest probability have a row
    starts = [[0, 38], [76, 95], [114, 152], [190, 209]]
    for axes, pair in zip(figure.axes, starts, strict=True):
        lengths = [bar.get_width() for bar in axes.patches]
        expected = [(start + k + 1) / 228 for start in pair for k in range(18, 8, -1)]
        np.testing.assert_allclose(lengths, expected, rtol=1e-12)
        faces = [bar.get_facecolor() for bar in axes.patches]
        assert faces[0] == axes.patches[0].get_edgecolor(), "full"
        assert faces[10] == (1.0, 1.0, 1.0, 1.0), "empty"
    assert figure.axes[0].get_yticklabels()[0].get_text() == LABELS[18]
    assert len(figure.axes[0].get_yticklabels()) == 10
    assert figure.axes[2].get_xlabel() == "posterior (the other 9 not shown)"
    assert figure.axes[0].get_xlim()[1] >= 228 / 228, "what the largest needs"
    assert figure.axes[1].get_title("left").endswith("full: set b,\nempty: set c")
    assert figure.get_suptitle() == "demonstration ana-2, sets of 1,000 alternatives"


def test_an_interval_that_leaves_its_panel_has_an_arrow() -> None:
    ends = pl.when(model="less", set_size=1000)
    table = summary().with_columns(
        high=ends.then(1e300).otherwise("high"), low=ends.then(1e-300).otherwise(pl.col("low"))
    )
    for figure, panel in ((kl_figure(table), 0), (importance_figure(table, accuracies(["known-density"]), sets()), 0)):
        axes = figure.axes[panel]
        arrows = [line for line in axes.get_lines() if line.get_marker() in ("v", "^") and len(line.get_xdata()) == 1]
        bottom, top = axes.get_ylim()
        assert {(line.get_marker(), float(line.get_ydata()[0])) for line in arrows} >= {("v", bottom), ("^", top)}
        shades = {tuple(line.get_color()[:3]) for line in arrows}
        assert shades == {model_color("less", ("less",))}


def test_panels_that_stand_side_by_side_have_one_scale() -> None:
    for name in ("robustness", "accuracy", "duplicates", "two_posteriors"):
        figure = FIGURES[name]()
        columns = figure.axes[0].get_subplotspec().get_gridspec().ncols
        for start in range(0, len(figure.axes), columns):
            assert len({axes.get_ylim() for axes in figure.axes[start : start + columns]}) == 1, name
    for name in ("robustness", "duplicates"):
        assert len({axes.get_ylim() for axes in FIGURES[name]().axes}) == 1, "also one above the other"


def test_plain_and_weighted_boltzmann_differ() -> None:
    lines = {str(line.get_label()): line for line in FIGURES["importance"]().axes[0].get_lines()}
    plain, weighted = lines["Boltzmann"], lines["Boltzmann, importance weights"]
    assert plain.get_color() != weighted.get_color()
    assert plain.get_marker() != weighted.get_marker()


def test_duplicates_have_a_column_per_spread() -> None:
    table = points((*BOTH, "less-clean-bandwidth"), copies=[1, 10], spread=[0.0, 0.1])
    figure = duplicates_figure(table)
    assert [ax.get_title("left") for ax in figure.axes[:2]] == ["exact copies", "spread 0.1"]
    rows = table.filter(pl.col("spread") == 0.1, model="less-clean-bandwidth", demonstrations="batch")
    np.testing.assert_array_equal(curve(figure.axes[3], 2), rows["value"])


def test_sensitivity_marks_the_studys_own_and_what_is_beyond() -> None:
    table = settings()
    figure = sensitivity_figure(table, changed())
    for ax, regime in zip(figure.axes[:2], REGIMES, strict=True):
        marks = [line for line in ax.get_lines() if line.get_marker() in ("o", "s", "<")]
        rows = table.filter(demonstrations="single", regime=regime)
        assert [line.get_markerfacecolor() != "white" for line in marks] == rows["is_default"].to_list()
        assert [line.get_marker() == "<" for line in marks] == (rows["setting"] == "0.01").to_list()
        shown = [float(line.get_xdata()[0]) for line in marks if line.get_marker() != "<"]
        assert shown == rows.filter(pl.col("setting") != "0.01")["value"].to_list()
    answers = figure.axes[2]
    assert answers.get_title("left").startswith("all together")
    marks = [float(line.get_xdata()[0]) for line in answers.get_lines() if line.get_marker() in ("o", "s")]
    assert marks == changed().filter(demonstrations="batch", regime="independent")["value"].to_list()
    assert figure.legends[0].get_title().get_text() == "one setting changed at a time, sets of 1,000 alternatives"
