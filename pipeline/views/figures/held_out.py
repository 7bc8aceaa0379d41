"""The figure that shows which model predicts a task's demonstrations best."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.views.figures.style import COLUMN, INK, error_bars, in_style, model_color, new_figure
from pipeline.vocabulary import model_name

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@in_style
def held_out_figure(held_out: pl.DataFrame, comparison: pl.DataFrame, differences: pl.DataFrame) -> Figure:
    """Held-out log predictive probability of each model, and its lead over Boltzmann, with standard errors.

    Args:
        held_out: rows of the table `held_out` for one task and set.
        comparison: the result of `pipeline.views.intervals.compare_models`.
        differences: the result of `pipeline.views.intervals.differences`; without rows there is no second panel.
    """
    models = comparison["model"].to_list()
    paired = differences["model"].unique(maintain_order=True).to_list()
    panels = 2 if paired else 1
    figure = new_figure(COLUMN, 0.95 + 0.28 * len(models))
    axes = figure.subplots(1, panels, squeeze=False, width_ratios=[1.0] * panels)[0]
    scores = {model: held_out.filter(model=model)["log_predictive"].to_numpy() for model in models}
    _dots(axes[0], models, scores, comparison, "mean", "standard_error")
    axes[0].set_xlabel("log p(held out)\nper demonstration (nat)")
    if paired:
        leads = {model: differences.filter(model=model)["difference"].to_numpy() for model in paired}
        _dots(axes[1], models, leads, comparison, "difference", "difference_standard_error")
        axes[1].axvline(0, color=INK, linewidth=0.6)
        axes[1].tick_params(axis="y", labelleft=False)
        axes[1].set_xlabel("lead over Boltzmann\nper demonstration (nat)")
    count = comparison["demonstrations"][0]
    figure.suptitle(f"{count} held-out demonstrations; mean ± standard error", x=0.01, ha="left")
    return figure


def _dots(
    ax: Axes, models: list[str], values: dict[str, np.ndarray], comparison: pl.DataFrame, mean: str, error: str
) -> None:
    """A row per model: a pale dot for each demonstration, and above them the mean with its standard error."""
    for row, model in enumerate(models):
        if model not in values:
            continue
        color = model_color(model, models)
        numbers = comparison.filter(model=model)
        dots = values[model]
        ax.plot(dots, np.full(dots.size, row + 0.16), "o", color=color, alpha=0.45, markersize=3, markeredgewidth=0)
        centre, half_width = numbers[mean][0], numbers[error][0]
        error_bars(ax, centre, row - 0.14, xerr=half_width)
        ax.plot(centre, row - 0.14, "D", color=color, markersize=4.5, markeredgecolor=INK, markeredgewidth=0.5)
    ax.set_yticks(range(len(models)), [model_name(model) for model in models])
    ax.set_ylim(len(models) - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="x")
    ax.spines["left"].set_visible(False)
