"""Logs the densities and the text of an inspection to Rerun.

Rerun has axes for time alone, so curves and the map are drawn as 2-D shapes on a page of cells: column g of a page is
value g of its grid, and rows run downwards.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from pipeline.views import palette
from pipeline.views.feature_axis import with_unit
from pipeline.views.rerun.labels import drawable, log_labels, part
from pipeline.vocabulary import LESS, model_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pipeline.arrays import FloatArray
    from pipeline.views.rerun.records import Inspection
    from pipeline.views.task_summary import DensityCurve, DensityMap

    Bounds = tuple[tuple[float, float], tuple[float, float]]
    Marks = Mapping[str, tuple[FloatArray, palette.RGB]]

_CURVE_SHAPE = 0.66  # height of a curve's page, as a share of its width
_RUG = 0.05  # height of the marks below a curve, as a share of the page's height
_LINE, _HAIR = rr.Radius.ui_points(1.3), rr.Radius.ui_points(0.4)


def log_densities(recording: rr.RecordingStream, inspection: Inspection) -> None:
    """Log the curves of each feature under `/density`, and the map of two features under `/map`."""
    for curve in inspection.curves:
        log_curve(recording, curve)
    log_map(recording, inspection.map)


def log_summary(recording: rr.RecordingStream, inspection: Inspection) -> None:
    """Log the text under `/summary`: the summary of the stage, the highest probabilities and what the colours mean."""
    text = f"{inspection.summary.rstrip()}\n\n{_legend(inspection)}"
    recording.log("summary", rr.TextDocument(drawable(text), media_type=rr.MediaType.MARKDOWN), static=True)


def curve_entity(feature: str) -> str:
    """The entity under which the density along a feature is logged."""
    return f"density/{part(feature)}"


def curve_bounds(curve: DensityCurve) -> Bounds:
    """Horizontal and vertical extent of a curve's view, in cells."""
    return _with_margins(curve.grid.size, _CURVE_SHAPE * curve.grid.size)


def map_bounds(density: DensityMap) -> Bounds:
    """Horizontal and vertical extent of the map's view, in cells."""
    height, width = density.density.shape
    return _with_margins(width, height)


def _with_margins(width: float, height: float) -> Bounds:
    return (-0.15 * width, 1.03 * width), (-0.1 * height, 1.22 * height)


def log_curve(recording: rr.RecordingStream, curve: DensityCurve, marks: Marks | None = None) -> None:
    """Log both densities along one feature, and marks where the demonstrations are.

    Args:
        recording: the recording that is logged to.
        curve: the densities.
        marks: values and colour of each kind of demonstrations, by name; by default those of the curve.
    """
    marks = marks or {"demonstrations": (curve.demonstrations, palette.DEMONSTRATION)}
    entity, width = curve_entity(curve.feature), float(curve.grid.size)
    height = _CURVE_SHAPE * width
    top = float(max(curve.raw.max(), curve.adjusted.max())) / 0.95
    columns = _cells(curve.grid, curve.grid)
    for name, values, color in (
        ("alternatives", curve.raw, palette.RAW_DENSITY),
        ("weighted_by_less", curve.adjusted, palette.MODELS[LESS]),
    ):
        line = np.stack([columns, height * (1 - values / top)], axis=1)
        strip = rr.LineStrips2D([line], radii=_LINE, colors=color, draw_order=2.0)
        recording.log(f"{entity}/{name}", strip, static=True)
    for row, (name, (values, color)) in enumerate(marks.items()):
        foot, head = height * (1 - row * _RUG), height * (1 - (row + 1) * _RUG)
        rug = [[(x, foot), (x, head)] for x in _cells(values, curve.grid)]
        recording.log(
            f"{entity}/{part(name)}", rr.LineStrips2D(rug, radii=_LINE, colors=color, draw_order=3.0), static=True
        )
    up = ticks(0.0, top)
    _log_axes(recording, entity, (width, height), curve.grid, up, height * up / top)
    _log_axis_names(
        recording,
        entity,
        (width, height),
        with_unit(curve.feature, curve.unit, curve.over_time),
        f"per {curve.unit}",
    )
    names = ["every alternative alike", "weighted by LESS", *marks]
    colors = [palette.RAW_DENSITY, palette.MODELS[LESS], *(color for _, color in marks.values())]
    positions = [(0.8 * width, row * 0.08 * height) for row in range(len(names))]
    log_labels(recording, f"{entity}/legend", positions, names, colors=colors)


