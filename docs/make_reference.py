"""Write docs/command_line.md from the program, and docs/parameters.md from its models of params.yaml.

`python docs/make_reference.py`
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer.main
from typer.core import TyperCommand, TyperGroup

from pipeline import cli
from pipeline.cli.grouping import PANELS
from pipeline.params import Params

DOCS = Path(__file__).parent
COMMAND_LINE, PARAMETERS = DOCS / "command_line.md", DOCS / "parameters.md"
COMMANDS_BEGIN = """\
# Command line

Made from the program by `python docs/make_reference.py`; change the docstrings in `pipeline/cli`.

`lessbench --help` lists the commands, `lessbench COMMAND -h` explains one. Every command works in any folder of a
project, and reads `params.yaml` there.

| exit status | meaning |
|---|---|
| 0 | done |
| 1 | it could not be done, or what was checked is not sound; one sentence on standard error says why |
| 2 | the command line is wrong |
"""
PARAMETERS_BEGIN = """\
# Parameters

Made from the models in `pipeline/params/sections.py` and the comments of `params.yaml` by
`python docs/make_reference.py`; change them there.

`params.yaml` holds all that can be set, and nothing that can be computed. Unknown names and values that a parameter
may not have are refused before anything is computed, and the message names the parameter. To try other values without
changing the file, write only those into a second file and give it as `lessbench --overlay FILE`. After a change,
`dvc repro` computes again what depends on it. If the third column is empty, the entry is in the file only if you add
it.
"""


def main() -> None:
    """Write both pages."""
    COMMAND_LINE.write_text(command_line(), encoding="utf-8")
    PARAMETERS.write_text(parameters(), encoding="utf-8")


def command_line() -> str:
    """The page of the command line."""
    group = typer.main.get_command(cli.app)
    assert isinstance(group, TyperGroup)
    parts = [COMMANDS_BEGIN, "## Options before the command\n", _options(group)]
    context = typer.Context(group)
    for panel in PANELS:
        parts.append(f"## {panel}\n")
        for name in group.list_commands(context):
            command = group.commands[name]
            if getattr(command, "rich_help_panel", None) == panel:
                parts += _commands(command, name)
    return "\n".join(parts)


def _commands(command: Any, name: str) -> Iterator[str]:
    if isinstance(command, TyperGroup):
        for below in command.commands.values():
            yield from _commands(below, f"{name} {below.name}")
        return
    assert isinstance(command, TyperCommand)
    yield f"### lessbench {name}\n"
    words = command.collect_usage_pieces(typer.Context(command, info_name=name))
    yield f"`lessbench {name} {' '.join(words)}`\n"
    yield _one_line_a_paragraph(command.help or "") + "\n"
    if options := _options(command):
        yield options


def _one_line_a_paragraph(text: str) -> str:
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in re.split(r"\n\s*\n", text))


def _options(command: Any) -> str:
    context = typer.Context(command)
    rows = []
    for parameter in command.get_params(context):
        if parameter.name != "help" and (explained := parameter.get_help_record(context)):
            names, meaning = explained
            names = re.sub(r" <[^>]*>", "", names.strip())
            rows.append(f"| `{names}` | {_cell(meaning)} |")
    return "\n".join(["| option | meaning |", "|---|---|", *rows]) + "\n" if rows else ""


def parameters() -> str:
    """The page of the parameters."""
    schema = Params.model_json_schema(by_alias=True)
    written = dict(_written((DOCS.parent / "params.yaml").read_text(encoding="utf-8")))
    parts = [PARAMETERS_BEGIN]
    for name, field in schema["properties"].items():
        parts.append(f"## {name}\n")
        rows = list(_rows(schema["$defs"], written, (name,), field))
        if title := written.get((name,), ("", ""))[1]:
            parts.append(f"{title[0].upper()}{title[1:]}.\n")
        parts += ["| parameter | may be | in params.yaml | meaning |", "|---|---|---|---|", *rows, ""]
    return "\n".join(parts)


def _rows(
    models: Mapping[str, Any], written: Mapping[tuple[str, ...], tuple[str, str]], path: tuple[str, ...], field: Any
) -> Iterator[str]:
    """A row for each parameter at or below a place; what a table of tasks or samplers holds, once, under `NAME`."""
    below = _model(models, field)
    if below is not None and {"additionalProperties", "patternProperties"} & set(field):
        path = (*path, "NAME")
    if below is None:
        value, meaning = _any_name(written, path) or _inner(_any_name(written, path[:-1]), path[-1])
        shown = f"`{value}`" if value else ""
        yield f"| `{'.'.join(path)}` | {_cell(_may_be(field))} | {_cell(shown)} | {_cell(meaning)} |"
        return
    explained = dict(_attributes(below.get("description", "")))
    for name, inner in below["properties"].items():
        place = (*path, name)
        for row in _rows(models, written, place, inner):
            if name in explained and _model(models, inner) is None:
                row = f"{row.removesuffix(' |').rpartition(' | ')[0]} | {_cell(explained[name])} |"
            yield row


def _any_name(written: Mapping[tuple[str, ...], tuple[str, str]], path: tuple[str, ...]) -> tuple[str, str] | tuple[()]:
    """What params.yaml has first at a place, whatever names people give on the way; nothing if it has none."""
    for place, found in written.items():
        if len(place) == len(path) and all(name in (there, "NAME") for name, there in zip(path, place, strict=True)):
            return found
    return ()


def _inner(line: tuple[str, str] | tuple[()], name: str) -> tuple[str, str]:
    """The value of a name within `{...}` on one line, with the comment of the line."""
    if line and (found := re.search(rf"[{{ ]{name}: ([^,}}]+)", line[0])):
        return found[1], line[1]
    return "", ""


def _model(models: Mapping[str, Any], field: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The model that a field holds, or holds by name, if any."""
    choices = field.get("anyOf", [field])
    for choice in choices:
        if "$ref" in choice:
            return models[choice["$ref"].rsplit("/", 1)[-1]]  # type: ignore[no-any-return]
        for inner in [choice.get("additionalProperties"), *choice.get("patternProperties", {}).values()]:
            if isinstance(inner, dict) and "$ref" in inner:
                return _model(models, inner)
    return None


