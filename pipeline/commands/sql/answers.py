"""One question and its answer: a bounded table for people, or all of it for other programs."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO, TYPE_CHECKING

from pipeline.commands.sql.layout import Page
from pipeline.errors import QueryError
from pipeline.formats.duckdb.export import write_csv, write_json, write_parquet
from pipeline.formats.duckdb.questions import CONTENTS, EXAMPLES, ask, asked
from pipeline.formats.files.atomic import written_whole
from pipeline.terminal import note, say, show_in_pager, standard_output

if TYPE_CHECKING:
    import polars as pl

    from pipeline.formats.duckdb.questions import Answer

ROWS_ON_TERMINAL, ROWS_BELOW_EACH_OTHER = 40, 10  # about a screen or three
ROWS_ELSEWHERE = 1_000
MOST_ROWS = 10_000  # that a table may be asked to show: drawing one takes about a millisecond a row
COUNTING_S = 3.0  # how long rows that are not shown are counted


class Format(StrEnum):
    """How an answer is given."""

    table = "table"
    csv = "csv"
    json = "json"
    parquet = "parquet"


@dataclass(frozen=True)
class Wanted:
    """How an answer is given, and where.

    Attributes:
        form: None for what the ending of `output` says, else a table.
        output: a file that appears once all is in it; None for standard output.
        rows: how many rows a table shows at most; None for as many as fit where it goes.
        formulas: False for CSV whose texts no spreadsheet takes for formulas.
        more: how to see `{rows}` rows instead, and how to get all, for a table that does not show all.
    """

    form: Format | None = None
    output: Path | None = None
    rows: int | None = None
    formulas: bool = True
    more: str = "`--rows {rows}` shows more, `--output answer.csv` writes all"


def answer_once(catalog: Path, question: str | None, wanted: Wanted) -> None:
    """Write the answer to a question; without one, what there is to ask about.

    Raises:
        QueryError: as of `pipeline.formats.duckdb.questions.asked`, or Parquet would be written on a terminal.
        OutputError: standard output cannot be written.
        StageError: the file `output` cannot be written; what was there is unchanged.
    """
    form = wanted.form or _by_ending(wanted.output)
    if form is Format.parquet and wanted.output is None and sys.stdout.isatty():
        raise QueryError("Parquet is not for reading: write it to a file, as in `... --output answer.parquet`")
    if not wanted.formulas and form is not Format.csv:
        raise QueryError("--no-formulas is for CSV; write CSV with `--format csv`, or `--output answer.csv`")
    with asked(catalog, question or CONTENTS) as answer:
        if form is Format.table and wanted.output is None and sys.stdout.isatty():
            show_in_pager(_table(answer, wanted, on_terminal=True))
        elif wanted.output is not None:
            with written_whole(wanted.output) as stream:
                _write(answer, form, wanted, stream)
        else:
            with standard_output() as stream:
                _write(answer, form, wanted, stream)
    if question is not None and answer.taken <= 1:  # one row may be a count of nothing
        _say_which_tasks(catalog, question)
    if question is None and form is Format.table and wanted.output is None:
        for line in _examples():
            say(line)


def _by_ending(output: Path | None) -> Format:
    if output is None:
        return Format.table
    try:
        return Format(output.suffix.removeprefix(".").lower())
    except ValueError:
        raise QueryError(f"{output}: the ending says in which format; it may be .csv, .json or .parquet") from None


def _write(answer: Answer, form: Format, wanted: Wanted, stream: IO[bytes]) -> None:
    on_terminal = wanted.output is None and sys.stdout.isatty()
    if form is Format.csv:
        write_csv(answer, stream, formulas=wanted.formulas, for_terminal=on_terminal)
    elif form is Format.json:
        write_json(answer, stream)
    elif form is Format.parquet:
        write_parquet(answer, stream)
    else:
        for text in _table(answer, wanted, on_terminal=False):
            stream.write(text.encode(sys.stdout.encoding or "utf-8", "backslashreplace"))


def _table(answer: Answer, wanted: Wanted, on_terminal: bool) -> Iterator[str]:
    """The first rows as a table, and then how many there are."""
    import polars as pl

    most = wanted.rows or (ROWS_ON_TERMINAL if on_terminal else ROWS_ELSEWHERE)
    frames = answer.frames()
    rows = next(frames)
    for frame in frames:
        rows = pl.concat([rows, frame])
        if rows.height > most:
            break
    page = Page(rows[:most], on_terminal)
    if on_terminal and wanted.rows is None and not page.fits:
        page = Page(rows[:ROWS_BELOW_EACH_OTHER], on_terminal)
    yield page.drawn()
    shown, left = page.rows.height, rows.height - page.rows.height
    if left == 0:
        yield f"{shown:,} row{'s' if shown != 1 else ''}\n"
        return
    others, all_counted = _count(frames, left)
    known = f"{shown + others:,}" if all_counted else f"more than {shown + others:,}"
    yield f"the first {shown:,} of {known} rows; {wanted.more.format(rows=min(10 * shown, MOST_ROWS))}\n"


def _count(frames: Iterator[pl.DataFrame], count: int) -> tuple[int, bool]:
    """How many rows there are with those to come, and whether these are all: some answers have no end."""
    until = time.monotonic() + COUNTING_S
    for frame in frames:
        count += frame.height
        if time.monotonic() > until:
            return count, False
    return count, True


def _say_which_tasks(catalog: Path, question: str) -> None:
    """Say so if a question that found nothing asks for a task that the catalog does not have."""
    compared = re.findall(r"\btask\s*(?:==?|in\s*\()\s*('[^']*'(?:\s*,\s*'[^']*')*)", question, re.IGNORECASE)
    asked_for = [task for tasks in compared for task in re.findall("'([^']*)'", tasks)]
    if not asked_for:
        return
    with suppress(QueryError):  # a catalog without `files` is none that `lessbench catalog` made
        tasks = ask(catalog, "select distinct task from files where task is not null order by all")["task"].to_list()
        for task in asked_for:
            if task not in tasks:
                there = ", ".join(tasks) or "none yet"
                note(f"the catalog has no task {task!r}; it has {there}; `lessbench catalog` makes it anew")


def _examples() -> list[str]:
    lines = ["Questions to begin with:"]
    for asked_for, example in EXAMPLES.items():
        lines += [f"  {asked_for}", f"    {example}"]
    return lines
