"""Kinds of features from elsewhere: files of Python that a task names, and installed packages.

This module runs code. Whether a file may run is decided before, in `pipeline.workspace.trust`: what runs here is the
bytes whose hash was agreed to.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.abc import SourceLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

from pipeline.errors import ParameterError, WorkbenchError
from pipeline.plug_ins import FEATURES, installed
from pipeline.replay.kinds.register import KINDS, Kind


@dataclass(frozen=True)
class FeatureFile:
    """A file of Python that registers kinds, and the SHA-256 of what may run."""

    path: Path
    content: str


_registered: list[FeatureFile] = []


def registered() -> tuple[FeatureFile, ...]:
    """The feature files that this process has run, for workers that are to run them too."""
    return tuple(_registered)


def register_kinds(files: Iterable[FeatureFile]) -> None:
    """Run feature files, each once in a process.

    Raises:
        ParameterError: a file is not there or has changed, or running it fails.
    """
    for file in files:
        if file not in _registered:
            _run(file)
            _registered.append(file)


def installed_kind(name: str) -> Kind | None:
    """The kind that an installed package has under this name as an entry point; None if none has.

    Raises:
        ParameterError: its package cannot be imported.
    """
    installed(FEATURES, name)
    return KINDS.get(name)


class _Bytes(SourceLoader):
    """Loads a module from bytes in memory: neither another version of the file nor compiled code can slip in."""

    def __init__(self, path: Path, source: bytes) -> None:
        self._path, self._source = path, source

    def get_filename(self, fullname: str) -> str:
        return str(self._path)

    def get_data(self, path: str | bytes) -> bytes:
        return self._source

    def path_stats(self, path: str) -> dict[str, float]:
        raise OSError  # so that no compiled file is read or written


def _run(file: FeatureFile) -> None:
    try:
        source = file.path.read_bytes()
    except OSError as error:
        raise ParameterError(f"{file.path}: the feature file cannot be read: {error.strerror or error}") from error
    if hashlib.sha256(source).hexdigest() != file.content:
        raise ParameterError(f"{file.path}: the feature file changed while this was running; run it again")
    name = f"lessbench_feature_file_{file.content[:16]}"
    spec = spec_from_loader(name, _Bytes(file.path, source))
    if spec is None or spec.loader is None:
        raise ParameterError(f"{file.path}: is no Python file that can be run")
    module, before = module_from_spec(spec), dict(KINDS)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        KINDS.clear()
        KINDS.update(before)
        said = str(error) if isinstance(error, WorkbenchError) else f"{type(error).__name__}: {error}"
        raise ParameterError(f"{file.path}: the feature file cannot be run: {said}") from error
