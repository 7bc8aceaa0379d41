"""The style of figures for print, and writing them so that equal data give equal bytes.

Everything is drawn with matplotlib's objects, without pyplot and its global state. Sizes are those of a two-column
paper, in which no text is smaller than 7 points; `figures` in params.yaml can say otherwise, see `printed`. Text is
text in SVG and PDF, so that it can be searched, edited and read aloud. Colours never carry a meaning alone: models
differ in hatching and marks too, so that a grey print says the same.
"""

from __future__ import annotations

from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Figure  # every other module takes it from here

from pipeline.formats.files.atomic import written_whole
from pipeline.params import FigureSettings
from pipeline.views import palette
from pipeline.vocabulary import ATTRIBUTE_RULE, BOLTZMANN, BOLTZMANN_WEIGHTED, LESS, LESS_CLEAN_BANDWIDTH, PATH_SIZE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import AbstractContextManager

    from matplotlib.axes import Axes
    from matplotlib.container import BarContainer
    from numpy.typing import ArrayLike

P = ParamSpec("P")

COLUMN, TEXT = "column_in", "text_in"
"""The two widths of figures: of a column, and of the page's text."""
DPI = 300
_TITLE, _SMALL = 8 / 7.5, 7 / 7.5  # sizes of titles and of what is least, by the size of text
_DIGITS = 5  # decimals of positions, in units of the figure's size
INK = "#222222"
STYLE: dict[str, object] = {
    "font.family": "sans-serif",  # what a reader of the SVG takes that has no DejaVu Sans
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib, so it is the same everywhere
    "mathtext.fontset": "dejavusans",
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
    "hatch.linewidth": 0.7,
    "svg.fonttype": "none",
    "svg.hashsalt": "lessbench",
    "pdf.fonttype": 42,
}
_USUAL = FigureSettings()
_SETTINGS: ContextVar[FigureSettings] = ContextVar("figures", default=_USUAL)


@dataclass(frozen=True)
class Look:
    """How a model looks beside its colour.

    Attributes:
        hatch: of its bars.
        marker: of its points.
        line: pattern of its lines.
    """

    hatch: str
    marker: str
    line: Any = "-"


_DASHES = (0, (2, 1.2))
_LOOKS = {
    BOLTZMANN: Look("", "o"),
    LESS: Look("//////", "s"),
    ATTRIBUTE_RULE: Look("......", "^"),
    PATH_SIZE: Look("xxxxxx", "D"),
    BOLTZMANN_WEIGHTED: Look("------", "v", _DASHES),
    LESS_CLEAN_BANDWIDTH: Look("||||||", "P", _DASHES),
}
_OTHER_LOOKS = (Look("\\\\" * 3, "X"), Look("++++++", "*"))


@contextmanager
def printed(settings: FigureSettings) -> Iterator[None]:
    """A context in which figures are drawn and written in these sizes and formats."""
    token = _SETTINGS.set(settings)
    try:
        yield
    finally:
        _SETTINGS.reset(token)


def styled() -> AbstractContextManager[None]:
    """A context in which matplotlib uses `STYLE`; saving needs it too, as ticks are made when a figure is drawn."""
    text = _SETTINGS.get().font_pt
    sizes = {
        "font.size": text, "axes.labelsize": text, "axes.titlesize": text * _TITLE, "figure.titlesize": text * _TITLE,
        "xtick.labelsize": text * _SMALL, "ytick.labelsize": text * _SMALL, "legend.fontsize": text * _SMALL,
        "legend.title_fontsize": text * _TITLE,
    }  # fmt: skip
    return style.context(["default", STYLE | sizes])


def small() -> float:
    """The size of the least text, in points."""
    return _SETTINGS.get().font_pt * _SMALL


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


def new_figure(width: str, height_in: float) -> Figure:
    """An empty figure; call it inside a function decorated by `in_style`.

    Args:
        width: COLUMN or TEXT.
        height_in: inches, with text of the usual size; larger text makes it higher.
    """
    settings = _SETTINGS.get()
    figure = Figure(figsize=(getattr(settings, width), height_in * settings.font_pt / _USUAL.font_pt))
    FigureCanvasAgg(figure)
    return figure


def write_figure(folder: Path, name: str, figure: Figure, caption: str = "") -> None:
    """Write `name`.svg, which the report and DVC show, and the formats of the settings, each whole or not at all.

    With the same matplotlib, equal figures give equal bytes: no date and no program name are written, and identifiers
    are fixed.

    Args:
        folder: where to.
        name: of the files.
        figure: what is written; a PNG has 300 dpi.
        caption: goes into `name`.txt if it is not empty.
    """
    nameless: dict[str, dict[str, None]] = {
        "svg": {"Date": None, "Creator": None},
        "png": {"Software": None},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    }
    with styled():
        for kind in ("svg", *_SETTINGS.get().formats):
            with written_whole(folder / f"{name}.{kind}") as stream:
                figure.savefig(stream, format=kind, dpi=DPI if kind == "png" else "figure", metadata=nameless[kind])
    if caption:
        with written_whole(folder / f"{name}.txt") as stream:
            stream.write(f"{caption}\n".encode())


def color(rgb: palette.RGB) -> tuple[float, float, float]:
    """A colour of the palette, dark enough for paper, as matplotlib takes it: red, green and blue from 0 to 1."""
    red, green, blue = (channel / 255 for channel in palette.on_paper(rgb))
    return red, green, blue


def model_color(name: str, names: Sequence[str]) -> tuple[float, float, float]:
    """The colour of a model among those shown; it has the same hue as in the viewer."""
    return color(palette.model_color(name, tuple(names)))


def model_look(name: str, names: Sequence[str]) -> Look:
    """How a model looks among those shown, in grey print too; models without a look take the spare ones in order."""
    if name in _LOOKS:
        return _LOOKS[name]
    others = [other for other in names if other not in _LOOKS]
    return _OTHER_LOOKS[others.index(name) % len(_OTHER_LOOKS)]


def model_bars(
    axes: Axes, places: ArrayLike, values: ArrayLike, width: float, model: str, models: Sequence[str], **settings: Any
) -> BarContainer:
    """Upright bars of a model in its colour and hatching; see `lying_bars`."""
    return axes.bar(places, values, width, **_filled(model, models), **settings)


def lying_bars(
    axes: Axes, places: ArrayLike, values: ArrayLike, width: float, model: str, models: Sequence[str], **settings: Any
) -> BarContainer:
    """Lying bars of a model in its colour and hatching.

    Args:
        axes: where they are drawn.
        places, values: (n,) where bars stand, and how long they are.
        width: of each.
        model: whose they are.
        models: those shown together.
        settings: further ones of matplotlib, such as `label`.
    """
    return axes.barh(places, values, width, **_filled(model, models), **settings)


def _filled(model: str, models: Sequence[str]) -> dict[str, Any]:
    hatch = model_look(model, models).hatch
    return {"facecolor": model_color(model, models), "edgecolor": "white", "hatch": hatch, "linewidth": 0}


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
