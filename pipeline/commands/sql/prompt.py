"""The prompt of `lessbench sql`, with the habits of other SQL prompts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.commands.sql.answers import MOST_ROWS, Wanted, answer_once
from pipeline.errors import QueryError, WorkbenchError
from pipeline.formats.duckdb.questions import CONTENTS, ask
from pipeline.formats.duckdb.quoting import literal
from pipeline.formats.files.links import require_inside
from pipeline.terminal import plain, say

if TYPE_CHECKING:
    import polars as pl
    from prompt_toolkit import PromptSession
    from prompt_toolkit.buffer import Buffer
    from prompt_toolkit.completion import CompleteEvent, Completer, Completion
    from prompt_toolkit.document import Document

HISTORY = ".lessbench/sql_history"
COLUMNS = "select table_name, column_name, comment from duckdb_columns() where not internal order by all"
MEANINGS = """select column_name as "column", data_type as type, comment as meaning from duckdb_columns()
    where not internal and lower(table_name) = lower({name}) order by column_index"""
MORE = "`.rows {rows}` shows more, `.once answer.csv` writes all of the next answer"
KEYWORDS = (
    "select", "from", "where", "group by", "order by", "limit", "join", "left join", "using", "on", "and", "or", "not",
    "as", "distinct", "count", "avg", "sum", "min", "max", "median", "round", "filter", "having", "desc", "with",
    "pivot",
    "describe", "summarize",
)  # fmt: skip
COMMANDS = {
    "help": "tables, views and questions to begin with; also \\?",
    ".tables": "tables and views; also \\d",
    ".schema": "NAME: columns of a table or view; also \\d NAME",
    ".rows": f"NUMBER: how many rows are shown, at most {MOST_ROWS:,}",
    ".once": "FILE: the next answer goes whole into FILE (.csv, .json or .parquet)",
    "exit": "leave; also quit, \\q and Ctrl-D",
}
_LEAVE = {"exit", "quit", "\\q", ".exit", ".quit"}
_HELP = {"help", "\\?", "\\h", ".help"}
_TABLES = {".tables", "\\d", "\\dt", "\\dv"}
_COLUMNS = {".schema", "\\d"}


def prompt(catalog: Path, history: Path) -> None:
    """Answer questions from the terminal until it is left; a mistake is one sentence, and the prompt goes on.

    A question goes over several lines until one ends with `;` or is empty.

    Args:
        catalog: the database, opened anew and read-only for every question.
        history: file that remembers what was asked.

    Raises:
        QueryError: there is no catalog.
        StageError: the history is a link, or behind one, that leads out of the project.
    """
    session = _session(ask(catalog, COLUMNS), history)
    say("Questions in SQL end with `;` or an empty line. Tab completes, `help` shows what there is, `exit` leaves.")
    wanted = Wanted(more=MORE)
    while True:
        try:
            asked = session.prompt("sql> ", prompt_continuation="...> ").strip().rstrip(";").strip()
        except KeyboardInterrupt:
            continue
        except EOFError:
            return
        if asked.lower() in _LEAVE:
            return
        if asked:
            wanted = _answer_or_say_why(catalog, asked, wanted)


def _session(columns: pl.DataFrame, history: Path) -> PromptSession[str]:
    from prompt_toolkit import PromptSession
    from prompt_toolkit.filters import Condition
    from prompt_toolkit.history import FileHistory
    from prompt_toolkit.lexers import PygmentsLexer
    from pygments.lexers.sql import SqlLexer

    require_inside(history, opened=True)
    history.parent.mkdir(parents=True, exist_ok=True)
    session: PromptSession[str] = PromptSession(
        history=FileHistory(str(history)), completer=_completer(columns), lexer=PygmentsLexer(SqlLexer)
    )
    session.multiline = Condition(lambda: not _ends(session.default_buffer))
    return session


def _ends(typed: Buffer) -> bool:
    """Whether Enter asks what was typed, instead of beginning a new line."""
    text = typed.text.strip()
    return not text or text.endswith(";") or typed.document.current_line.strip() == "" or _is_command(text)


def _is_command(text: str) -> bool:
    return text.startswith((".", "\\")) or text.lower() in _LEAVE | _HELP


def _answer_or_say_why(catalog: Path, asked: str, wanted: Wanted) -> Wanted:
    """How the next answer is wanted."""
    try:
        if _is_command(asked):
            return _obey(catalog, asked, wanted)
        answer_once(catalog, asked, wanted)
        if wanted.output is not None:
            say(f"{wanted.output}: written")
        return replace(wanted, output=None)
    except WorkbenchError as error:
        say(str(error))
    except KeyboardInterrupt:
        say("stopped")
    return wanted


def _obey(catalog: Path, command: str, wanted: Wanted) -> Wanted:
    word, _, rest = command.partition(" ")
    word, rest, everything = word.lower(), rest.strip(), replace(wanted, rows=MOST_ROWS, output=None)
    if word in _HELP:
        answer_once(catalog, None, everything)
        for name, meaning in COMMANDS.items():
            say(f"  {name:8} {meaning}")
    elif word in _TABLES and not rest:
        answer_once(catalog, CONTENTS, everything)
    elif word in _COLUMNS and rest:
        columns = MEANINGS.format(name=literal(rest))
        if ask(catalog, columns).is_empty():
            raise QueryError(f"there is no table or view {rest}; `.tables` shows what there is")
        answer_once(catalog, columns, everything)
    elif word == ".rows" and rest.isdecimal() and 0 < int(rest) <= MOST_ROWS:
        return replace(wanted, rows=int(rest))
    elif word == ".once" and rest:
        return replace(wanted, output=Path(rest))
    else:
        raise QueryError(f"there is no command `{command}`; there are {', '.join(COMMANDS)}, and `help` explains them")
    return wanted


def _completer(columns: pl.DataFrame) -> Completer:
    """Tables after `from` and `join`; else columns, of the tables that are named if any are, and SQL's words."""
    from prompt_toolkit.completion import Completer, Completion

    of_table: dict[str, dict[str, str]] = {}
    for table, column, meaning in columns.iter_rows():
        if table.isprintable() and column.isprintable():  # others cannot be typed either
            of_table.setdefault(table, {})[column] = plain(meaning or "")

    class Words(Completer):
        def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterable[Completion]:
            text = document.text_before_cursor
            word = re.split(r"[^\w.]" if text.lstrip().startswith(".") else r"[^\w]", text)[-1]
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
    if re.search(r"\b(from|join)\s+$|^\s*(\.schema|\\d)\s+$", before, re.IGNORECASE):
        return tables
    if not before.strip():
        return COMMANDS | dict.fromkeys(KEYWORDS, "")
    named = set(re.findall(r"\w+", whole)) & set(of_table)
    columns = {
        column: text for name in of_table if name in (named or of_table) for column, text in of_table[name].items()
    }
    return columns | dict.fromkeys(KEYWORDS, "")
