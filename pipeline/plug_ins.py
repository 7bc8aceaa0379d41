"""What packages that are installed beside the program bring: kinds of features, models of choice, samplers.

A package announces each under a name, as an entry point of one of the groups below. It is imported when that name is
asked for, and not before. Installing a package is agreeing to its code.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from pipeline.errors import ParameterError

FEATURES, MODELS, SAMPLERS = "lessbench.features", "lessbench.models", "lessbench.samplers"
_WHAT = {FEATURES: "feature kind", MODELS: "model", SAMPLERS: "sampler"}


def installed(group: str, name: str) -> Any | None:
    """What an installed package has under this name; None if none has.

    Args:
        group: FEATURES, MODELS or SAMPLERS.
        name: as parameters have it.

    Raises:
        ParameterError: the package cannot be imported.
    """
    for entry in entry_points(group=group, name=name):
        try:
            return entry.load()
        except Exception as error:
            raise ParameterError(
                f"the {_WHAT[group]} {name!r} is promised by {entry.value!r} of an installed package, which cannot be "
                f"imported ({type(error).__name__}: {error}); correct or remove that package"
            ) from error
    return None


def installed_names(group: str) -> list[str]:
    """The names that installed packages have in a group; nothing is imported."""
    return sorted({entry.name for entry in entry_points(group=group)})
