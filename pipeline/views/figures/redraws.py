"""Figures of the redrawn sets: leads over draws and people by sampler, and against where people stand in the pool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from pipeline.views import palette
from pipeline.views.figures.style import INK, TEXT, Figure, color, error_bars, in_style, model_color, new_figure
from pipeline.vocabulary import LESS, model_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = 4
MARKERS = "osD^vP*X<>"
FINE_RATIOS, COARSE_RATIOS = (0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0), (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)
MOST = 1000.0  # an axis of ratios goes so far to either side


@in_style
def ratios_figure(leads: pl.DataFrame) -> Figure:
    """KLAggregate of each model as a multiple of Boltzmann's against set size, a panel for each sampler.

    Args:
        leads: rows of the table `redraws_leads` of one task, of one kind of `demonstrations`.
    """
    return _by_sampler(leads.rename({"ratio": "value"}), "KLAggregate,\nby Boltzmann's", 1.0, log=True)


@in_style
def held_out_leads_figure(leads: pl.DataFrame) -> Figure:
    """The lead over Boltzmann in held-out score against set size, a panel for each sampler.

    Args:
        leads: rows of the table `redraws_held_out_leads` of one task, of sets and one `beta`.
    """
    return _by_sampler(leads.rename({"lead": "value"}), "lead in held-out score\n(nat a person)", 0.0, log=False)


@in_style
def standing_figure(points: pl.DataFrame) -> Figure:
    """Both leads of LESS against where people stand in the pool of the sampler.

    Args:
        points: for every `task` and `sampler` the median `percentile` of people's efficiency in the pool, the `ratio`
            of KLAggregate at the smallest size and the `lead` in held-out score at the largest, each with `_low` and
            `_high`.
    """
    figure = new_figure(TEXT, 3.3)
    left, right = figure.subplots(1, 2)
    tasks, samplers = (points[name].unique(maintain_order=True).to_list() for name in ("task", "sampler"))
    shades = dict(zip(tasks, _shades(len(tasks)), strict=True))
    for ax, value in ((left, "ratio"), (right, "lead")):
        for row in points.iter_rows(named=True):
            x, y = 100 * row["percentile"], row[value]
            if y is None:
                continue
            error_bars(ax, x, y, yerr=np.array([[y - row[f"{value}_low"]], [row[f"{value}_high"] - y]]))
            mark = MARKERS[samplers.index(row["sampler"]) % len(MARKERS)]
            ax.plot(x, y, mark, color=shades[row["task"]], markersize=4.5, markeredgecolor=INK, markeredgewidth=0.4)
        ax.set_xlim(-3, 103)
        ax.set_xlabel("people's median percentile of effort in the pool (%)")
        ax.grid(axis="y")
    left.axhline(1, color=INK, linewidth=0.6)
    right.axhline(0, color=INK, linewidth=0.6)
    _ratio_axis(left, points.select("ratio_low", "ratio_high"))
    left.set_ylabel("KLAggregate of LESS, by Boltzmann's\n(smallest sets)")
    right.set_ylabel("lead of LESS in held-out score\n(nat a person, largest sets)")
    entries: list[Any] = [left.plot([], [], "o", color=shade)[0] for shade in shades.values()]
    entries += [
        left.plot([], [], MARKERS[i % len(MARKERS)], color="white", markeredgecolor=INK)[0]
        for i in range(len(samplers))
    ]
    labels = [*tasks, *(name.replace("_", " ") for name in samplers)]
    figure.legend(entries, labels, loc="outside upper left", ncols=5)
    return figure


def _by_sampler(leads: pl.DataFrame, label: str, level: float, *, log: bool) -> Figure:
    samplers = leads["sampler"].unique(maintain_order=True).to_list()
    models = leads["model"].unique(maintain_order=True).to_list()
    columns = min(COLUMNS, len(samplers))
    rows = -(-len(samplers) // columns)
    figure = new_figure(TEXT, 0.5 + 1.55 * rows)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for ax, sampler in zip(axes.flat, samplers, strict=False):
        _lines(ax, leads.filter(sampler=sampler), models)
        ax.axhline(level, color=INK, linewidth=0.6)
        ax.set_title(sampler.replace("_", " "))
        ax.grid(axis="y")
    sizes = sorted(leads["set_size"].unique())
    for place, ax in enumerate(axes.flat):
        if place >= len(samplers):
            ax.remove()
            continue
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(FixedLocator(sizes))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        if place + columns >= len(samplers):
            ax.tick_params(axis="x", labelbottom=True)
            ax.set_xlabel("alternatives per set")
        if place % columns == 0:
            ax.set_ylabel(label)
    if log:
        _ratio_axis(axes[0, 0], leads.select("low", "high"))
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=len(names))
    return figure


def _lines(ax: Axes, leads: pl.DataFrame, models: Sequence[str]) -> None:
    styles: Mapping[int, str] = {0: "-", 1: "--", 2: ":"}
    for place, model in enumerate(models):
        rows = leads.filter(model=model).sort("set_size")
        x = rows["set_size"].to_numpy() * 1.08 ** (place - (len(models) - 1) / 2)
        shade = model_color(LESS, (LESS,)) if model == LESS else color((palette.GREEN, palette.PINK)[place % 2])
        mark = MARKERS[place % len(MARKERS)]
        ax.plot(x, rows["value"], mark, color=shade, markersize=2.6, linestyle=styles.get(place, "-"),
                label=model_name(model))  # fmt: skip
        ax.vlines(x, rows["low"], rows["high"], color=shade, linewidth=0.8)


def _ratio_axis(ax: Axes, ends: pl.DataFrame) -> None:
    """A logarithmic axis with ticks at plain ratios, as far as the values go, but no farther than MOST times."""
    values = np.clip(ends.drop_nulls().to_numpy().ravel(), 1 / MOST, MOST)
    ax.set_yscale("log")
    ax.set_ylim(values.min() / 1.15, values.max() * 1.15)
    ticks = FINE_RATIOS if values.max() < 40 * values.min() else COARSE_RATIOS
    shown = [tick for tick in ticks if values.min() / 1.15 <= tick <= values.max() * 1.15]
    ax.yaxis.set_major_locator(FixedLocator(shown))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_locator(NullLocator())


def _shades(count: int) -> list[tuple[float, float, float]]:
    all_of_them = (
        palette.BLUE, palette.ORANGE, palette.GREEN, palette.PINK, palette.SKY, palette.VERMILLION, palette.YELLOW,
        palette.GREY,
    )  # fmt: skip
    return [color(all_of_them[i % len(all_of_them)]) for i in range(count)]
