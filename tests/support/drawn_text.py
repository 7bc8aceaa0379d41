"""The text that drawing a figure puts on the page, and whether it can be read."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from pipeline.views.figures.style import styled


def drawn(figure: Figure) -> list[Text]:
    """Every text once; ticks beyond their axis are not drawn and so not here."""
    found: list[Text] = []
    draw = Text.draw

    def noted(self: Text, renderer: object, *args: object, **kwargs: object) -> None:
        found.append(self)
        draw(self, renderer, *args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", noted)
        with styled():
            figure.canvas.draw()
    return [text for text in dict.fromkeys(found) if text.get_visible() and text.get_text().strip()]


def unreadable(figure: Figure) -> list[str]:
    """Text that is smaller than 7 points, leaves the page, or lies over other text by a pixel or more."""
    page, wrong, boxes = figure.bbox, [], []
    for text in drawn(figure):
        box = text.get_window_extent()
        if text.get_fontsize() < 7:
            wrong.append(f"small: {text.get_text()}")
        if box.x0 <= page.x0 - 1 or box.x1 >= page.x1 + 1 or box.y0 <= page.y0 - 1 or box.y1 >= page.y1 + 1:
            wrong.append(f"off the page: {text.get_text()}")
        for other, taken in boxes:
            across = min(box.x1, taken.x1) - max(box.x0, taken.x0)
            up = min(box.y1, taken.y1) - max(box.y0, taken.y0)
            if across >= 1 and up >= 1:
                wrong.append(f"{text.get_text()} over {other}")
        boxes.append((text.get_text(), box))
    return wrong
