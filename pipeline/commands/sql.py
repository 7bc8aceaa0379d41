"""`lessbench sql`: one answer in the form that is asked for, or a prompt that answers one question after another."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import QueryError
from pipeline.formats.duckdb.catalog import CONTENTS, EXAMPLES, ask

if TYPE_CHECKING:
    import polars as pl
    from prompt_toolkit import PromptSession
    from prompt_toolkit.completion import CompleteEvent, Completer, Completion
    from prompt_toolkit.document import Document

HISTORY = ".lessbench/sql_history"
WIDTH_IN_A_PIPE = 200
COLUMNS = "select table_name, column_name, comment from duckdb_columns() where not internal order by all"
KEYWORDS = (
    "select", "from", "where", "group by", "order by", "limit", "join", "left join", "using", "on", "and", "or", "not",
    "as", "distinct", "count", "avg", "sum", "min", "max", "median", "round", "filter", "having", "desc", "with", "pivot",
    "describe", "summarize",
)  # fmt: skip
COMMANDS = {
    "help": "tables, views and questions to begin with",
    "exit": "leave, as Ctrl-D does",
}


class Format(StrEnum):
    """How an answer is given."""

    table = "table"
    csv = "csv"
    json = "json"
    parquet = "parquet"


def answer_once(catalog: Path, question: str | None, form: Format) -> None:
    """Print the answer to a question; without one, what there is to ask about.

    Raises:
        QueryError: as of `pipeline.formats.duckdb.catalog.ask`, or Parquet would be written on a terminal.
    """
    if form is Format.parquet and sys.stdout.isatty():
        raise QueryError(
            "Parquet is not for reading: write it to a file, as in `... --format parquet > answer.parquet`"
        )
    answer = ask(catalog, question or CONTENTS)
    if form is Format.table:
        _print_table(answer)
    elif form is Format.parquet:
        answer.write_parquet(sys.stdout.buffer)
    else:
        sys.stdout.write(_as_text(answer, form))
    if question is None and form is Format.table:
        sys.stdout.write(_examples())


def prompt(catalog: Path, history: Path) -> None:
    """Answer questions from the terminal until it is left; a mistake is one sentence, and the prompt goes on.

    Args:
        catalog: the database, opened anew and read-only for every question.
        history: file that remembers what was asked.

    Raises:
        QueryError: there is no catalog.
    """
    from prompt_toolkit import PromptSession
    from prompt_toolkit.history import FileHistory
    from prompt_toolkit.lexers import PygmentsLexer
    from pygments.lexers.sql import SqlLexer

    columns = ask(catalog, COLUMNS)
    history.parent.mkdir(parents=True, exist_ok=True)
    session: PromptSession[str] = PromptSession(
        history=FileHistory(str(history)), completer=_completer(columns), lexer=PygmentsLexer(SqlLexer)
    )
    sys.stdout.write("Questions in SQL; Tab completes, `help` shows what there is, Ctrl-D leaves.\n")
    while True:
        try:
            question = session.prompt("sql> ").strip().rstrip(";").strip()
        except KeyboardInterrupt:
            continue
        except EOFError:
            return
        if question.lower() in ("exit", "quit"):
            return
        if question:
            _answer_or_say_why(catalog, question)


def _answer_or_say_why(catalog: Path, question: str) -> None:
    try:
        answer_once(catalog, None if question.lower() == "help" else question, Format.table)
    except QueryError as error:
        sys.stdout.write(f"{error}\n")
    except KeyboardInterrupt:
        sys.stdout.write("stopped\n")


def _completer(columns: pl.DataFrame) -> Completer:
    """Tables after `from` and `join`; else columns, of the tables that are named if any are, and SQL's words."""
    from prompt_toolkit.completion import Completer, Completion

    of_table: dict[str, dict[str, str]] = {}
    for table, column, meaning in columns.iter_rows():
        of_table.setdefault(table, {})[column] = meaning or ""

    class Words(Completer):
        def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterable[Completion]:
            text = document.text_before_cursor
            word = re.split(r"[^\w]", text)[-1]
            for name, meaning in candidates(of_table, text[: len(text) - len(word)], document.text).items():
                if name.lower().startswith(word.lower()) and name != word:
                    yield Completion(name, start_position=-len(word), display_meta=meaning)

    return Words()


def candidates(of_table: Mapping[str, Mapping[str, str]], before: str, whole: str) -> dict[str, str]:
    """What may follow, with what it means.

    Args:
        of_table: meanings of columns by table or view.
        before: the question up to the word that is being typed.
        whole: all of it; the tables that it names may stand behind.
    """
    tables = {name: f"{len(names)} columns" for name, names in of_table.items()}
    if re.search(r"\b(from|join)\s+$", before, re.IGNORECASE):
        return tables
    if not before.strip():
        return COMMANDS | dict.fromkeys(KEYWORDS, "")
    named = set(re.findall(r"\w+", whole)) & set(of_table)
    columns = {
        column: text for name in of_table if name in (named or of_table) for column, text in of_table[name].items()
    }
    return columns | dict.fromkeys(KEYWORDS, "")


def _examples() -> str:
    lines = [f"  {asked}\n    {example}" for asked, example in EXAMPLES.items()]
    return "\n".join(["Questions to begin with:", *lines, ""])


def _print_table(table: pl.DataFrame) -> None:
    from rich.console import Console
    from rich.table import Column, Table
    from rich.text import Text

    # as text, because square brackets would be taken for markup
    shown = Table(*(Column(Text(name)) for name in table.columns))
    for row in table.iter_rows():
        shown.add_row(*(Text(_cell(value)) for value in row))
    console = Console(width=None if sys.stdout.isatty() else WIDTH_IN_A_PIPE)
    console.print(shown)
    console.print(f"{table.height} row{'s' if table.height != 1 else ''}")


def _as_text(answer: pl.DataFrame, form: Format) -> str:
    import polars as pl

    if form is Format.json:
        return json.dumps(answer.to_dicts(), indent=1, default=str) + "\n"
    # CSV has no lists: they are written as JSON
    nested = [name for name, type_ in answer.schema.items() if type_.is_nested()]
    return answer.with_columns(
        pl.Series(name, [None if value is None else json.dumps(value) for value in answer[name].to_list()], pl.String)
        for name in nested
    ).write_csv()


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(_cell(item) for item in value) + "]"
    return "" if value is None else str(value)
