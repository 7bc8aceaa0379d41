"""The figures of the study of real trips."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from matplotlib.collections import LineCollection

from pipeline.studies.trips.path_models import (
    BOLTZMANN,
    BOLTZMANN_CORRECTED,
    EXPANDED_PATH_SIZE,
    LESS,
    LESS_LINKS,
    LESS_POOLED,
    MODELS,
    NESTED_CORRECTED,
    NESTED_LOGIT,
    PATH_SIZE,
    RECURSIVE_LOGIT,
)
from pipeline.views import palette
from pipeline.views.figures.style import INK, TEXT, color, in_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = {
    RECURSIVE_LOGIT: (0, 0, 0),
    BOLTZMANN_CORRECTED: palette.VERMILLION,
    EXPANDED_PATH_SIZE: palette.PINK,
    BOLTZMANN: palette.BLUE,
    PATH_SIZE: palette.SKY,
    LESS: palette.ORANGE,
    LESS_POOLED: palette.YELLOW,
    LESS_LINKS: palette.GREEN,
    NESTED_LOGIT: (120, 120, 120),
    NESTED_CORRECTED: (120, 70, 30),
}
MARKERS = dict(zip(COLORS, "*vXoDsPd^<", strict=True))  # so that models differ in grey print too
SHOWN = (RECURSIVE_LOGIT, BOLTZMANN, LESS)
LEAST_SHARE = 0.005


@in_style
def scores_figure(scores: pl.DataFrame) -> Figure:
    """How much better each model predicts the path taken than corrected Boltzmann, by sampler and size of sets.

    Args:
        scores: rows of trips_scores.
    """
    samplers = scores["sampler"].unique().sort().to_list()
    figure = new_figure(TEXT, 2.9)
    axes = figure.subplots(1, len(samplers), sharey=True, squeeze=False)[0]
    models = [model for model in MODELS if model != BOLTZMANN_CORRECTED]
    for ax, sampler in zip(axes, samplers, strict=True):
        for place, model in enumerate(models):
            rows = scores.filter(sampler=sampler, model=model).sort("set_size")
            spread = 1.05 ** (place - len(models) / 2)  # side by side, so that intervals do not hide one another
            middle = rows["difference"].to_numpy()
            reach = np.stack(
                [middle - rows["difference_lower"].to_numpy(), rows["difference_upper"].to_numpy() - middle]
            )
            ax.errorbar(
                rows["set_size"].to_numpy() * spread, middle, reach, color=color(COLORS[model]), marker=MARKERS[model],
                markersize=3, linewidth=0.9, elinewidth=0.7, label=MODELS[model],
            )  # fmt: skip
        ax.axhline(0, color=color(COLORS[BOLTZMANN_CORRECTED]), linewidth=0.8)
        ax.set_xscale("log")
        ax.set_title(f"sampler {sampler}")
        ax.set_xlabel("paths drawn for each trip")
        ax.grid(axis="y")
    axes[0].set_ylabel("lead over corrected Boltzmann\n(nat per held-out trip)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


@in_style
def samplers_figure(angles: pl.DataFrame) -> Figure:
    """How far apart the weights lie that different samplers lead to.

    Args:
        angles: rows of trips_angles.
    """
    figure = new_figure(TEXT, 2.6)
    pairs = angles.select("sampler", "other_sampler").unique().sort("sampler", "other_sampler").rows()
    axes = figure.subplots(1, len(pairs), sharey=True, squeeze=False)[0]
    for ax, (one, other) in zip(axes, pairs, strict=True):
        for model in MODELS:
            rows = angles.filter(sampler=one, other_sampler=other, model=model).sort("set_size")
            if rows.height:
                ax.plot(
                    rows["set_size"], rows["angle_deg"], color=color(COLORS[model]), marker=MARKERS[model],
                    markersize=3, label=MODELS[model],
                )  # fmt: skip
        ax.set_xscale("log")
        ax.set_title(f"{one} and {other}")
        ax.set_xlabel("paths drawn for each trip")
        ax.grid(axis="y")
    axes[0].set_ylim(0, 1.05 * np.max(angles["angle_deg"].to_numpy()))
    axes[0].set_ylabel("angle between the weights (degrees)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


@in_style
def routes_figure(town: pl.DataFrame, routes: pl.DataFrame, links: pl.DataFrame) -> Figure:
    """The network around some trips, and the share of each route under three models; the route taken is black.

    Args:
        town: rows of trips_map.
        routes, links: rows of trips_routes and trips_route_links.
    """
    trips = routes["trip"].unique(maintain_order=True).to_list()
    figure = new_figure(TEXT, 2.3 * len(trips))
    axes = figure.subplots(len(trips), len(SHOWN), squeeze=False)
    for row, trip in zip(axes, trips, strict=True):
        drawn = links.filter(trip=trip).join(town, on="link", how="inner", maintain_order="left")
        for ax, model in zip(row, SHOWN, strict=True):
            shares = routes.filter(trip=trip, model=model)
            _routes(ax, town, drawn, shares)
            taken = shares.filter(route=0)["share"][0]
            ax.set_title(f"trip {trip}, {_short(model)}\nroute taken: {100 * taken:.2g} %")
    return figure


def _short(model: str) -> str:
    return "all paths" if model == RECURSIVE_LOGIT else MODELS[model]


def _routes(ax: Axes, town: pl.DataFrame, drawn: pl.DataFrame, shares: pl.DataFrame) -> None:
    """Links as wide as the share of the routes that use them, and the route taken as a thin line on top."""
    taken = drawn.filter(route=0)
    points = _lines(taken).reshape(-1, 2)
    middle, reach = (points.max(axis=0) + points.min(axis=0)) / 2, np.ptp(points, axis=0).max() * 0.65 + 0.2
    around = _lines(town)
    around = around[(np.abs(around - middle) <= reach).all(axis=2).any(axis=1)]
    ax.add_collection(LineCollection(list(around), colors=[(0.8, 0.8, 0.8)], linewidths=0.4))
    used = (
        drawn.join(shares.select("route", "share"), on="route", how="inner", maintain_order="left")
        .group_by("link", maintain_order=True)
        .agg(pl.col("share").sum(), pl.col("start_x", "start_y", "end_x", "end_y").first())
        .filter(pl.col("share") > LEAST_SHARE)
    )
    widths = 0.5 + 4.5 * np.minimum(used["share"].to_numpy(), 1.0)
    ax.add_collection(
        LineCollection(list(_lines(used)), colors=[color(palette.ORANGE)], linewidths=widths, capstyle="round")
    )
    ax.add_collection(LineCollection(list(_lines(taken)), colors=[INK], linewidths=0.7))
    ax.set_xlim(middle[0] - reach, middle[0] + reach)
    ax.set_ylim(middle[1] - reach, middle[1] + reach)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.spines[:].set_visible(False)


def _lines(links: pl.DataFrame) -> np.ndarray:
    """(L, 2, 2) the ends of links."""
    return links.select("start_x", "start_y", "end_x", "end_y").to_numpy().reshape(-1, 2, 2)
