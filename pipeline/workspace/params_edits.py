"""params.yaml changed in one place: all other lines, their comments, order and layout stay as they are."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node

from pipeline.errors import ParameterError
from pipeline.params import FILE
from pipeline.yaml_text import plain_yaml

_PLAIN = re.compile(r"[A-Za-z_./][\w./-]*( [\w./-]+)*")
_WORDS = {"null", "true", "false", "yes", "no", "on", "off", "y", "n", "nan", "inf", ".nan", ".inf", "."}
_COMMENT_AT = 48  # column of the comments


def with_entry(text: str, section: str, name: str, entry: Mapping[str, Any], comments: Mapping[str, str]) -> str:
    """The text with an entry at the end of a section.

    Args:
        text: of params.yaml.
        section: such as `tasks`.
        name: of the entry, not there yet.
        entry: plain data, written as one line for each key.
        comments: by key, what is written beside it.

    Raises:
        ParameterError: the section is not written as a block, one entry after another.
    """
    text = text if text.endswith("\n") else f"{text}\n"
    block = _block(text, section)
    keys = [key for key, _ in block.value]
    indent = keys[0].start_mark.column
    lines = text.splitlines(keepends=True)
    last = _last_line(lines, block.start_mark.line, block.end_mark.line)
    step = _step(block, indent)
    new = entry_text(name, entry, comments, indent, step)
    return _checked(text, "".join([*lines[: last + 1], new, *lines[last + 1 :]]), section, name, entry)


def entry_text(name: str, entry: Mapping[str, Any], comments: Mapping[str, str], indent: int = 2, step: int = 2) -> str:
    """An entry as lines of a section: its name, `indent` columns in, and its settings `step` further in."""
    lines = [f"{' ' * indent}{name}:\n"]
    for key, value in entry.items():
        lines += _lines(" " * (indent + step), key, value, comments.get(key), step)
    return "".join(lines)


def without_entry(text: str, section: str, name: str) -> str:
    """The text without an entry of a section, such as `tasks` or `simulate.weights`; as it is if there is none.

    Raises:
        ParameterError: the section is not written as a block.
    """
    block = _block(text, section)
    place = next((i for i, (key, _) in enumerate(block.value) if key.value == name), None)
    if place is None:
        return text
    key, value = block.value[place]
    lines = text.splitlines(keepends=True)
    if len(block.value) == 1:
        head = next(i for i in range(key.start_mark.line - 1, -1, -1) if _says_something(lines[i]))
        lines[head] = re.sub(r"^(\s*[\w-]+:)", r"\1 {}", lines[head])
    end = max(value.end_mark.line, key.start_mark.line + 1)
    last = _last_line(lines, key.start_mark.line, end)
    return _checked(text, "".join([*lines[: key.start_mark.line], *lines[last + 1 :]]), section, name, None)


def _block(text: str, section: str) -> MappingNode:
    node: Node = YAML(typ="rt").compose(text)
    for part in section.split("."):
        entries = {key.value: value for key, value in node.value} if isinstance(node, MappingNode) else {}
        if part not in entries:
            raise ParameterError(f"{FILE} has no section {section!r}")
        node = entries[part]
    if not isinstance(node, MappingNode) or node.flow_style or not node.value:
        raise ParameterError(
            f"{FILE} has its section {section!r} in braces or empty; write each entry as a line `name:` with its "
            "settings indented below it"
        )
    return node


def _last_line(lines: Sequence[str], first: int, end: int) -> int:
    """The last of some lines that is neither blank nor a comment."""
    end = min(end, len(lines))
    return next(i for i in range(end - 1, first - 1, -1) if _says_something(lines[i]))


def _says_something(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _step(block: MappingNode, indent: int) -> int:
    """How much further in the settings of an entry are."""
    for _, value in block.value:
        if isinstance(value, MappingNode) and not value.flow_style and value.value:
            return max(1, int(value.value[0][0].start_mark.column) - indent)
    return 2


def _lines(indent: str, key: str, value: Any, comment: str | None, step: int) -> list[str]:
    if isinstance(value, Mapping) and value and all(isinstance(one, Mapping) for one in value.values()):
        said = f"{indent}{key}:"
        lines = [f"{indent}{' ' * step}{name}: {_flow(one)}\n" for name, one in value.items()]
    else:
        said, lines = f"{indent}{key}: {_flow(value)}", []
    beside = f"{said:<{_COMMENT_AT - 1}} # {comment}" if comment else said
    return [f"{beside}\n", *lines]


def _flow(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_flow(key)}: {_flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, str):
        return value if _PLAIN.fullmatch(value) and value.lower() not in _WORDS else json.dumps(value)
    if isinstance(value, Sequence):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return json.dumps(value)


def _checked(before: str, after: str, section: str, name: str, entry: Mapping[str, Any] | None) -> str:
    """The text after the change, if that is the one change in it.

    Raises:
        ParameterError: it is not.
    """
    wanted: Any = plain_yaml(before)
    node = wanted
    for part in section.split("."):
        node = node[part]
    if entry is None:
        del node[name]
    else:
        node[name] = json.loads(json.dumps(entry))
    if plain_yaml(after) != wanted:
        raise ParameterError(f"{FILE} is laid out so that {section}.{name} cannot be changed by itself; do it by hand")
    return after
