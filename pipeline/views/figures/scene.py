"""The figure of a task's scene: the arm where motions start, the end effector's paths of people, names of objects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from pipeline.views import palette
from pipeline.views.figures.style import INK, TEXT, color, in_style, new_figure, small

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    from pipeline.arrays import BoolArray, FloatArray
    from pipeline.replay.picture import Picture

WIDTH, HEIGHT = 1050, 600  # pixels of the picture
_PALE = 0.3  # share of white, so that lines stand out
_BEHIND_M = 0.02  # what is so far behind something is hidden by it
_LARGE = 0.08  # share of the picture from which on a body is named in its middle and not above it
_APART = 3.0  # pixels between names
_STEPS = 150  # in which a name is moved up or down


@in_style
def scene_figure(picture: Picture, paths: FloatArray, names: Mapping[int, str]) -> Figure:
    """The scene with the demonstrations' paths; what something hides of them is dotted.

    Args:
        picture: what is seen.
        paths: (n, T, 3) m, of the end effector.
        names: of bodies, by index; those that the picture shows are written.
    """
    height, width = picture.distances.shape
    figure = new_figure(TEXT, 7.0 * height / width + 0.25)
    ax = figure.subplots()
    pale = picture.colours + (255 - picture.colours) * _PALE
    ax.imshow(pale.astype(np.uint8), interpolation="none", extent=(0, width, height, 0))
    places, far = picture.places(paths)
    shade = color(palette.DEMONSTRATION)
    hidden = _hidden(picture, places, far)
    strips = np.stack([places[:, :-1], places[:, 1:]], axis=2)
    behind = hidden[:, 1:]
    ax.add_collection(LineCollection(list(strips[~behind]), colors=[shade], linewidths=1.0, capstyle="round"))
    ax.add_collection(LineCollection(list(strips[behind]), colors=[shade], linewidths=0.8, linestyles=[(0, (1, 1.5))]))
    ends = (("start", places[:, 0], "o"), ("goal", places[:, -1], "s"))
    for word, points, mark in ends:
        ax.plot(
            points[:, 0], points[:, 1], mark, color="white", markeredgecolor=INK, markersize=3.6, markeredgewidth=0.8
        )
        _written(ax, word, np.nanmean(points, axis=0), weight="bold")
    for body, name in names.items():
        rows, columns = np.nonzero(picture.bodies == body)
        if rows.size > _LARGE * picture.bodies.size:
            _written(ax, name, np.array([np.median(columns), np.median(rows)]))
        elif rows.size:
            _written(ax, name, np.array([columns.mean(), rows.min()]))
    ax.set_xlim(0, width)
    ax.set_ylim(height, 0)
    ax.set_axis_off()
    handles = [
        Line2D([], [], color=shade, linewidth=1.0, label="demonstrations, paths of the end effector"),
        Line2D([], [], color=shade, linewidth=0.8, linestyle=(0, (1, 1.5)), label="behind something"),
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=2)
    figure.draw_without_rendering()
    _spread(ax)
    return figure


def _hidden(picture: Picture, places: FloatArray, far: FloatArray) -> BoolArray:
    """(n, T) whether something is in front of each point; nothing is in front of what is outside of the picture."""
    height, width = picture.distances.shape
    column, row = np.nan_to_num(places[..., 0], nan=-1), np.nan_to_num(places[..., 1], nan=-1)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    seen = picture.distances[np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int)]
    found: BoolArray = inside & (seen < far - _BEHIND_M)
    return found


def _written(ax: Axes, word: str, place: FloatArray, weight: str = "normal") -> None:
    """A word on a white ground above a place in the picture."""
    if not np.isfinite(place).all():
        return
    ground = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.75, "edgecolor": "none"}
    ax.text(
        place[0], place[1] - 8, word, ha="center", va="bottom", fontsize=small(), fontweight=weight, bbox=ground,
        clip_on=True, parse_math=False,
    )  # fmt: skip


def _spread(ax: Axes) -> None:
    """Move words into the picture, and up or down as little as keeps them from lying over others."""
    per_pixel = np.abs(ax.transData.inverted().transform((1, 1)) - ax.transData.inverted().transform((0, 0)))
    width, height = ax.get_xlim()[1], ax.get_ylim()[0]
    shifts = sorted(np.linspace(-height, height, 2 * _STEPS + 1).tolist(), key=abs)
    taken: list[tuple[float, float, float, float]] = []
    for text in sorted(ax.texts, key=lambda one: -one.get_position()[1]):
        left, right, top, bottom = _box(text, per_pixel)
        aside = max(0.0, _APART - left) - max(0.0, right - (width - _APART))

        def free(shift: float, box: tuple[float, ...] = (left + aside, right + aside, top, bottom)) -> bool:
            upper, lower = box[2] + shift, box[3] + shift
            inside = upper >= 0 and lower <= height
            return inside and not any(
                box[0] < other[1] and box[1] > other[0] and upper < other[3] and lower > other[2] for other in taken
            )

        shift = next((one for one in shifts if free(one)), 0.0)
        taken.append((left + aside, right + aside, top + shift - _APART, bottom + shift + _APART))
        x, y = text.get_position()
        text.set_position((x + aside, y + shift))


def _box(text: Text, per_pixel: FloatArray) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of a word with its ground, in pixels of the picture."""
    box = text.get_window_extent()
    (x, y), pad = text.get_position(), 0.2 * box.height * per_pixel[0]
    half, high = box.width * per_pixel[0] / 2 + pad, box.height * per_pixel[1]
    return float(x - half), float(x + half), float(y - high - pad), float(y + pad)
