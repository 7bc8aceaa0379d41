"""Figures for print: one style, and files that are the same bytes for the same data.

Everything is drawn with matplotlib's objects, without pyplot and its global state. Sizes are those of a two-column
paper; nothing is smaller than 7 points there. Text in the SVG is outlines, so that no reader needs our fonts.
"""

from __future__ import annotations

from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Figure  # every other module takes it from here

from pipeline.formats.files.atomic import written_whole
from pipeline.views import palette

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

P = ParamSpec("P")

COLUMN_IN, TEXT_IN = 3.33, 7.0  # width of a column, and of the text
DPI = 300
TITLE_POINTS = 8
_DIGITS = 5  # of the figure's size
INK = "#222222"
STYLE: dict[str, object] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
    "mathtext.fontset": "dejavusans",
    "font.size": 7.5,
    "axes.titlesize": TITLE_POINTS,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.titlelocation": "left",
    "axes.titlepad": 5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "axes.axisbelow": True,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.handlelength": 1.2,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 1.0,
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.w_pad": 0.02,
    "figure.constrained_layout.h_pad": 0.02,
    "figure.constrained_layout.wspace": 0.04,
    "svg.fonttype": "path",
    "svg.hashsalt": "lessbench",
}


def styled() -> AbstractContextManager[None]:
    """Within it matplotlib makes and draws everything in `STYLE`; ticks are made when a figure is drawn."""
    return style.context(["default", STYLE])


def in_style(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw under `STYLE`, whatever the reader's own matplotlib settings are, and lay the figure out for good."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with styled():
            figure = draw(*args, **kwargs)
            _settle(figure)
            return figure

    return drawn


def _settle(figure: Figure) -> None:
    """Lay out once and round: the layout's solver visits its variables by address, so its last digits change."""
    for axes in figure.axes:  # a logarithmic axis needs a value above zero; KLAggregate of one hypothesis is 0
        if axes.get_xscale() == "log" and not np.isfinite(axes.dataLim.minposx):
            axes.set_xscale("linear")
        if axes.get_yscale() == "log" and not np.isfinite(axes.dataLim.minposy):
            axes.set_yscale("linear")
    figure.draw_without_rendering()
    with mpl.rc_context({"figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)  # with a placeholder for it, each saving would draw the figure twice
    for axes in figure.axes:
        left, bottom, width, height = (round(float(edge), _DIGITS) for edge in axes.get_position(original=True).bounds)
        axes.set_position((left, bottom, width, height), which="original")


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure of a given size; call it inside a function that is `in_style`."""
    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    return figure


def write_figure(folder: Path, name: str, figure: Figure) -> None:
    """Write `name`.svg and `name`.png (300 dpi), each whole or not at all.

    Equal figures give equal bytes with the same matplotlib: no dates, no program, fixed identifiers.
    """
    with styled():
        with written_whole(folder / f"{name}.svg") as stream:
            figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        with written_whole(folder / f"{name}.png") as stream:
            figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})


def color(rgb: palette.RGB) -> tuple[float, float, float]:
    """A colour of the palette as matplotlib takes it."""
    red, green, blue = (channel / 255 for channel in rgb)
    return red, green, blue


def model_color(name: str, names: Sequence[str]) -> tuple[float, float, float]:
    """The colour of one model among those shown, the same as in the viewer."""
    return color(palette.model_color(name, tuple(names)))


def error_bars(axes: Axes, x: ArrayLike, y: ArrayLike, *, xerr: Any = None, yerr: Any = None) -> None:
    """Thin bars with ends at (x, y); the reach is one number or array, or two rows: down and up."""
    axes.errorbar(x, y, yerr, xerr, fmt="none", ecolor=INK, elinewidth=0.7, capsize=1.4, capthick=0.7)


def sequential_map() -> mpl.colors.Colormap:
    """The palette's sequential scale; what is masked stays white."""
    stops = [color(rgb) for rgb in palette.SEQUENTIAL]
    return mpl.colors.LinearSegmentedColormap.from_list("sequential", stops).with_extremes(bad="white")


def with_unit(name: str, unit: str) -> str:
    """A quantity and its unit as an axis says them."""
    return f"{name} ({unit.replace('^2', '²').replace('^3', '³')})" if unit else name


def probability_axis(axes: Axes, label: str, top: float | None = 1.0) -> None:
    """Let the vertical axis run from zero to `top`, or as far as there is something to show, with quiet lines across."""
    axes.set_ylim(0.0, top)
    axes.set_ylabel(label)
    axes.grid(axis="y")
