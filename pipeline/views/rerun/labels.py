"""Text in the viewer: only characters that its font has, and labels at given positions of a page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rerun as rr

from pipeline.views import palette

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

_RANGES = ((0x20, 0x7F), (0xA1, 0xAD), (0xAE, 0x149), (0x14A, 0x180), (0x391, 0x3A2), (0x3A3, 0x3CA), (0x410, 0x450))
_DRAWN = {chr(code) for start, stop in _RANGES for code in range(start, stop)} | set("\n–—‘’“”…•′″⅓−×≤≥≈√∞∑∫→←↑↓")


def drawable(text: str) -> str:
    """`text` with a question mark for each character that the viewer's font may lack, which would crash the viewer.

    Powers of units are raised: rad^2 becomes rad².
    """
    raised = text.replace("^2", "²").replace("^3", "³")
    return "".join(character if character in _DRAWN else "?" for character in raised)


def part(name: str) -> str:
    """`name` as one part of an entity path."""
    return rr.escape_entity_path_part(drawable(name))


def log_labels(
    recording: rr.RecordingStream,
    entity: str,
    positions: ArrayLike,
    texts: Sequence[str],
    *,
    static: bool = True,
    colors: Sequence[palette.RGB] = (palette.WHITE,),
) -> None:
    """Log labels on a 2-D page; the viewer centres each below its position.

    Args:
        recording: the recording that is logged to.
        entity: the path under which the labels are logged.
        positions: (n, 2) page coordinates.
        texts: (n,) the labels.
        static: whether they are shown at all times.
        colors: one colour for all, or (n,).
    """
    labels = [drawable(text) for text in texts]
    points = rr.Points2D(positions, radii=0.0, colors=list(colors), labels=labels, show_labels=True)
    recording.log(entity, points, static=static)
