"""The figure of what the next person is predicted to do, beside what people did."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pipeline.views.figures.style import INK, TEXT, in_style, model_color, model_look, new_figure
from pipeline.vocabulary import INFERRED_MODELS, model_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    import polars as pl
    from matplotlib.figure import Figure

    from pipeline.arrays import FloatArray
    from pipeline.views.feature_axis import FeatureAxis


def _place(model: str) -> int:
    """Place of a model in a picture: the same as everywhere, with those that no task infers last."""
    known = tuple(INFERRED_MODELS)
    return known.index(model) if model in known else len(known)


@in_style
def predicted_figure(predictions: pl.DataFrame, features: Sequence[FeatureAxis], demonstrations: FloatArray) -> Figure:
    """For each feature the predicted median and 90 % interval of every model, and the demonstrations as ticks.

    Args:
        predictions: rows of the table `predictions` about the next person.
        features: the axes of the F features.
        demonstrations: (n, F) raw values.
    """
    models = sorted(predictions["model"].unique(maintain_order=True), key=_place)
    figure = new_figure(TEXT, 0.8 + 0.22 * len(models))
    panels = figure.subplots(1, len(features), squeeze=False)[0]
    for column, (axes, feature) in enumerate(zip(panels, features, strict=True)):
        for row, model in enumerate(models):
            found = predictions.filter(model=model, feature=feature.feature).row(0, named=True)
            low, median, high = feature.shown([found["low"], found["median"], found["high"]])
            colour = model_color(model, models)
            axes.plot([low, high], [row, row], color=colour, linewidth=2.2, solid_capstyle="butt")
            axes.plot(
                median, row, model_look(model, models).marker, color=colour, markersize=5, markeredgecolor=INK,
                markeredgewidth=0.5,
            )  # fmt: skip
        values = feature.shown(demonstrations[:, column])
        axes.plot(values, [len(models)] * len(values), "|", color=INK, markersize=7, markeredgewidth=0.8)
        names = [*map(model_name, models), "people"] if column == 0 else [""] * (len(models) + 1)
        axes.set_yticks(range(len(models) + 1), names)
        axes.set_ylim(len(models) + 0.6, -0.6)
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel(feature.label)
        axes.grid(axis="x")
        axes.spines["left"].set_visible(False)
    return figure
