"""Parameters by their dotted path in params.yaml, as DVC names them: `tasks.table.features`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel

from pipeline.params.sections import Params


def fingerprint(params: Params, paths: Iterable[str]) -> str:
    """SHA-256 over the parameters at some paths, as canonical JSON.

    Raises:
        KeyError: there is no such parameter.
    """
    values = {path: _plain(value_at(params, path)) for path in paths}
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def value_at(params: Params, path: str) -> Any:
    """The parameter, section or entry at a dotted path.

    Raises:
        KeyError: there is none.
    """
    value: Any = params
    for key in path.split("."):
        value = value[key] if isinstance(value, Mapping) else getattr(value, _attributes(value)[key])
    return value


def _attributes(section: BaseModel) -> dict[str, str]:
    """The attribute of each field by the name that params.yaml has for it."""
    return {field.alias or name: name for name, field in type(section).model_fields.items()}


def _plain(value: Any) -> Any:
    """A value as JSON has it."""
    if isinstance(value, BaseModel):
        return {key: _plain(getattr(value, name)) for key, name in _attributes(value).items()}
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return value
