"""Each message on docs/troubleshooting.md is one that the program still says."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
MESSAGES = re.findall(r"(?m)^### `(.+)`$", PAGE)
VALUE = "\0"


@cache
def said() -> tuple[str, ...]:
    """Every text of the program, with a mark for each value that is put in."""
    texts = []
    for module in sorted((ROOT / "pipeline").rglob("*.py")):
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [part.value if isinstance(part, ast.Constant) else VALUE for part in node.values]
                texts.append("".join(map(str, parts)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return tuple(texts)


def is_said(message: str) -> bool:
    pattern = f"{VALUE}+".join(re.escape(part) for part in message.split("…"))
    return any(re.search(pattern, text) for text in said())


def test_there_are_messages() -> None:
    assert len(MESSAGES) > 20
    assert len(set(MESSAGES)) == len(MESSAGES)
    assert PAGE.count("\n### ") == len(MESSAGES)


@pytest.mark.parametrize("message", MESSAGES)
def test_it_is_still_said(message: str) -> None:
    assert is_said(message)


def test_what_nobody_says_is_found() -> None:
    assert not is_said("…: there is no catalogue yet")
    assert not is_said("the catalog has no task, …")