def _may_be(field: Mapping[str, Any]) -> str:
    """What a field may be, in words."""
    if "anyOf" in field:
        return " or ".join(_may_be(choice) for choice in field["anyOf"])
    if "enum" in field or "const" in field:
        return " or ".join(f"`{word}`" for word in field.get("enum", [field.get("const")]))
    kind = field.get("type")
    if kind == "array":
        inner = field.get("items")
        return f"list of {_may_be(inner)}" if inner else "list of a fixed length"
    if kind == "object":
        inner = field.get("additionalProperties") or next(iter(field.get("patternProperties", {}).values()), None)
        return f"name: {_may_be(inner)}" if isinstance(inner, dict) else "names with values"
    if kind in ("integer", "number"):
        bounds = [
            words.format(f"{field[bound]:,}".removesuffix(".0"))
            for bound, words in {
                "minimum": "at least {}", "exclusiveMinimum": "more than {}", "maximum": "at most {}",
                "exclusiveMaximum": "less than {}",
            }.items()
            if bound in field
        ]  # fmt: skip
        return f"{'whole number' if kind == 'integer' else 'number'}{', ' if bounds else ''}{', '.join(bounds)}"
    return {"boolean": "`true` or `false`", "null": "`null`", "string": "text"}[str(kind)]


def _attributes(docstring: str) -> Iterator[tuple[str, str]]:
    """Names with what a docstring says of each under `Attributes:`."""
    listed = docstring.partition("Attributes:\n")[2]
    for name, text in re.findall(r"^    (\w+): (.*(?:\n {8,}.*)*)", listed, re.MULTILINE):
        yield name, " ".join(text.split())


def _written(text: str) -> Iterator[tuple[tuple[str, ...], tuple[str, str]]]:
    """Each place of params.yaml with its value and its comment."""
    path: list[tuple[int, str]] = []
    for line in text.splitlines():
        found = re.match(r"( *)([\w-]+):\s*(.*?)\s*(?:#\s*(.*))?$", line)
        if found is None:
            continue
        indent = len(found[1])
        path = [*(place for place in path if place[0] < indent), (indent, found[2])]
        yield tuple(name for _, name in path), (found[3], found[4] or "")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    main()
