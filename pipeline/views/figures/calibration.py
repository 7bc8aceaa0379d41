"""The figure of simulation-based calibration: where the truth falls in its posterior."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pipeline.views.figures.style import INK, TEXT, in_style, model_bars, new_figure, small
from pipeline.vocabulary import model_name

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure


@in_style
def rank_histograms_figure(ranks: pl.DataFrame) -> Figure:
    """A rank histogram for each model (rows) and each weight, beta and the direction (columns), with its band.

    Args:
        ranks: the table of `pipeline.commands.calibrate.rank_table`.
    """
    models = ranks["model"].unique(maintain_order=True).to_list()
    placed = ranks["of"].unique(maintain_order=True).to_list()
    figure = new_figure(TEXT, 0.5 + 1.15 * len(models))
    panels = figure.subplots(len(models), len(placed), squeeze=False, sharex=True, sharey=True)
    for row, model in enumerate(models):
        for column, of in enumerate(placed):
            axes, mine = panels[row, column], ranks.filter(model=model, of=of)
            low, high = mine["lower"][0], mine["upper"][0]
            axes.axhspan(low, high, facecolor="#d9d9d9", linewidth=0, zorder=0)
            axes.axhline(mine["count"].mean(), color=INK, linewidth=0.6, zorder=1)
            width = 1 / mine.height
            model_bars(axes, mine["from"] + width / 2, mine["count"], 0.86 * width, model, models, zorder=2)
            axes.set_xlim(0, 1)
            axes.yaxis.get_major_locator().set_params(integer=True)
            axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
            if row == 0:
                axes.set_title(of)
        panels[row, 0].set_ylabel(f"{model_name(model)}\ntimes")
    figure.supxlabel(
        "posterior probability of less than the truth (direction: of nearer to the mean)", fontsize=small()
    )
    return figure
