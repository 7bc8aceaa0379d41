"""Libraries that only some forms need, and that are therefore installed on request."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from pipeline.formats.mcap.rejection_reasons import rejection

EXTRAS = {"rosbags": "ros", "google.protobuf": "ros", "h5py": "hdf5"}
"""The extra of this package that brings a library."""


def needed(module: str, what: str) -> Any:
    """The module of a library, imported.

    Args:
        module: its name.
        what: what is read with it, at the beginning of a sentence.

    Raises:
        RecordingError: not-read; the library is not installed.
    """
    library = next(name for name in EXTRAS if module == name or module.startswith(f"{name}."))
    try:
        return import_module(module)
    except ImportError as error:
        raise rejection(
            "not-read",
            f"{what} with the library {library.removeprefix('google.')}, which is not installed; install it with "
            f"`pip install 'lessbench[{EXTRAS[library]}]'`.",
        ) from error
