"""The figures of a task: what its recording shows after all demonstrations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import PowerNorm

from pipeline.views import palette
from pipeline.views.feature_axis import with_unit
from pipeline.views.figures.style import (
    COLUMN,
    INK,
    TEXT,
    color,
    in_style,
    lying_bars,
    model_color,
    model_look,
    new_figure,
    sequential_map,
)
from pipeline.views.hypothesis_rows import rows_that_matter
from pipeline.vocabulary import LESS, model_name

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    from pipeline.arrays import FloatArray
    from pipeline.views.task_summary import DensityCurve, DensityMap

_COLORS = (
    palette.BLUE, palette.ORANGE, palette.GREEN, palette.SKY, palette.VERMILLION, palette.YELLOW, palette.GREY,
)  # fmt: skip
_MARKERS = "o^sDvP*X<>"  # so that samplers differ in grey print too


@in_style
def densities_figure(curves: Sequence[DensityCurve]) -> Figure:
    """The density of the alternatives along each feature, with equal and with LESS weights, and the demonstrations."""
    across = min(3, len(curves))
    down = -(-len(curves) // across)
    figure = new_figure(TEXT if across > 1 else COLUMN, 0.35 + 1.7 * down)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for ax, curve in zip(axes, curves, strict=False):
        top = float(max(curve.raw.max(), curve.adjusted.max()))
        grey, orange = color(palette.RAW_DENSITY), color(palette.MODELS[LESS])
        ax.fill_between(curve.grid, curve.raw, color=grey, alpha=0.55, linewidth=0, label="every alternative alike")
        ax.plot(curve.grid, curve.adjusted, color=orange, linewidth=1.4, label="weighted by LESS")
        marks = np.full(curve.demonstrations.size, -0.06 * top)
        ax.plot(
            curve.demonstrations, marks, "|", color=color(palette.DEMONSTRATION), markersize=6, markeredgewidth=1.0,
            label="demonstrations",
        )  # fmt: skip
        ax.axhline(0, color=INK, linewidth=0.6)
        ax.set_xlim(float(curve.grid[0]), float(curve.grid[-1]))
        ax.set_ylim(-0.12 * top, 1.05 * top)
        ax.set_yticks([tick for tick in ax.get_yticks() if 0 <= tick <= 1.05 * top])
        ax.set_xlabel(with_unit(curve.feature, curve.unit, curve.over_time))
    for ax in axes[len(curves) :]:
        ax.set_axis_off()
    for ax in axes[::across]:
        ax.set_ylabel("density (per unit\nof the axis)")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    return figure


@in_style
def map_figure(density: DensityMap) -> Figure:
    """The density of the alternatives over two features, alike and weighted by LESS, with the demonstrations."""
    shown = [("every alternative alike", density.density)]
    if density.adjusted is not None:
        shown.append(("weighted by LESS", density.adjusted))
    figure = new_figure(TEXT if len(shown) > 1 else COLUMN, 2.5)
    axes = figure.subplots(1, len(shown), sharex=True, sharey=True, squeeze=False)[0]
    half_x, half_y = (density.x[1] - density.x[0]) / 2, (density.y[1] - density.y[0]) / 2
    extent = (density.x[0] - half_x, density.x[-1] + half_x, density.y[0] - half_y, density.y[-1] + half_y)
    norm = PowerNorm(0.5, 0.0, float(max(values.max() for _, values in shown)))
    points = density.demonstrations
    for ax, (title, values) in zip(axes, shown, strict=True):
        image = ax.imshow(
            values, origin="lower", extent=extent, aspect="auto", interpolation="nearest", cmap=sequential_map(),
            norm=norm,
        )  # fmt: skip
        ax.plot(
            points[:, 0], points[:, 1], "o", color=color(palette.DEMONSTRATION), markersize=4.5,
            markeredgecolor="white", markeredgewidth=0.6, label="demonstrations",
        )  # fmt: skip
        ax.set_xlabel(with_unit(density.features[0], density.units[0], density.over_time[0]))
        ax.set_title(title)
    axes[0].set_ylabel(with_unit(density.features[1], density.units[1], density.over_time[1]))
    per = " · ".join(filter(None, density.units)).replace("^2", "²").replace("^3", "³")
    label = f"density of alternatives\n({f'per {per}; ' if per else ''}colours by its square root)"
    bar = figure.colorbar(image, ax=list(axes), label=label, pad=0.02, aspect=25)
    bar.outline.set_visible(False)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left")
    return figure


@in_style
def posterior_figure(
    posteriors: Mapping[str, FloatArray], labels: Sequence[str], meaning: str, over: str = "", truth: int | None = None
) -> Figure:
    """The posterior of each model given all demonstrations.

    Args:
        posteriors: for each model, (K,) probabilities.
        labels: (K,) the hypotheses in words.
        meaning: what the numbers in the labels mean.
        over: what the posteriors are over, such as "over the explored choice space".
        truth: the hypothesis nearest to what simulated people truly want, which is marked; None if nobody knows.
    """
    models = tuple(posteriors)
    rows = rows_that_matter(posteriors, truth)
    names = rows.names(labels, truth)
    figure = new_figure(COLUMN, 0.9 + 0.19 * rows.count)
    ax = figure.subplots()
    height = 0.8 / len(models)
    for offset, (model, posterior) in enumerate(posteriors.items()):
        values = rows.values(posterior)
        y = np.arange(values.size) + (offset - (len(models) - 1) / 2) * height
        lying_bars(ax, y, values, height, model, models, label=model_name(model))
    ax.set_yticks(np.arange(len(names)), names)
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlim(0, 1)
    ax.grid(axis="x")
    ax.set_xlabel("posterior, all demonstrations" + (f",\n{over}" if over else ""), loc="right")
    ax.set_ylabel(meaning)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper right", ncols=len(models))
    return figure


@in_style
def regions_figure(
    samplers: Mapping[str, FloatArray], region: FloatArray, demonstrations: FloatArray, axes_labels: tuple[str, str]
) -> Figure:
    """Where samplers draw, and the region that the choice space reaches, along two features.

    Args:
        samplers: by sampler, (N, 2) values of its alternatives.
        region: (C, 2) values of the cells of the map.
        demonstrations: (n, 2) values.
        axes_labels: of the two features, with units.
    """
    figure = new_figure(TEXT, 3.4)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    for number, (name, points) in enumerate(samplers.items()):
        left.plot(
            points[:, 0], points[:, 1], _MARKERS[number % len(_MARKERS)], markersize=1.7,
            color=color(_COLORS[number % len(_COLORS)]), markeredgewidth=0, label=name, rasterized=True,
        )  # fmt: skip
    right.plot(
        region[:, 0], region[:, 1], "s", markersize=1.3, color=color(palette.GREY), markeredgewidth=0,
        label="reached", rasterized=True,
    )  # fmt: skip
    for ax in (left, right):
        ax.plot(
            demonstrations[:, 0], demonstrations[:, 1], "D", markersize=3.5, color="white", markeredgecolor=INK,
            markeredgewidth=0.7, label="demonstrations",
        )  # fmt: skip
        ax.set_xlabel(axes_labels[0])
    left.set_ylabel(axes_labels[1])
    left.set_title(f"what {len(samplers)} samplers draw")
    right.set_title("what the choice space reaches")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, markerscale=1.5)
    return figure


@in_style
def before_after_figure(
    sampled: Mapping[str, FloatArray], explored: Mapping[str, FloatArray], labels: Sequence[str], about: str
) -> Figure:
    """The posteriors of one demonstration over theta, from each sampler's set and from each exploration.

    A row for each hypothesis that matters, and in it a mark for each posterior; marks that coincide agree.

    Args:
        sampled: for each model, (S, K) probabilities, a row for each sampler.
        explored: for each model, (R, K), a row for each exploration.
        labels: (K,) names of the thetas.
        about: what the numbers in the labels mean.
    """
    models = tuple(explored)
    count = next(iter(sampled.values())).shape[0]
    runs = next(iter(explored.values())).shape[0]
    each = [one for found in (sampled, explored) for values in found.values() for one in values]
    rows = rows_that_matter({str(number): one for number, one in enumerate(each)})
    figure = new_figure(TEXT, 0.45 + (0.3 + 0.16 * len(rows.order)) * len(models))
    axes = figure.subplots(len(models), 2, squeeze=False, sharex=True, sharey=True)
    y = np.arange(len(rows.order))
    for pair, model in zip(axes, models, strict=True):
        for ax, found, what in zip(
            pair, (sampled, explored), (f"{count} samplers", f"{runs} explorations"), strict=True
        ):
            for one in found[model]:
                ax.plot(
                    rows.own(one), y, model_look(model, models).marker, markersize=4, markerfacecolor="none",
                    markeredgecolor=model_color(model, models), markeredgewidth=0.8,
                )  # fmt: skip
            ax.set_title(f"{model_name(model)}, {what}")
            ax.grid()
            ax.tick_params(axis="y", length=0)
        pair[0].set_ylabel(about)
    axes[0, 0].set_yticks(y, rows.names(labels)[: len(y)])
    axes[0, 0].set_ylim(len(y) - 0.4, -0.6)
    for ax in axes[-1]:
        ax.set_xlabel(f"posterior{rows.unshown}")
    return figure
