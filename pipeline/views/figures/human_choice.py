"""The figure of the human choice study: the observed shares and the predictions of each model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.views import palette
from pipeline.views.figures.style import (
    COLUMN,
    TEXT,
    color,
    error_bars,
    in_style,
    model_bars,
    new_figure,
    probability_axis,
)
from pipeline.vocabulary import model_name

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BAR = 0.26  # width of a bar, of which each option has one per model and one for the observed share


@in_style
def choices_figure(predictions: pl.DataFrame) -> Figure:
    """Shares of the groups, and shares within each group that has several options.

    Args:
        predictions: the table `human_choice_predictions` with `low` and `high`, the 95 % interval of the observed
            share.
    """
    within = predictions.filter(comparison="within")
    several = within["group"].unique(maintain_order=True).to_list()
    panels = 1 + len(several)
    figure = new_figure(COLUMN if panels <= 2 else TEXT, 2.05)
    shown = [predictions.filter(comparison="groups"), *(within.filter(group=group) for group in several)]
    widths = [max(2, rows.n_unique("option" if place else "group")) for place, rows in enumerate(shown)]
    axes = figure.subplots(1, panels, sharey=True, squeeze=False, width_ratios=widths)[0]
    _bars(axes[0], shown[0], "group", "all choices")
    for ax, group, rows in zip(axes[1:], several, shown[1:], strict=True):
        _bars(ax, rows, "option", f"choices of {group}")
    probability_axis(axes[0], "share of choices")
    for ax in axes[1:]:
        ax.grid(axis="y")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    return figure


def _bars(ax: Axes, rows: pl.DataFrame, label: str, title: str) -> None:
    models = rows["model"].unique(maintain_order=True).to_list()
    observed = rows.filter(model=models[0])
    place = np.arange(observed.height)
    start = place - _BAR * len(models) / 2
    ax.bar(start, observed["observed"], _BAR, color=color(palette.GREY), label="observed, 95 % binomial interval")
    if observed["low"].null_count() == 0:
        share = observed["observed"].to_numpy()
        reach = np.stack([share - observed["low"].to_numpy(), observed["high"].to_numpy() - share])
        error_bars(ax, start, share, yerr=reach)
    for offset, model in enumerate(models, 1):
        values = rows.filter(model=model)["predicted"]
        model_bars(ax, start + offset * _BAR, values.to_numpy(), _BAR, model, models, label=model_name(model))
    ax.set_xticks(place, observed[label].to_list())
    ax.tick_params(axis="x", length=0)
    ax.set_title(f"{title}, n = {observed['count'].sum()}")
