"""Draws time and memory against the number of alternatives, from the results of `benchmarks/density.py`."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.measuring import Growth
from pipeline.views import palette
from pipeline.views.figures.style import TEXT, color, in_style, new_figure, small, write_figure

COLORS = (palette.BLUE, palette.ORANGE, palette.VERMILLION, palette.PINK)
LARGEST = 10_000_000


def draw_scale(costs: Mapping[str, Any], path: Path, names: Sequence[str]) -> None:
    """Write the picture to `path`, as PNG."""
    with tempfile.TemporaryDirectory() as folder:
        write_figure(Path(folder), "scale", _figure(costs, names))
        path.write_bytes((Path(folder) / "scale.png").read_bytes())


@in_style
def _figure(costs: Mapping[str, Any], names: Sequence[str]) -> Figure:
    figure = new_figure(TEXT, 2.9)
    time, memory = figure.subplots(1, 2)
    for name, rgb, marker in zip(names, COLORS, "osD^", strict=True):
        for axes, unit in ((time, "processor s"), (memory, "MB")):
            sizes, values = series(costs, name, unit)
            if not len(sizes):
                continue
            axes.plot(sizes, values, color=color(rgb), marker=marker, markersize=3.5, label=name)
            if axes is time and len(sizes) > 1 and sizes[-1] < LARGEST:
                growth = Growth.fitted(sizes.tolist(), values.tolist())
                beyond = np.geomspace(sizes[-1], LARGEST, 20)
                axes.plot(beyond, [growth.at(size) for size in beyond], color=color(rgb), linestyle=":", linewidth=0.8)
    for axes, title, label in (
        (time, "Time. Dotted: beyond what was measured", "processor time (s)"),
        (memory, "Memory", "peak memory of the process (MB)"),
    ):
        axes.set(xscale="log", yscale="log", xlabel="alternatives", ylabel=label, title=title)
        axes.grid()
    time.axhline(3600, color="#888888", linewidth=0.5)
    time.annotate("an hour", (LARGEST, 3600), ha="right", va="bottom", fontsize=small(), color="#666666")
    figure.legend(*time.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def series(costs: Mapping[str, Any], name: str, unit: str) -> tuple[np.ndarray, np.ndarray]:
    """Sizes and values of one line, in ascending order of size."""
    pattern = re.compile(rf"{re.escape(name)}, N = (\d+), {re.escape(unit)}")
    points = sorted((int(match[1]), float(costs[key])) for key in costs if (match := pattern.fullmatch(key)))
    return np.array([size for size, _ in points]), np.array([value for _, value in points])
