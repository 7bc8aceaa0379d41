"""params.yaml read and checked: unknown keys refused with the nearest valid name, every mistake one sentence."""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pipeline.errors import ParameterError, one_of
from pipeline.params.sections import FILE, Params, Reading, Redraws, ShiftedSampler, Task
from pipeline.params.sizes import check_sizes
from pipeline.yaml_text import YamlError, plain_yaml

LARGEST_BYTES = 1_000_000
OWN_TASKS = "tasks"  # folder beside params.yaml, with a file for each task that does not stand there
MOST_FILES = 1_000
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def load(path: Path, overlay: Path | None = None) -> Params:
    """Read and check the parameters in the YAML file `path` (plain data only: no tags, no objects).

    Tasks may also stand in files of their own beside it, see `own_tasks`.

    Args:
        path: params.yaml.
        overlay: a YAML file that says only what is different: sections are merged, anything else is replaced.

    Raises:
        ParameterError: a file is missing, is not YAML, or a field is unknown, missing or out of range.
    """
    document = _with_own_tasks(_read_yaml(path), path.parent)
    if overlay is None:
        return parse(document, str(path))
    changes = _read_yaml(overlay)
    if not isinstance(document, dict) or not isinstance(changes, dict):
        raise ParameterError(
            f"{overlay}: holds no parameters; needed are sections of {path.name} with what is different"
        )
    return parse(_merged(document, changes), f"{path} with {overlay}")


def overlay_tasks(overlay: Path) -> tuple[str, ...]:
    """The tasks that a file of different parameters names, in its order.

    Raises:
        ParameterError: it cannot be read, or names no tasks.
    """
    changes = _read_yaml(overlay)
    named = changes.get("tasks") if isinstance(changes, dict) else None
    if not isinstance(named, dict) or not named:
        raise ParameterError(f"{overlay}: names no tasks; say which one to run")
    return tuple(str(name) for name in named)


def own_tasks(folder: Path) -> dict[str, str]:
    """Files of single tasks, `tasks/NAME.yaml`, by the name of the task, from the folder of params.yaml.

    Raises:
        ParameterError: there are more than 1,000.
    """
    files = sorted((folder / OWN_TASKS).glob("*.yaml"))
    if len(files) > MOST_FILES:
        raise ParameterError(f"{folder / OWN_TASKS} holds more than {MOST_FILES:,} files; a project has fewer tasks")
    return {file.stem: f"{OWN_TASKS}/{file.name}" for file in files}


def _with_own_tasks(document: object, folder: Path) -> object:
    """The document of params.yaml with the tasks that stand in files of their own."""
    if not isinstance(document, dict) or not (own := own_tasks(folder)):
        return document
    tasks = document.get("tasks")
    found = dict(tasks) if isinstance(tasks, dict) else {}
    simulated = document["simulate"].get("weights") if isinstance(document.get("simulate"), dict) else None
    for name, file in own.items():
        content = _read_yaml(folder / file)
        inside = content.get("tasks") if isinstance(content, dict) and len(content) == 1 else None
        if not isinstance(inside, dict) or list(inside) != [name]:
            raise ParameterError(
                f"{folder / file}: must hold `tasks:` and in it the one task {name!r}, as the file is called"
            )
        if name in found:
            raise ParameterError(f"{folder / file}: the task {name!r} is in {FILE}, too; keep one of them")
        if isinstance(simulated, dict) and name in simulated:
            raise ParameterError(
                f"{folder / file}: simulate.weights names {name!r}; a simulated task must stand in {FILE}"
            )
        found[name] = inside[name]
    return document | {"tasks": found}


def parse(document: object, source: str = FILE) -> Params:
    """Check parameters that are already plain data; `source` is named in messages."""
    if not isinstance(document, dict):
        raise ParameterError(f"{source}: holds no parameters; needed are the sections {one_of(Params.model_fields)}")
    try:
        parameters = Params.model_validate(document)
    except ValidationError as error:
        raise ParameterError(f"{source}: {_sentence(error)}") from None
    check_sizes(parameters, source)
    return parameters


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`base` with `changes`; where both have a section, merged likewise."""
    both = dict(base)
    for key, value in changes.items():
        here = base.get(key)
        both[key] = _merged(here, value) if isinstance(here, dict) and isinstance(value, dict) else value
    return both


def _read_yaml(path: Path) -> object:
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_BYTES + 1)
        if len(content) > LARGEST_BYTES:
            raise ParameterError(f"{path}: is larger than {LARGEST_BYTES:,} bytes; parameters take far less")
        return plain_yaml(content.decode("utf-8"))
    except FileNotFoundError:
        raise ParameterError(f"{path}: there is no such file; run this in a folder that has a {FILE}") from None
    except UnicodeDecodeError as error:
        raise ParameterError(f"{path}: is not readable YAML (byte {error.start} is no UTF-8)") from None
    except YamlError as error:
        raise ParameterError(f"{path}: {error}") from None


def _sentence(error: ValidationError) -> str:
    # a misspelt key comes as one that is unknown and one that is missing: the first says more
    errors = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    first = errors[0]
    location = _location(first["loc"])
    if first["type"] == "extra_forbidden":  # its name is the user's, whatever is in it
        location = [*_location(first["loc"][:-1]), first["loc"][-1]]
    place = ".".join(str(part) for part in location)
    if first["type"] == "extra_forbidden":
        return f"there is no parameter {place!r}; {_nearest(location)}"
    if first["type"] == "missing":
        return f"the parameter {place!r} is missing"
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "too_short":
        return f"{place} is empty; list at least {first['ctx']['min_length']}"
    if not place or first["type"] == "value_error":
        return f"{place}: {message}" if place else message
    # each branch of a union reports by itself
    branches = [e["msg"].removeprefix("Input should be ") for e in errors if _location(e["loc"]) == location]
    return f"{place} is {first['input']!r}; it should be {', or '.join(dict.fromkeys(branches))}"


def _location(loc: tuple[int | str, ...]) -> list[int | str]:
    # pydantic names the branch of a union in the location; a reader of params.yaml knows only keys and indices
    names = {"float", "int", "str", "bool", "constrained-float", "constrained-int", "constrained-str"}
    return [part for part in loc if isinstance(part, int) or (_KEY.fullmatch(part) and part not in names)]


def _fields(model: Any) -> dict[str, Any]:
    """The fields of a section by the names that params.yaml has for them."""
    fields = getattr(model, "model_fields", {})
    return {field.alias or name: field for name, field in fields.items()}


def _nearest(location: list[Any]) -> str:
    model: Any = Params
    for part in location[:-1]:
        field = _fields(model).get(str(part))
        if field is not None:
            named = {"tasks": Task, "samplers": ShiftedSampler, "reading": Reading, "redraws": Redraws}
            model = named.get(part, field.annotation)
    names = list(_fields(model))
    close = difflib.get_close_matches(str(location[-1]), names, n=1)
    return f"did you mean {close[0]!r}?" if close else f"allowed are {one_of(names)}"
