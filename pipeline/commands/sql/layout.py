"""A few rows for a person: as a table, or one row below the other where a table would be too wide."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pipeline.terminal import cell, plain

if TYPE_CHECKING:
    import polars as pl

WIDTH_IN_A_PIPE = 200
LONGEST_CELL = 1000
TEXT_WIDTH = 30  # to which a column of sentences may be narrowed: they go on in the next line
_BORDERS = 3  # characters beside a column's own


class Page:
    """Rows that are shown together.

    Attributes:
        rows: which.
        fits: whether they fit beside each other, with nothing but sentences broken into lines.
    """

    def __init__(self, rows: pl.DataFrame, on_terminal: bool) -> None:
        from rich.console import Console

        self.rows = rows
        self._console = Console(width=None if on_terminal else WIDTH_IN_A_PIPE)
        self._names = [plain(name) for name in rows.columns]
        self._texts = [[_text(value) for value in row] for row in rows.iter_rows()]
        self.fits = self._needed_width() <= self._console.width

    def drawn(self) -> str:
        """The rows as text, in colours if a terminal shows them."""
        with self._console.capture() as capture:
            if self.fits:
                self._print_table()
            else:
                self._print_below_each_other()
        return capture.get()

    def _print_table(self) -> None:
        from rich.table import Column, Table

        sentences = [any(_is_sentence(row[place]) for row in self._texts) for place in range(len(self._names))]
        table = Table(
            *(Column(cell(name), no_wrap=not wraps) for name, wraps in zip(self._names, sentences, strict=True))
        )
        for row in self._texts:
            table.add_row(*map(cell, row))
        self._console.print(table)

    def _print_below_each_other(self) -> None:
        from rich.cells import cell_len, set_cell_size
        from rich.rule import Rule
        from rich.text import Text

        width = max(map(cell_len, self._names), default=0)
        for number, row in enumerate(self._texts, start=1):
            self._console.print(Rule(cell(f"row {number}"), align="left"))
            for name, text in zip(self._names, row, strict=True):
                line = Text.assemble(cell(set_cell_size(name, width), "bold"), "  ", cell(text))
                self._console.print(line, soft_wrap=True)

    def _needed_width(self) -> int:
        from rich.cells import cell_len

        widths = [cell_len(name) for name in self._names]
        for row in self._texts:
            for place, text in enumerate(row):
                whole = cell_len(text)
                if _is_sentence(text):
                    whole = min(whole, max(TEXT_WIDTH, *map(cell_len, text.split(" "))))
                widths[place] = max(widths[place], whole)
        return sum(widths) + _BORDERS * len(widths) + 1


def _is_sentence(text: str) -> bool:
    return " " in text and not text.startswith(("[", "{"))


def _text(value: object) -> str:
    return plain(_written(value), LONGEST_CELL)


def _written(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return "[" + ", ".join(_written(item) for item in value) + "]"
    return "" if value is None else str(value)