def log_map(recording: rr.RecordingStream, density: DensityMap, points: Marks | None = None) -> None:
    """Log the density over two features as an image under `/map`, and the demonstrations as points.

    Args:
        recording: the recording that is logged to.
        density: the density to draw as an image.
        points: (n, 2) values and colour of each kind of demonstrations, by name; by default those of the map.
    """
    if points is None:
        points = {"demonstrations": (density.demonstrations, palette.DEMONSTRATION)}
    height, width = density.density.shape
    # square root, because a single dense spot (features are often zero) would leave the rest dark on a linear scale
    share = np.sqrt(density.density[::-1] / density.density.max())
    smooth = rr.components.MagnificationFilter.Linear
    image = rr.Image(palette.sequential(share, 0.0, 1.0), magnification_filter=smooth)
    recording.log("map/density", image, static=True)
    for name, (values, color) in points.items():
        log_map_points(recording, density, name, values, color)
    up = ticks(density.y[0], density.y[-1])
    _log_axes(recording, "map", (float(width), float(height)), density.x, up, _cells(up, density.y))
    axes = zip(density.features, density.units, density.over_time, strict=True)
    names = [with_unit(*axis) for axis in axes]
    _log_axis_names(recording, "map", (float(width), float(height)), names[0], names[1])


def log_map_points(
    recording: rr.RecordingStream,
    density: DensityMap,
    name: str,
    values: FloatArray,
    color: palette.RGB,
    *,
    static: bool = True,
) -> None:
    """Log (n, 2) values as points on the map."""
    positions = np.stack([_cells(values[:, 0], density.x), len(density.y) - _cells(values[:, 1], density.y)], axis=1)
    for suffix, radius, fill in ((" rims", 6.0, palette.BACKGROUND), ("", 4.5, color)):
        dots = rr.Points2D(positions, radii=rr.Radius.ui_points(radius), colors=fill, draw_order=31.0 - radius / 10)
        recording.log(f"map/{part(name + suffix)}", dots, static=static)


def _log_axes(
    recording: rr.RecordingStream,
    entity: str,
    page: tuple[float, float],
    grid: FloatArray,
    up: FloatArray,
    heights: FloatArray,
) -> None:
    """Log numbers below and to the left of a page, and a line along its bottom."""
    width, height = page
    across = ticks(grid[0], grid[-1])
    marks = [(x, height) for x in _cells(across, grid)]
    marks += [(-0.07 * width, height - y - 0.04 * height) for y in heights]
    log_labels(recording, f"{entity}/numbers", marks, [f"{value:g}" for value in (*across, *up)])
    bottom = rr.LineStrips2D([[(0.0, height), (width, height)]], radii=_HAIR, colors=palette.GREY)
    recording.log(f"{entity}/axis", bottom, static=True)


def _log_axis_names(
    recording: rr.RecordingStream, entity: str, page: tuple[float, float], across: str, up: str
) -> None:
    width, height = page
    log_labels(
        recording, f"{entity}/axis_names", [(0.5 * width, 1.1 * height), (0.02 * width, -0.1 * height)], [across, up]
    )


def _cells(values: FloatArray, grid: FloatArray) -> FloatArray:
    """Page coordinates of values; the centre of cell g is at g + 1/2."""
    cells: FloatArray = (np.asarray(values) - grid[0]) / (grid[1] - grid[0]) + 0.5
    return cells


def ticks(low: float, high: float) -> FloatArray:
    """Three to seven round numbers between `low` and `high`."""
    rough = (high - low) / 4
    magnitude = 10.0 ** np.floor(np.log10(rough))
    step = min((1, 2, 2.5, 5, 10), key=lambda factor: abs(factor * magnitude - rough)) * magnitude
    # adding 0.0 turns -0.0 into 0.0
    return np.asarray(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step + 0.0)


def _legend(inspection: Inspection) -> str:
    final = {model: posterior[-1] for model, posterior in inspection.posteriors.items()}
    names = [model_name(model) for model in final]
    shown = inspection.rows
    order = [int(k) for k in shown.order[:3]]
    if inspection.nearest_truth is not None and inspection.nearest_truth not in order:
        order.append(inspection.nearest_truth)
    names_of = dict(
        zip(shown.order.tolist(), shown.names(inspection.theta_labels, inspection.nearest_truth), strict=False)
    )
    rows = [f"| {names_of[k]} | " + " | ".join(f"{p[k]:.3f}" for p in final.values()) + " |" for k in order]
    return "\n".join(
        [
            "#### Most probable after all demonstrations",
            f"| {inspection.theta_meaning} | {' | '.join(names)} |",
            f"|---|{'---|' * len(names)}",
            *rows,
            "",
            "#### Colours",
            "- **Paths**: pink, demonstrations; white, the one that is playing; blue to yellow, alternatives by LESS "
            "weight, from those with many look-alikes (low) to rare ones (high).",
            "- **Densities**: grey, every alternative counts the same; orange, each counts as LESS weighs it; pink, "
            "where the demonstrations are.",
            "- **Posteriors**: bar and number, after the demonstrations played so far; white line, after all of them.",
            *(
                [
                    "- **True**: the hypothesis nearest to the mean of what the simulated people truly want, as their "
                    "recordings say; white in the weights and among three features."
                ]
                if inspection.nearest_truth is not None
                else []
            ),
            "",
            "#### Timelines",
            "The time panel below has two: `replay`, the clock, and `demonstrations`, on which each step (arrow keys) "
            "is one demonstration. Plots follow the one that is chosen.",
        ]
    )
