"""The figures of the grid-world study: how well each model infers the truth, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import polars as pl
from matplotlib.colors import PowerNorm
from matplotlib.lines import Line2D

from pipeline.studies.grid_world.trials import THETAS
from pipeline.views import palette
from pipeline.views.figures.style import (
    COLUMN,
    INK,
    TEXT,
    color,
    error_bars,
    in_style,
    lying_bars,
    model_bars,
    new_figure,
    probability_axis,
    sequential_map,
    small,
)
from pipeline.views.intervals import near_or_far, path_shifts
from pipeline.vocabulary import BOLTZMANN, LESS, LESS_HIDDEN, LESS_HIDDEN_OWN_BANDWIDTH, model_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Place = Literal["outside upper left", "outside upper right"]
BEST = {"Xi_L": model_name(LESS), "Xi_B": model_name(BOLTZMANN)}
"""The model that leads most, by set."""
SETS = {"Xi_L": ("$\\Xi_L$", "o"), "Xi_B": ("$\\Xi_B$", "D")}
_PEOPLE = (LESS, BOLTZMANN, LESS_HIDDEN, LESS_HIDDEN_OWN_BANDWIDTH)
_APART = 0.17  # largest distance between neighbouring paths, in cells


@in_style
def true_posterior_figure(summary: pl.DataFrame) -> Figure:
    """TruePosterior for each theta and over all of them, with a row of panels per sampling model.

    Args:
        summary: the table `grid_world_summary` with `low` and `high`, the 95 % interval of the mean.
    """
    figure = new_figure(TEXT, 3.5)
    axes = figure.subplots(2, 2, sharex="col", sharey=True, width_ratios=[8.4, 1.0])
    models = summary["inference_model"].unique(maintain_order=True).to_list()
    wishes = ["\n".join(words) for words in near_or_far(THETAS)]
    for (by_theta, over_all), people in zip(axes, (LESS, BOLTZMANN), strict=True):
        rows = summary.filter(sampling_model=people)
        _grouped_bars(by_theta, [rows.filter(theta_id=k) for k in range(len(THETAS))], models, wishes)
        _grouped_bars(over_all, [rows.filter(pl.col("theta_id").is_null())], models, ["all"])
        sets = int(rows.filter(pl.col("theta_id").is_not_null())["sets"].max() or 0)  # type: ignore[arg-type]
        by_theta.set_title(f"people choose by {model_name(people)}: mean of {sets} sets, 95 % interval")
        probability_axis(by_theta, "TruePosterior")
        over_all.grid(axis="y")
    axes[1, 0].set_xlabel("true $\\theta$: what the people want")
    _robot_legend(figure, axes[0, 0])
    return figure


@in_style
def overall_figure(summary: pl.DataFrame) -> Figure:
    """Mean TruePosterior over all thetas for every sampling model, including those with hidden features.

    Args:
        summary: the table `grid_world_summary` with `low` and `high`, the 95 % interval of the mean.
    """
    figure = new_figure(COLUMN, 2.3)
    ax = figure.subplots()
    models = summary["inference_model"].unique(maintain_order=True).to_list()
    overall = summary.filter(pl.col("theta_id").is_null())
    _grouped_bars(
        ax, [overall.filter(sampling_model=name) for name in _PEOPLE], models, [_people(name) for name in _PEOPLE]
    )
    probability_axis(ax, "TruePosterior", None)
    ax.set_title("mean over all $\\theta$, 95 % interval")
    ax.set_xlabel("people choose by")
    figure.legend(
        *ax.get_legend_handles_labels(), loc="outside upper left", ncols=len(models), title="robot infers by",
        alignment="left", columnspacing=0.8, borderaxespad=0.1,
    )  # fmt: skip
    return figure


@in_style
def sets_figure(paths: pl.DataFrame, posteriors: pl.DataFrame, objects: Sequence[tuple[int, int]], size: int) -> Figure:
    """The two sets of demonstrations on the grid, and the posteriors of each model of inference (section 4.2).

    Args:
        paths: the table `grid_world_paths`.
        posteriors: the table `grid_world_posteriors`.
        objects: cells of the two objects.
        size: number of cells per side.
    """
    figure = new_figure(TEXT, 2.35)
    grids_and_charts = figure.subplots(1, 4, width_ratios=[1.9, 1.9, 1, 1])
    for place, (name, (symbol, _)) in enumerate(SETS.items()):
        grid, chart = grids_and_charts[place], grids_and_charts[place + 2]
        of_set = paths.filter(set=name)
        _grid(grid, of_set, objects, size, color(palette.SETS[name]))
        grid.set_title(
            f"{symbol}: where {BEST[name]} infers best\n(people choose by {model_name(of_set['sampling_model'][0])})"
        )
        _posterior_bars(chart, posteriors.filter(set=name), named=place == 0)
        chart.set_title(f"inferred from {symbol}")
    _robot_legend(figure, grids_and_charts[2], "outside upper right")
    return figure


@in_style
def density_figure(paths: pl.DataFrame, density_1d: pl.DataFrame, density_2d: pl.DataFrame) -> Figure:
    """The density of all paths along each feature, with equal weights and those of LESS, and over both features.

    Args:
        paths: the table `grid_world_paths`.
        density_1d: the table `grid_world_density_1d`.
        density_2d: the table `grid_world_density_2d`.
    """
    figure = new_figure(TEXT, 2.3)
    axes = figure.subplots(1, 3, width_ratios=[1, 1, 1.15])
    top = float(density_1d.select(pl.max_horizontal(pl.col("raw", "adjusted").max())).item())
    for feature, ax in ((1, axes[0]), (2, axes[1])):
        _density_1d(ax, density_1d.filter(feature=feature), paths, feature, top)
    axes[0].set_ylabel("density of paths")
    _density_2d(figure, axes[2], density_2d, paths)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    return figure


def _people(model: str) -> str:
    """The name of a model of people for an axis, with the remark on its bandwidth on a second line."""
    return "\n".join(model_name(model).replace("σ", "$\\sigma$").rsplit(", ", 1))


def _grouped_bars(ax: Axes, groups: Sequence[pl.DataFrame], models: Sequence[str], names: Sequence[str]) -> None:
    """A group of bars for each table, in it a bar per inference model with the interval of its mean."""
    width = 0.84 / len(models)
    place = np.arange(len(groups))
    for offset, model in enumerate(models):
        rows = pl.concat([group.filter(inference_model=model) for group in groups])
        x = place + (offset - (len(models) - 1) / 2) * width
        mean = rows["true_posterior"].to_numpy()
        model_bars(ax, x, mean, width, model, models, label=model_name(model))
        reach = np.stack([mean - rows["low"].to_numpy(), rows["high"].to_numpy() - mean])
        error_bars(ax, x, mean, yerr=reach)
    ax.set_xticks(place, list(names))
    ax.tick_params(axis="x", length=0)
    ax.set_xlim(-0.6, len(groups) - 0.4)


def _robot_legend(figure: Figure, ax: Axes, place: Place = "outside upper left") -> None:
    handles, labels = ax.get_legend_handles_labels()
    invisible = Line2D([], [], linestyle="none")
    figure.legend([invisible, *handles], ["robot infers by", *labels], loc=place, ncols=len(labels) + 1)


def _grid(
    ax: Axes, paths: pl.DataFrame, objects: Sequence[tuple[int, int]], size: int, rgb: tuple[float, float, float]
) -> None:
    lines = np.arange(size + 1) - 0.5
    ax.hlines(lines, -0.5, size - 0.5, color="#e3e3e3", linewidth=0.5, zorder=1)
    ax.vlines(lines, -0.5, size - 0.5, color="#e3e3e3", linewidth=0.5, zorder=1)
    for shift, x, y in zip(path_shifts(paths.height, _APART), paths["x"], paths["y"], strict=True):
        ax.plot(x.to_numpy() + shift, y.to_numpy() - shift, color=rgb, linewidth=0.9, zorder=3, solid_joinstyle="round")
    box = {"boxstyle": "square,pad=0.25", "facecolor": "#4a4a4a", "edgecolor": "none"}
    for name, (x, y) in zip("AB", objects, strict=True):
        ax.text(x, y, name, color="white", ha="center", va="center", fontsize=small(), zorder=4, bbox=box)
    ends = (("start", 0, -0.75, "left", "top"), ("goal", size - 1, size - 0.25, "right", "bottom"))
    for word, cell, y, across, up in ends:
        ax.plot(cell, cell, marker="s", markersize=4.5, color=INK, zorder=4)
        ax.text(cell + (0.5 if across == "right" else -0.5), y, word, ha=across, va=up, fontsize=small())
    ax.set_aspect("equal")
    ax.set_xlim(-0.7, size - 0.3)
    ax.set_ylim(-1.4, size + 0.3)
    ax.set_axis_off()


def _posterior_bars(ax: Axes, rows: pl.DataFrame, *, named: bool) -> None:
    models = rows["inference_model"].unique(maintain_order=True).to_list()
    height = 0.8 / len(models)
    first = rows.filter(inference_model=models[0])
    place = np.arange(first.height)
    for offset, model in enumerate(models):
        values = rows.filter(inference_model=model)["posterior"]
        y = place + (offset - (len(models) - 1) / 2) * height
        lying_bars(ax, y, values.to_numpy(), height, model, models, label=model_name(model))
    thetas = first.select("theta_1", "theta_2").to_numpy()
    ax.set_yticks(place, [", ".join(words) if named else "" for words in near_or_far(thetas)])
    truth = int(first["is_true"].arg_max() or 0)
    ax.annotate(
        "true", (1.03, truth), ha="left", va="center", fontsize=small(), fontweight="bold",
    )  # fmt: skip
    ax.invert_yaxis()
    ax.tick_params(axis="y", length=0)
    ax.set_xlim(0, 1.4)
    ax.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    ax.set_xlabel("posterior of $\\theta$")


def _density_1d(ax: Axes, rows: pl.DataFrame, paths: pl.DataFrame, feature: int, top: float) -> None:
    edges = np.append(rows["low"].to_numpy(), rows["high"][-1])
    grey, orange = color(palette.RAW_DENSITY), color(palette.MODELS[LESS])
    ax.stairs(rows["raw"].to_numpy(), edges, fill=True, color=grey, alpha=0.55, label="every path alike")
    ax.stairs(rows["adjusted"].to_numpy(), edges, color=orange, linewidth=1.4, label="adjusted by LESS")
    for row, (name, (symbol, marker)) in enumerate(SETS.items(), 1):
        phi = paths.filter(set=name)[f"phi_{feature}"].to_numpy()
        y = np.full(phi.size, -0.075 * row * top)
        _marks(ax, phi, y, name, marker, symbol)
    ax.axhline(0, color=INK, linewidth=0.6)
    ax.set_ylim(-0.2 * top, 1.05 * top)
    ax.set_yticks([tick for tick in ax.get_yticks() if 0 <= tick <= top])
    ax.set_xlabel(_feature(feature))


def _density_2d(figure: Figure, ax: Axes, density: pl.DataFrame, paths: pl.DataFrame) -> None:
    rows = density.sort("phi_1_low", "phi_2_low")
    bins = rows.n_unique("phi_1_low")
    values = rows["raw"].to_numpy().reshape(bins, -1).T  # (phi_2, phi_1)
    left, right, bottom, top = rows.select(
        pl.col("phi_1_low").min(), pl.col("phi_1_high").max(), pl.col("phi_2_low").min(), pl.col("phi_2_high").max()
    ).row(0)
    image = ax.imshow(
        np.ma.masked_equal(values, 0.0), origin="lower", extent=(left, right, bottom, top), aspect="auto",
        interpolation="nearest", cmap=sequential_map(), norm=PowerNorm(0.5, 0.0, values.max()),
    )  # fmt: skip
    for name, (symbol, marker) in SETS.items():
        of_set = paths.filter(set=name)
        _marks(ax, of_set["phi_1"].to_numpy(), of_set["phi_2"].to_numpy(), name, marker, symbol)
    ax.set_xlabel(_feature(1))
    ax.set_ylabel(_feature(2))
    bar = figure.colorbar(image, ax=ax, label="density of paths", pad=0.02, aspect=25)
    bar.outline.set_visible(False)


def _marks(ax: Axes, x: np.ndarray, y: np.ndarray, name: str, marker: str, label: str) -> None:
    ax.plot(
        x, y, linestyle="none", marker=marker, markersize=4.4 if marker == "o" else 3.8,
        markerfacecolor=color(palette.SETS[name]), markeredgecolor="white", markeredgewidth=0.5, label=label,
        clip_on=False, zorder=5,
    )  # fmt: skip


def _feature(number: int) -> str:
    return f"$\\phi_{number}$: mean distance to {'AB'[number - 1]} \n(in units of its range)"
