"""Names and texts within SQL: the one place where they are quoted."""

from __future__ import annotations

from collections.abc import Iterable


def identifier(name: str) -> str:
    """A table's or column's name, whatever characters are in it."""
    return '"' + name.replace('"', '""') + '"'


def identifiers(names: Iterable[str]) -> str:
    """Several of them, separated by commas."""
    return ", ".join(map(identifier, names))


def literal(text: str) -> str:
    """A text as a value."""
    return "'" + text.replace("'", "''") + "'"
