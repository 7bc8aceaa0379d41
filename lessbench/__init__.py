"""LESS Workbench: what did this person want, and how sure can we be?

`import lessbench` offers what `pipeline.choice` does (models of choice, their densities, inference), and `Motion` and
`feature` of `pipeline.replay`. The code itself is in the folder `pipeline` of the repository. A wheel carries it within
this package, so that installing it adds one name, `lessbench`, to an environment. Once this package is imported, the
names `pipeline` and `schemas` mean its own.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any

_HERE = Path(__file__).resolve().parent
_CODE = _HERE / "_code" if (_HERE / "_code").is_dir() else _HERE.parent
_OFFERED = {"Motion": "pipeline.replay", "feature": "pipeline.replay"}


def _asked_for() -> bool:
    """Whether PYTHONPATH names a project with code of its own, which is then what runs (`pipeline.cli.own_code`)."""
    places = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    return any((Path(place) / "pipeline" / "stages" / "registry.py").is_file() for place in places)


def _make_importable() -> None:
    """Let `pipeline` and `schemas` be found in the folder of this package's code.

    Raises:
        ImportError: another package called `pipeline` is imported already.
    """
    loaded = sys.modules.get("pipeline")
    if loaded is None and _asked_for():
        return
    if loaded is None:
        sys.path.insert(0, str(_CODE))
        loaded = importlib.import_module("pipeline")
    if not hasattr(loaded, "LESS_WORKBENCH"):
        raise ImportError(
            f"another package called `pipeline` is in use ({getattr(loaded, '__file__', None)}); import lessbench in a "
            "process of its own, or before that one"
        )


_make_importable()


def __getattr__(name: str) -> Any:
    choice = importlib.import_module("pipeline.choice")
    if name == "__all__":
        return [*choice.__all__, *_OFFERED]
    if name in choice.__all__:
        return getattr(choice, name)
    if name in _OFFERED:
        return getattr(importlib.import_module(_OFFERED[name]), name)
    raise AttributeError(f"module 'lessbench' has no attribute {name!r}")


def main() -> None:
    """Run the command line."""
    importlib.import_module("pipeline.cli").main()
