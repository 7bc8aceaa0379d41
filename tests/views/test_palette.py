"""Colours stand out from their background, and models from each other in grey print."""

from __future__ import annotations

import re
from itertools import combinations

import pytest

from pipeline.views import palette
from pipeline.views.figures.style import INK, color
from pipeline.views.palette import LINE_CONTRAST, WHITE, contrast, on_paper
from pipeline.views.report import html
from pipeline.vocabulary import BOLTZMANN, LESS

NAMED = {name: value for name, value in vars(palette).items() if name.isupper() and isinstance(value, tuple)}
INKS = {name: rgb for name, rgb in NAMED.items() if len(rgb) == 3 and isinstance(rgb[0], int)}
OF_ROOM = {"BACKGROUND", "ROOM", "GROUND", "WHITE"}
TEXT_CONTRAST = 4.5


def rgb(code: str) -> palette.RGB:
    digits = code if len(code) == 6 else "".join(digit * 2 for digit in code)
    return int(digits[:2], 16), int(digits[2:4], 16), int(digits[4:], 16)


def test_contrast_is_that_of_the_standard() -> None:
    assert contrast((0, 0, 0), WHITE) == pytest.approx(21)
    assert contrast(WHITE, (119, 119, 119)) == pytest.approx(4.48, abs=0.01)  # #777, the standard's own example
    assert contrast(palette.YELLOW, WHITE) < LINE_CONTRAST


@pytest.mark.parametrize("name", sorted(set(INKS) - OF_ROOM))
def test_marks_stand_out_on_paper_and_in_the_viewer(name: str) -> None:
    assert contrast(on_paper(INKS[name]), WHITE) >= LINE_CONTRAST
    assert contrast(INKS[name], palette.BACKGROUND) >= LINE_CONTRAST
    assert color(INKS[name]) == tuple(channel / 255 for channel in on_paper(INKS[name]))


def test_what_is_dark_enough_stays_as_it_is() -> None:
    assert on_paper(palette.BLUE) == palette.BLUE
    assert on_paper(WHITE) == WHITE  # of open marks
    assert on_paper(palette.ORANGE) != palette.ORANGE


def test_boltzmann_and_less_differ_in_grey_print() -> None:
    shown = [on_paper(palette.MODELS[model]) for model in (BOLTZMANN, LESS)]
    assert contrast(*shown) >= 1.5
    assert contrast(palette.MODELS[BOLTZMANN], palette.MODELS[LESS]) >= 1.5  # in the viewer


def test_the_sequential_scale_gets_lighter_all_the_way() -> None:
    for darker, lighter in combinations(palette.SEQUENTIAL, 2):
        assert contrast(darker, (0, 0, 0)) < contrast(lighter, (0, 0, 0))


def test_texts_of_figures_and_the_report_can_be_read() -> None:
    assert contrast(rgb(INK.removeprefix("#")), WHITE) >= TEXT_CONTRAST
    source = "".join(value for value in vars(html).values() if isinstance(value, str))
    codes = re.findall(r"(?<![-\w])color: #([0-9a-f]{6}|[0-9a-f]{3})\b", source)
    assert len(codes) >= 5
    for code in codes:
        assert contrast(rgb(code), WHITE) >= TEXT_CONTRAST, code
