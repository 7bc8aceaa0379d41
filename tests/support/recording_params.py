"""Parameters that note which of them are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import FunctionType, MethodType
from typing import Any

from pydantic import BaseModel


def leaves(document: Any, path: str = "") -> Iterator[str]:
    """The dotted paths of all values of a document that are no mappings."""
    if isinstance(document, Mapping):
        for key, value in document.items():
            yield from leaves(value, f"{path}.{key}" if path else str(key))
    else:
        yield path


def recording(value: Any, read: set[str], path: str = "") -> Any:
    """`value`, or something in its place that adds the path of every leaf that is read to `read`."""
    if isinstance(value, BaseModel):
        return _Section(value, read, path)
    if isinstance(value, Mapping):
        return _Mapping(value, read, path)
    read.add(path)
    return value


class _Section:
    """A section of parameters."""

    def __init__(self, section: BaseModel, read: set[str], path: str) -> None:
        self._section, self._read, self._path = section, read, path

    def __getattr__(self, name: str) -> Any:
        fields = type(self._section).model_fields
        if name in fields:
            return self._of(name)
        method = getattr(type(self._section), name)
        if isinstance(method, FunctionType) and method.__module__.startswith("pipeline."):
            return MethodType(method, self)
        for field in fields:  # pydantic's own, as model_dump
            list(leaves(self._of(field)))
        return getattr(self._section, name)

    def _of(self, name: str) -> Any:
        key = type(self._section).model_fields[name].alias or name
        path = f"{self._path}.{key}" if self._path else key
        return recording(getattr(self._section, name), self._read, path)


class _Mapping(Mapping[str, Any]):
    """A mapping of parameters; its keys can be looked at without reading a value."""

    def __init__(self, mapping: Mapping[str, Any], read: set[str], path: str) -> None:
        self._mapping, self._read, self._path = mapping, read, path

    def __getitem__(self, key: str) -> Any:
        return recording(self._mapping[key], self._read, f"{self._path}.{key}")

    def __contains__(self, key: object) -> bool:
        return key in self._mapping

    def __iter__(self) -> Iterator[str]:
        return iter(self._mapping)

    def __len__(self) -> int:
        return len(self._mapping)
