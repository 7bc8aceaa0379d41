"""The style of figures for print, and writing them so that equal data give equal bytes.

Everything is drawn with matplotlib's objects, without pyplot and its global state. Sizes are those of a two-column
paper, in which no text is smaller than 7 points. Text in the SVG is drawn as outlines, so that no reader needs the
font.
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

COLUMN_IN, TEXT_IN = 3.33, 7.0  # width of a column and of the page's text, in inches
DPI = 300
TITLE_POINTS = 8
_DIGITS = 5  # decimals of positions, in units of the figure's size
INK = "#222222"
STYLE: dict[str, object] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so it is the same everywhere
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
    """A context in which matplotlib uses `STYLE`; saving needs it too, as ticks are made when a figure is drawn."""
    return style.context(["default", STYLE])


def in_style(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Make a function draw under `STYLE`, whatever the user's matplotlib settings are, and fix its figure's layout."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with styled():
            figure = draw(*args, **kwargs)
            _settle(figure)
            return figure

    return drawn


def _settle(figure: Figure) -> None:
    """Compute the layout once and round it, because the solver's last digits differ from run to run.

    It visits its variables in the order of their memory addresses.
    """
    for axes in figure.axes:  # a logarithmic axis needs a value above zero, and KLAggregate of one hypothesis is 0
        if axes.get_xscale() == "log" and not np.isfinite(axes.dataLim.minposx):
            axes.set_xscale("linear")
        if axes.get_yscale() == "log" and not np.isfinite(axes.dataLim.minposy):
            axes.set_yscale("linear")
    figure.draw_without_rendering()
    with mpl.rc_context({"figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)  # else a placeholder engine would make every saving draw the figure twice
    for axes in figure.axes:
        left, bottom, width, height = (round(float(edge), _DIGITS) for edge in axes.get_position(original=True).bounds)
        axes.set_position((left, bottom, width, height), which="original")


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure of this size; call it inside a function decorated by `in_style`."""
    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    return figure


def write_figure(folder: Path, name: str, figure: Figure) -> None:
    """Write `name`.svg and `name`.png (300 dpi), each whole or not at all.

    With the same matplotlib, equal figures give equal bytes: no date and no program name are written, and identifiers
    are fixed.
    """
    with styled():
        with written_whole(folder / f"{name}.svg") as stream:
            figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        with written_whole(folder / f"{name}.png") as stream:
            figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})


def color(rgb: palette.RGB) -> tuple[float, float, float]:
    """A colour of the palette, dark enough for paper, as matplotlib takes it: red, green and blue from 0 to 1."""
    red, green, blue = (channel / 255 for channel in palette.on_paper(rgb))
    return red, green, blue


def model_color(name: str, names: Sequence[str]) -> tuple[float, float, float]:
    """The colour of a model among those shown; it has the same hue as in the viewer."""
    return color(palette.model_color(name, tuple(names)))


def error_bars(axes: Axes, x: ArrayLike, y: ArrayLike, *, xerr: Any = None, yerr: Any = None) -> None:
    """Thin bars with end caps at (x, y). Their length to either side is a number or array, or two rows: down and up."""
    axes.errorbar(x, y, yerr, xerr, fmt="none", ecolor=INK, elinewidth=0.7, capsize=1.4, capthick=0.7)


def sequential_map() -> mpl.colors.Colormap:
    """The palette's sequential scale as a colour map, with white for masked values."""
    stops = [color(rgb) for rgb in palette.SEQUENTIAL]
    return mpl.colors.LinearSegmentedColormap.from_list("sequential", stops).with_extremes(bad="white")


def probability_axis(axes: Axes, label: str, top: float | None = 1.0) -> None:
    """Let the vertical axis run from zero to `top`, or as far as the data if it is None, with pale grid lines."""
    axes.set_ylim(0.0, top)
    axes.set_ylabel(label)
    axes.grid(axis="y")
