"""The figures of the robustness study: how much posteriors depend on which alternatives were sampled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from pipeline.views import palette
from pipeline.views.figures.style import (
    TEXT,
    color,
    in_style,
    model_color,
    model_look,
    new_figure,
)
from pipeline.views.hypothesis_rows import rows_that_matter
from pipeline.vocabulary import (
    BATCH,
    BOLTZMANN_WEIGHTED,
    INDEPENDENT,
    KINDS,
    KNOWN_DENSITY,
    REGIMES,
    SAMPLER_SHIFT,
    SINGLE,
    model_name,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CHOICES = {"bandwidth": "bandwidth × {}", "selector": "selector {}", "scale": "scale {}", "beta": "beta {}"}
_KL, _SIZE, _ANGLE = "KLAggregate\nper pair (nat)", "alternatives per set", "angle to the truth (deg)"
_FAR = 1e6  # an interval is cut at this many times its value
_DECADES = 5  # a panel shows this many decades of KLAggregate below its largest value


@in_style
def kl_figure(summary: pl.DataFrame, regimes: Sequence[str] = (INDEPENDENT, SAMPLER_SHIFT)) -> Figure:
    """KLAggregate against set size with 95 % intervals, a column per regime; above single demonstrations, below all.

    An arrow marks an interval that goes on beyond the panel, here and in the figures below.

    Args:
        summary: the table `robustness_summary` of one task, per pair of sets.
        regimes: the regimes to show.
    """
    figure = new_figure(TEXT, 3.8)
    axes = figure.subplots(len(KINDS), len(regimes), squeeze=False, sharex=True, sharey=True)
    for row, kind in zip(axes, KINDS, strict=True):
        for ax, regime in zip(row, regimes, strict=True):
            _curves(ax, summary.filter(demonstrations=kind, regime=regime), "set_size")
            ax.set_title(f"{KINDS[kind]}, {REGIMES[regime]}")
        row[0].set_ylabel(_KL)
    _log_limits(axes[0, 0], summary.filter(pl.col("regime").is_in(list(regimes))))
    for ax in axes[-1]:
        ax.set_xlabel(_SIZE)
    _ticks(axes[0, 0], summary["set_size"])
    for ax in axes.flat:
        _arrows(ax)
    _legend(figure, axes[0, 0])
    return figure


@in_style
def importance_figure(summary: pl.DataFrame, accuracy: pl.DataFrame, sets: pl.DataFrame) -> Figure:
    """The effect of importance weights for samplers with known density, and the effective sample size of the weights.

    Args:
        summary: the table `robustness_summary` of one task, per pair of sets.
        accuracy: the result of `pipeline.views.robustness.accuracy`; without rows there is no panel of angles.
        sets: the table `robustness_sets`.
    """
    figure = new_figure(TEXT, 2.3)
    axes = figure.subplots(1, 4 if accuracy.height else 3, sharex=True)
    axes[1].sharey(axes[0])
    with_density = summary.filter(regime=KNOWN_DENSITY)
    for ax, kind in zip(axes, KINDS, strict=False):
        _curves(ax, with_density.filter(demonstrations=kind), "set_size")
        ax.set_title(KINDS[kind])
    axes[1].tick_params(labelleft=False)
    _log_limits(axes[0], with_density)
    axes[0].set_ylabel(_KL)
    if accuracy.height:
        _angles(axes[2], accuracy.filter(regime=KNOWN_DENSITY, demonstrations=SINGLE))
        axes[2].set_title("single demonstrations")
        axes[2].set_ylim(0.0, None)
        axes[2].set_ylabel(_ANGLE)
    _effective_sizes(axes[-1], sets.filter(pl.col("effective_sample_size").is_not_null()))
    for ax in axes:
        ax.set_xlabel(_SIZE)
    _ticks(axes[0], with_density["set_size"])
    for ax in axes[:2]:
        _arrows(ax)
    _legend(figure, *axes[[0, *range(2, len(axes))]])
    return figure


@in_style
def accuracy_figure(accuracy: pl.DataFrame, hypotheses: int) -> Figure:
    """Angle between the most probable theta and the truth, and TruePosterior, against set size.

    Args:
        accuracy: the result of `pipeline.views.robustness.accuracy` for one task.
        hypotheses: number of thetas, which gives the level of chance.
    """
    panels = [(kind, regime) for kind in KINDS for regime in (INDEPENDENT, SAMPLER_SHIFT)]
    figure = new_figure(TEXT, 3.6)
    axes = figure.subplots(2, len(panels), sharex=True, sharey="row")
    for column, (kind, regime) in enumerate(panels):
        rows = accuracy.filter(demonstrations=kind, regime=regime)
        above, below = axes[:, column]
        _angles(above, rows)
        _curves(below, rows.filter(measure="true_posterior"), "set_size", log=False)
        below.axhline(1 / hypotheses, color=color(palette.GREY), linewidth=0.8, linestyle=":", label="chance", zorder=1)
        below.set_xlabel(_SIZE)
        above.set_title(f"{KINDS[kind]},\n{REGIMES[regime]}")
    for ax in axes.flat:
        ax.set_ylim(0.0, None)
    axes[0, 0].set_ylabel(_ANGLE)
    axes[1, 0].set_ylabel("TruePosterior")
    _ticks(axes[0, 0], accuracy["set_size"])
    _legend(figure, *axes[:, 0])
    return figure


@in_style
def two_posteriors_figure(
    posteriors: pl.DataFrame, set_ids: dict[str, tuple[str, str]], labels: Sequence[str], meaning: str
) -> Figure:
    """The posterior over theta of one demonstration from two sets, a row per model, a column per regime.

    The hypotheses that matter have a row each, the most probable first.

    Args:
        posteriors: rows of the table `robustness_posteriors` for one demonstration and set size.
        set_ids: for each regime, the names of the two sets.
        labels: (K,) names of the thetas.
        meaning: what the numbers in the labels mean.
    """
    models = posteriors.filter(regime=next(iter(set_ids)))["model"].unique(maintain_order=True).to_list()
    shown = {
        (regime, model, set_id): posteriors.filter(regime=regime, model=model, set_id=set_id)
        .sort("theta_id")["posterior"]
        .to_numpy()
        for regime, pair in set_ids.items()
        for model in models
        for set_id in pair
    }
    rows = rows_that_matter({str(key): values for key, values in shown.items()})
    figure = new_figure(TEXT, 0.75 + (0.5 + 0.2 * len(rows.order)) * len(models))
    axes = figure.subplots(len(models), len(set_ids), squeeze=False, sharex=True, sharey=True)
    y = np.arange(len(rows.order))
    for column, (regime, pair) in enumerate(set_ids.items()):
        for ax, model in zip(axes[:, column], models, strict=True):
            shade = model_color(model, models)
            for place, (set_id, face) in enumerate(zip(pair, (shade, "white"), strict=True)):
                values = rows.own(shown[regime, model, set_id])
                ax.barh(y + 0.4 * place - 0.2, values, 0.4, facecolor=face, edgecolor=shade, linewidth=0.7)
            ax.set_title(f"{model_name(model)}, {REGIMES[regime]}\nfull: set {pair[0]},\nempty: set {pair[1]}")
            ax.grid(axis="x")
            ax.tick_params(axis="y", length=0)
        axes[-1, column].set_xlabel(f"posterior{rows.unshown}")
    axes[0, 0].set_yticks(y, rows.names(labels)[: len(y)])
    axes[0, 0].set_ylim(len(y) - 0.5, -0.5)
    for ax in axes[:, 0]:
        ax.set_ylabel(meaning)
    demonstration, size = posteriors.select("demonstration_id", "set_size").row(0)
    about = f"demonstration {demonstration}, sets of {size:,} alternatives"
    figure.suptitle(about, x=0.01, ha="left")
    return figure


@in_style
def duplicates_figure(summary: pl.DataFrame) -> Figure:
    """The shift of the posterior against the number of near-copies, a column per spread.

    Args:
        summary: the table `duplicates_summary` of one task.
    """
    spreads = sorted(summary["spread"].unique())
    figure = new_figure(TEXT, 3.6)
    axes = figure.subplots(len(KINDS), len(spreads), squeeze=False, sharex=True, sharey=True)
    _log_limits(axes[0, 0], summary)
    for row, kind in zip(axes, KINDS, strict=True):
        rows = summary.filter(demonstrations=kind)
        for ax, spread in zip(row, spreads, strict=True):
            _curves(ax, rows.filter(pl.col("spread") == spread), "copies")
        row[0].set_ylabel(f"KL from clean (nat)\n{KINDS[kind]}")
    for ax, spread in zip(axes[0], spreads, strict=True):
        ax.set_title(f"spread {spread:g}" if spread else "exact copies")
    for ax in axes[-1]:
        ax.set_xlabel("copies of each")
    _ticks(axes[0, 0], summary["copies"])
    for ax in axes.flat:
        _arrows(ax)
    about = "Spread: standard deviation of a copy's features around its original's, in scaled features"
    _legend(figure, axes[0, 0], about=about)
    return figure


@in_style
def sensitivity_figure(
    summary: pl.DataFrame, changed: pl.DataFrame, regimes: Sequence[str] = (INDEPENDENT, SAMPLER_SHIFT)
) -> Figure:
    """KLAggregate of single demonstrations under every setting, and how often the answer of all together is another.

    Settings of the study have a filled mark. A KLAggregate more than five decades below the largest is drawn as an
    arrow at the edge.

    Args:
        summary: rows of the table `sensitivity_summary` for one task and set size, per pair of sets.
        changed: the result of `pipeline.views.robustness.changed_answers` for the same size.
        regimes: the regimes to show.
    """
    settings = summary.select("choice", "setting").unique(maintain_order=True).rows()
    models = summary["model"].unique(maintain_order=True).to_list()
    figure = new_figure(TEXT, 1.0 + 0.16 * len(settings))
    axes = figure.subplots(1, 2 * len(regimes), sharey=True)
    shown = summary.filter(pl.col("regime").is_in(list(regimes)), demonstrations=SINGLE)
    for place, regime in enumerate(regimes):
        for ax, table in ((axes[place], summary), (axes[place + len(regimes)], changed)):
            rows = table.filter(demonstrations=SINGLE if table is summary else BATCH, regime=regime)
            if table is summary:
                ax.set_xscale("log")
                largest = shown.select(pl.max_horizontal(pl.col("value", "high").max())).item()
                if largest > 0:
                    ax.set_xlim(2 * largest / 10**_DECADES, 2 * largest)
            else:
                ax.set_xlim(-0.04, 1.04)
                ax.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
            _settings(ax, rows, settings, models)
            ax.set_xlabel(_KL if table is summary else "share of sets whose\nanswer is another")
            kind = SINGLE if table is summary else BATCH
            ax.set_title(f"{KINDS[kind]},\n{REGIMES[regime]}")
    axes[0].set_yticks(range(len(settings)), [CHOICES.get(c, c + " {}").format(s) for c, s in settings])
    axes[0].set_ylim(len(settings) - 0.5, -0.5)
    for ax in axes:
        ax.tick_params(axis="y", length=0)
        ax.grid(axis="x")
        for line in range(1, len(settings)):
            if settings[line][0] != settings[line - 1][0]:
                ax.axhline(line - 0.5, color=color(palette.GREY), linewidth=0.5)
    marks = [
        (model_name(model), model_color(model, models), model_color(model, models), model_look(model, models).marker)
        for model in models
    ]
    marks += [
        ("as in the study", color(palette.GREY), color(palette.GREY), "o"),
        ("changed", color(palette.GREY), color(palette.WHITE), "o"),
    ]
    handles = [
        Line2D([], [], marker=mark, linestyle="none", markersize=3.2, color=edge, markerfacecolor=face, label=label)
        for label, edge, face, mark in marks
    ]
    about = f"one setting changed at a time, sets of {summary['set_size'][0]:,} alternatives"
    figure.legend(
        handles=handles, loc="outside upper left", ncols=len(handles), title=about, alignment="left",
    )  # fmt: skip
    return figure


def _settings(ax: Axes, rows: pl.DataFrame, settings: Sequence[tuple[str, str]], models: Sequence[str]) -> None:
    """A mark with its interval for each setting and model."""
    for offset, model in enumerate(models):
        shade, look = model_color(model, models), model_look(model, models)
        for line, (choice, setting) in enumerate(settings):
            points = rows.filter(model=model, choice=choice, setting=setting)
            for point in points.iter_rows(named=True):
                y = line + 0.3 * (offset - (len(models) - 1) / 2)
                if point["low"] is not None:
                    ax.plot([point["low"], point["high"]], [y, y], color=shade, linewidth=0.8)
                face = shade if point["is_default"] else "white"
                low = ax.get_xlim()[0] if ax.get_xscale() == "log" else point["value"]
                beyond = point["value"] < low
                ax.plot(
                    max(point["value"], low), y, "<" if beyond else look.marker, color=shade, markerfacecolor=face,
                    markersize=3.2, markeredgewidth=0.8, clip_on=not beyond,
                )  # fmt: skip


def _curves(ax: Axes, points: pl.DataFrame, x: str, *, log: bool = True) -> None:
    """A line per model through its values, with intervals where there are any. Log axes show only positive values."""
    models = points["model"].unique(maintain_order=True).to_list()
    for place, model in enumerate(models):
        rows = points.filter(pl.col("model") == model).sort(x)
        if log:
            rows = rows.filter(pl.col("value") > 0)
        # models are shifted sideways, so that intervals do not hide each other
        shifted = rows[x].to_numpy() * 1.06 ** (place - (len(models) - 1) / 2)
        shade, look = model_color(model, models), model_look(model, models)
        ax.plot(
            shifted, rows["value"], look.marker, markersize=3, color=shade, linestyle=look.line, label=model_name(model)
        )
        with_interval = rows["low"].is_not_null().to_numpy()
        value, low, high = (rows[name].to_numpy()[with_interval] for name in ("value", "low", "high"))
        if log:  # cut far outside every panel, because axes cannot compute with extreme numbers
            low, high = np.maximum(low, value / _FAR), np.minimum(high, value * _FAR)
        ax.vlines(shifted[with_interval], low, high, color=shade, linewidth=0.8)
    ax.set_xscale("log")
    if log:
        ax.set_yscale("log")
    ax.grid(axis="y")


def _angles(ax: Axes, accuracy: pl.DataFrame) -> None:
    degrees = accuracy.with_columns(pl.col("value", "low", "high").degrees())
    _curves(ax, degrees.filter(measure="map_angle_rad"), "set_size", log=False)
    nearest = degrees.filter(measure="truth_to_grid_rad")["value"]
    ax.axhline(nearest[0], color=color(palette.GREY), linewidth=0.8, linestyle="--", label="nearest theta", zorder=1)


def _effective_sizes(ax: Axes, sets: pl.DataFrame) -> None:
    middle = sets.group_by("set_size").agg(pl.col("effective_sample_size").median()).sort("set_size")
    grey = color(palette.GREY)
    ax.plot(
        sets["set_size"], sets["effective_sample_size"], "o", color=grey, markersize=2.4, markeredgewidth=0,
        label="one sampler's set",
    )  # fmt: skip
    weighted = (BOLTZMANN_WEIGHTED,)
    ax.plot(
        middle["set_size"], middle["effective_sample_size"], color=model_color(BOLTZMANN_WEIGHTED, weighted),
        linestyle=model_look(BOLTZMANN_WEIGHTED, weighted).line,
    )  # fmt: skip
    ax.plot(
        middle["set_size"], middle["set_size"], color=grey, linewidth=0.8, linestyle=":", label="if all weighed alike"
    )
    ax.set_yscale("log")
    ax.set_ylim(0.8, None)
    ax.set_ylabel("effective sample size")
    ax.set_title("the weights")
    ax.grid(axis="y")


def _arrows(ax: Axes) -> None:
    """An arrow at the edge for each interval that goes on beyond it; call it when the limits are set."""
    bottom, top = ax.get_ylim()
    for bars in list(ax.collections):
        if not isinstance(bars, LineCollection):
            continue
        shade: Any = bars.get_color()[0]
        for segment in bars.get_segments():
            for end, beyond, mark in ((segment[0], bottom, "v"), (segment[-1], top, "^")):
                if len(segment) and (end[1] < beyond if mark == "v" else end[1] > beyond):
                    ax.plot(end[0], beyond, mark, color=shade, markersize=3, markeredgewidth=0, clip_on=False)


def _log_limits(ax: Axes, points: pl.DataFrame) -> None:
    """Limit an axis to the intervals, but to a decade beyond the values: intervals from few sets can be far longer."""
    values = points.filter(pl.col("value") > 0)
    if values.is_empty():
        return
    low, high = (pl.col(name).fill_null(pl.col("value")) for name in ("low", "high"))
    bottom, top = values.select(low.min(), high.max()).row(0)
    least, largest = values.select(pl.col("value").min(), pl.col("value").max().alias("largest")).row(0)
    ax.set_ylim(max(bottom / 1.3, least / 10), min(top * 1.3, largest * 10))


def _ticks(ax: Axes, values: pl.Series) -> None:
    """One tick for each distinct value."""
    ticks: list[Any] = sorted(values.unique())
    ax.set_xticks(ticks, [f"{value:,}" for value in ticks])
    ax.xaxis.set_minor_locator(NullLocator())


def _legend(figure: Figure, *axes: Axes, about: str | None = None) -> None:
    """One legend for everything that is shown in these axes, under a line about it."""
    entries = {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(
        list(entries.values()), list(entries), loc="outside upper left", ncols=len(entries), title=about,
        alignment="left",
    )  # fmt: skip
