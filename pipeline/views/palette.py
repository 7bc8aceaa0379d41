"""The colours of every picture, in the viewer and on paper, which colour-blind readers can tell apart too.

Qualitative colours are those of M. Okabe and K. Ito, "Color Universal Design" (2008). The sequential scale follows
cividis (Nunez, Anderton and Renslow, PLOS ONE 13, 2018), whose order is visible in grey and with every kind of colour
vision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline import vocabulary

if TYPE_CHECKING:
    from pipeline.arrays import ByteArray

RGB = tuple[int, int, int]

BLUE: RGB = (0, 114, 178)
ORANGE: RGB = (230, 159, 0)
GREEN: RGB = (0, 158, 115)
PINK: RGB = (204, 121, 167)
SKY: RGB = (86, 180, 233)
VERMILLION: RGB = (213, 94, 0)
YELLOW: RGB = (240, 228, 66)
GREY: RGB = (150, 150, 150)
WHITE: RGB = (255, 255, 255)
LINE_CONTRAST = 3.0
"""What lines and marks must have against the background, after WCAG 2.2 (1.4.11)."""
BACKGROUND: RGB = (24, 26, 31)
ROOM: RGB = (58, 62, 70)
GROUND: RGB = (74, 78, 86)

MODELS: dict[str, RGB] = {
    vocabulary.BOLTZMANN: BLUE, vocabulary.LESS: ORANGE, vocabulary.ATTRIBUTE_RULE: GREEN, vocabulary.PATH_SIZE: SKY,
}  # fmt: skip
VARIANTS: dict[str, RGB] = {vocabulary.BOLTZMANN_WEIGHTED: VERMILLION, vocabulary.LESS_CLEAN_BANDWIDTH: GREEN}
"""Variants of models, which stand beside the plain ones alone."""
_OTHER_MODELS = (VERMILLION, YELLOW)
DEMONSTRATION = PINK
SETS: dict[str, RGB] = {"Xi_L": VERMILLION, "Xi_B": PINK}
"""The two demonstration sets of the grid world that are examined closely."""
RAW_DENSITY = GREY

SEQUENTIAL: tuple[RGB, ...] = (
    (0, 34, 78),
    (42, 63, 109),
    (87, 93, 109),
    (125, 124, 120),
    (165, 156, 116),
    (210, 192, 96),
    (254, 232, 56),
)
"""Evenly spaced stops of the sequential scale, low to high."""

PATHS: tuple[RGB, ...] = ((46, 88, 158), (122, 141, 150), YELLOW)
"""From blue to yellow, for thin lines on the viewer's dark background, where the dark end of cividis would vanish."""


def contrast(one: RGB, other: RGB) -> float:
    """Contrast ratio of two colours, 1 to 21 (WCAG 2.2); 3 is asked of lines and marks, 4.5 of text."""
    lighter, darker = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def on_paper(color: RGB) -> RGB:
    """The colour as it is drawn on white: darker where it would not stand out, in the same hue; white stays white."""
    if color == WHITE:
        return WHITE
    shade = 1.0
    while contrast(found := _darker(color, shade), WHITE) < LINE_CONTRAST and shade > 0:
        shade -= 0.01
    return found


def _darker(color: RGB, shade: float) -> RGB:
    red, green, blue = (round(shade * channel) for channel in color)
    return red, green, blue


def _luminance(color: RGB) -> float:
    parts = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (channel / 255 for channel in color)]
    return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]


def model_color(name: str, names: tuple[str, ...]) -> RGB:
    """The colour of a model among those shown together; models without a colour take the spare ones in order."""
    known = MODELS | VARIANTS
    if name in known:
        return known[name]
    others = [other for other in names if other not in known]
    return _OTHER_MODELS[others.index(name) % len(_OTHER_MODELS)]


def sequential(values: Any, low: float, high: float) -> ByteArray:
    """Colours of values on the sequential scale.

    Args:
        values: (...) numbers; those outside the range from `low` to `high` get the colour of the nearer end.
        low, high: the values at the two ends of the scale; if they are equal, every value gets the middle colour.

    Returns:
        (..., 3) red, green, blue.
    """
    return _along(SEQUENTIAL, values, low, high)


def path_colors(values: Any, low: float, high: float) -> ByteArray:
    """Colours of paths by LESS weight, from blue (low) to yellow (high); arguments as in `sequential`."""
    return _along(PATHS, values, low, high)


def _along(scale: tuple[RGB, ...], values: Any, low: float, high: float) -> ByteArray:
    values = np.asarray(values, dtype=np.float64)
    share = np.clip((values - low) / (high - low), 0.0, 1.0) if high > low else np.full(values.shape, 0.5)
    stops = np.linspace(0.0, 1.0, len(scale))
    channels = [np.interp(share, stops, channel) for channel in np.array(scale, dtype=np.float64).T]
    colors: ByteArray = np.rint(np.stack(channels, axis=-1)).astype(np.uint8)
    return colors
