"""The figures of the robustness study: how much posteriors depend on the alternatives that were sampled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from pipeline.stores.figures import COLUMN_IN, TEXT_IN, in_style, model_color, new_figure, probability_axis
from pipeline.stores.palette import model_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REGIMES = {"independent": "one sampler", "sampler-shift": "different samplers", "known-density": "samplers of known density"}
KINDS = {"single": "single demonstrations", "batch": "all together"}
LINES = {"boltzmann-weighted": (0, (2, 1.2)), "less-clean-bandwidth": (0, (2, 1.2))}
NAMES = {"boltzmann-weighted": "Boltzmann, weighted", "less-clean-bandwidth": "LESS, clean bandwidth"}
BASE = {"boltzmann-weighted": "boltzmann", "less-clean-bandwidth": "less"}


@in_style
def kl_figure(summary: pl.DataFrame, regimes: Sequence[str] = ("independent", "sampler-shift")) -> Figure:
    """KLAggregate against set size with 95 % intervals, a column per regime, single demonstrations above all together.

    Args:
        summary: the table `robustness_summary` of one task.
        regimes: which to show.
    """
    figure = new_figure(TEXT_IN * len(regimes) / 3 + 0.6, 3.6)
    axes = figure.subplots(len(KINDS), len(regimes), squeeze=False, sharex=True, sharey="row")
    for row, kind in enumerate(KINDS):
        for column, regime in enumerate(regimes):
            points = summary.filter(demonstrations=kind, regime=regime)
            _curves(axes[row, column], points, "set_size")
            if row == 0:
                axes[row, column].set_title(REGIMES[regime])
        axes[row, 0].set_ylabel(f"KLAggregate (nat)\n{KINDS[kind]}")
    for ax in axes[-1]:
        ax.set_xlabel("alternatives per set")
    sizes = sorted(summary["set_size"].unique())
    axes[0, 0].set_xticks(sizes, [f"{size:,}" for size in sizes])
    axes[0, 0].minorticks_off()
    axes[0, -1].legend()
    return figure


@in_style
def two_posteriors_figure(
    posteriors: pl.DataFrame, demonstration_id: str, set_size: int, set_ids: tuple[str, str], labels: Sequence[str]
) -> Figure:
    """The posterior over theta of one demonstration from two sets, a panel per model.

    Args:
        posteriors: rows of one regime of the table `robustness_posteriors`.
        demonstration_id: whose.
        set_size: of both sets.
        set_ids: of the two sets.
        labels: K names of the thetas.
    """
    rows = posteriors.filter(pl.col("set_id").is_in(set_ids), demonstration_id=demonstration_id, set_size=set_size)
    models = rows["model"].unique(maintain_order=True).to_list()
    figure = new_figure(TEXT_IN, 1.2 + 0.95 * len(models))
    axes = figure.subplots(len(models), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    for ax, model in zip(axes, models, strict=True):
        for place, set_id in enumerate(set_ids):
            values = rows.filter(model=model, set_id=set_id).sort("theta_id")["posterior"].to_numpy()
            ax.bar(
                np.arange(len(values)) + 0.4 * place - 0.2, values, 0.38, label=f"set {set_id}",
                color=model_color(model, models), alpha=(1.0, 0.45)[place],
            )  # fmt: skip
        probability_axis(ax, "posterior", None)
        ax.set_title(model_name(model))
        ax.legend()
    axes[-1].set_xticks(range(len(labels)), labels, rotation=90)
    return figure


@in_style
def duplicates_figure(summary: pl.DataFrame) -> Figure:
    """The shift of the posterior of single demonstrations against the number of near-copies, a panel per spread.

    Args:
        summary: the table `duplicates_summary` of one task.
    """
    rows = summary.filter(demonstrations="single")
    spreads = sorted(rows["spread"].unique())
    figure = new_figure(TEXT_IN, 1.9)
    axes = figure.subplots(1, len(spreads), squeeze=False, sharex=True, sharey=True)[0]
    for ax, spread in zip(axes, spreads, strict=True):
        _curves(ax, rows.filter(pl.col("spread") == spread), "copies")
        ax.set_title(f"spread {spread:g}" if spread else "exact copies")
        ax.set_xlabel("copies of each")
    axes[0].set_ylabel("KL from the clean posterior (nat)")
    copies = sorted(rows["copies"].unique())
    axes[0].set_xticks(copies, [str(count) for count in copies])
    axes[0].minorticks_off()
    axes[-1].legend(fontsize=6)
    return figure


@in_style
def sensitivity_figure(summary: pl.DataFrame, regime: str, set_size: int) -> Figure:
    """KLAggregate of single demonstrations under every setting of each choice, the study's own with a filled mark.

    Args:
        summary: the table `sensitivity_summary` of one task.
        regime: which to show.
        set_size: which to show.
    """
    rows = summary.filter(demonstrations="single", regime=regime, set_size=set_size)
    settings = rows.select("choice", "setting").unique(maintain_order=True).rows()
    models = rows["model"].unique(maintain_order=True).to_list()
    figure = new_figure(COLUMN_IN, 0.7 + 0.15 * len(settings))
    ax = figure.subplots()
    for place, model in enumerate(models):
        for line, (choice, setting) in enumerate(settings):
            point = rows.filter(model=model, choice=choice, setting=setting).row(0, named=True)
            shade, y = model_color(model, models), line + 0.24 * place - 0.12
            if point["low"] is not None:
                ax.plot([point["low"], point["high"]], [y, y], color=shade, linewidth=0.8)
            face = shade if point["is_default"] else "white"
            label = model_name(model) if line == 0 else None
            ax.plot(point["value"], y, "o", color=shade, markerfacecolor=face, markersize=3.2, label=label)
    ax.set_xscale("log")
    ax.set_xlabel("KLAggregate (nat)")
    ax.set_yticks(range(len(settings)), [f"{choice}: {setting}" for choice, setting in settings])
    ax.set_ylim(len(settings) - 0.5, -0.5)
    ax.grid(axis="x")
    ax.legend()
    return figure


def _curves(ax: Axes, points: pl.DataFrame, x: str) -> None:
    """A line per model through its values, with their intervals where they are known and positive."""
    models = points["model"].unique(maintain_order=True).to_list()
    for place, model in enumerate(models):
        base = BASE.get(model, model)
        rows = points.filter((pl.col("model") == model) & (pl.col("value") > 0)).sort(x)
        # side by side, so that intervals do not hide each other
        at = rows[x].to_numpy() * 1.06 ** (place - (len(models) - 1) / 2)
        shade = model_color(base, ("boltzmann", "less"))
        ax.plot(at, rows["value"], "o", markersize=3, color=shade, linestyle=LINES.get(model, "-"), label=_name(model))
        known = rows["low"].is_not_null().to_numpy() & (rows["low"].fill_null(0.0) > 0).to_numpy()
        ax.vlines(at[known], rows["low"].to_numpy()[known], rows["high"].to_numpy()[known], color=shade, linewidth=0.8)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.grid(axis="y")


def _name(model: str) -> str:
    return NAMES[model] if model in NAMES else model_name(model)
